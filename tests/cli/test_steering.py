"""What a file's name, a key or a log may hold: it is shown, and steers no terminal."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

from canest.core.errors import LogError, printable

STEERING = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e"


def test_what_steers_is_shown_as_python_writes_it():
    assert printable(STEERING) == r"\x1b]0;owned\x07\x1b[2J\x9b31m\u202e"
    assert printable("21 300 kg, 3 °, größer, 重量, \t\n") == "21 300 kg, 3 °, größer, 重量, \t\n"


def test_an_error_is_one_line_that_steers_nothing():
    text = str(LogError(f"no {STEERING}", where=f"{STEERING}\n.log", found=STEERING, expected=STEERING))
    assert text.isprintable()


def on_a_terminal(*arguments: str) -> str:
    """Return what a command writes to a terminal."""
    end, terminal = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "200"}
    process = subprocess.Popen(
        [sys.executable, "-m", "canest", *arguments], stdin=terminal, stdout=terminal, stderr=terminal,
        env=environment,
    )  # fmt: skip
    os.close(terminal)
    written = b""
    while True:
        try:
            piece = os.read(end, 1 << 16)
        except OSError:  # the other end is closed
            break
        if not piece:
            break
        written += piece
    os.close(end)
    process.wait(60)
    return written.decode()


@pytest.mark.parametrize("command", ["replay", "check", "compare"])
def test_names_and_content_of_a_log_reach_no_terminal(tmp_path, command):
    log = tmp_path / "\x1b]0;owned\x07.log"
    lines = (b"(1.0) can0 18FEF100#FF00107D7DFFFFF5", b"\x1b]0;owned\x07 garbage", b"(1.1) c\x1b[2J 123#00")
    log.write_bytes(b"\n".join((*lines, *lines, b"")))
    more = ["--mass", "20000"] if command == "compare" else []
    shown = on_a_terminal(command, str(log), "-c", "class8", *more)
    assert "\x1b]" not in shown and "\x07" not in shown and "\x1b[2J" not in shown
    assert r"\x1b]0;owned" in shown  # rich leaves out the bell itself


def test_options_and_keys_reach_no_terminal(tmp_path):
    config = tmp_path / "bad.yaml"
    config.write_text('"\\e]0;owned\\a": 1\n')
    for arguments in (["check", "-c", str(config)], ["check", STEERING], ["\x1b]0;owned\x07"]):
        shown = on_a_terminal(*arguments)
        assert "\x1b]" not in shown and "\x07" not in shown
        assert r"\x1b]0;owned" in shown or "missing option" in shown.lower()
