"""Every block of a tutorial that can run is run as it stands, in order, in one empty folder."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(
    r"(?:<!-- not run: (?P<why>[^>]+) -->\n)?^```(?P<kind>\w*)\n(?P<code>.*?)^```", re.S | re.M
)


def script_of(page: Path) -> str:
    """Return the page's blocks as one script: what a reader types, from top to bottom."""
    parts = ["set -eu"]
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        if block["why"] or block["kind"] == "text":
            continue
        code = block["code"]
        parts.append(code if block["kind"] == "sh" else f"python - << 'END_OF_BLOCK'\n{code}END_OF_BLOCK\n")
    return "\n".join(parts)


def test_each_kind_of_user_has_a_tutorial():
    assert len(TUTORIALS) >= 6


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda p: p.stem)
def test_blocks_are_commands_python_or_output(page):
    text = page.read_text(encoding="utf-8")
    assert {block["kind"] for block in BLOCK.finditer(text)} <= {"sh", "python", "text"}
    assert not re.findall(r"^ {4,}canest", text, re.M), "a command in no block is not run"


@pytest.fixture
def reader():
    """Return an empty folder with a short name: a daemon's socket lies below it."""
    with tempfile.TemporaryDirectory(prefix="reader", dir="/tmp") as folder:
        yield Path(folder)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda p: p.stem)
def test_a_reader_can_type_the_tutorial(page, tmp_path, reader):
    for name, words in (("canest", "-m canest"), ("python", "")):
        command = tmp_path / name
        command.write_text(
            f'#!/bin/sh\nPYTHONPATH={shlex.quote(str(ROOT))} exec {sys.executable} {words} "$@"\n'
        )
        command.chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "HOME": str(reader)}
    with (tmp_path / "output").open("w+") as output:
        shell = subprocess.Popen(
            ["bash", "-c", script_of(page)], cwd=reader, env=environment, stdout=output, stderr=output,
            start_new_session=True,
        )  # fmt: skip
        try:
            code = shell.wait(timeout=240)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGKILL)  # what a page that fails leaves in the background
        output.seek(0)
        assert code == 0, output.read()[-3000:]
