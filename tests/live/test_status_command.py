"""`canest status` finds daemons wherever they run, also where their config file is wrong by now."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from canest.cli.main import run
from canest.system.shipped_files import shipped
from canest.telemetry.status_socket import StatusServer, running_sockets


@pytest.fixture
def broken(tmp_path) -> Path:
    path = tmp_path / "truck-of-a-test.yaml"
    path.write_text("vehicle: {name: [")
    return path


@pytest.fixture
def daemon(tmp_path, broken) -> Iterator[StatusServer]:
    """What answers as a daemon of this config, with a state directory of its own."""
    server, over = StatusServer(tmp_path / "own" / "status-can0.sock"), threading.Event()

    def answer():
        while not over.wait(0.01):
            server.poll(lambda: {"pid": 7, "config": f"/etc/canest/{broken.name}"})

    thread = threading.Thread(target=answer)
    thread.start()
    yield server
    over.set()
    thread.join()
    server.close()


def test_a_daemon_whose_config_file_is_broken_answers_all_the_same(daemon, broken, capsys):
    assert run(["status", "-c", str(broken), "--json"]) == 0
    captured = capsys.readouterr()
    assert [answer["pid"] for answer in json.loads(captured.out)] == [7]
    assert captured.err.startswith(f"warning: {broken}:") and "not valid YAML" in captured.err
    assert run(["status", "-c", str(broken), "--socket", str(daemon.path), "--json"]) == 0


def test_a_daemon_on_another_channel_than_the_file_says_is_hinted_at(tmp_path, capsys):
    config = tmp_path / "quiet.yaml"
    text = (shipped("configs") / "vcan.yaml").read_text()
    for old, new in (
        ('learn: "on"', f"state_dir: '{tmp_path / 'own'}'"),
        ("channel: vcan0", "channel: no_0"),
    ):
        assert old in text
        text = text.replace(old, new)
    config.write_text(text)
    assert run(["status", "-c", str(config)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert "no daemon (no such socket)" in lines[0]
    assert lines[1].endswith("is found with the same --set, or by canest status without -c")
    run(["status", "--socket", str(tmp_path / "none.sock"), "-c", str(config)])
    assert "without -c" not in capsys.readouterr().err


def test_a_daemon_is_found_with_the_settings_that_it_was_started_with(daemon, capsys):
    settings = ("bus.channel=can0", f"service.state_dir={daemon.path.parent}")
    assert run(["status", "-c", "class8", "--json", "--set", settings[0], "--set", settings[1]]) == 0
    assert [answer["pid"] for answer in json.loads(capsys.readouterr().out)] == [7]
    assert run(["status", "-c", "class8", "--set", "bus.channel=can9", "--set", settings[1]]) == 1
    assert f"{daemon.path.parent / 'status-can9.sock'}: no daemon" in capsys.readouterr().err
    assert run(["status", "--set", settings[0]]) == 2
    assert "found --set without a config, expected -c CONFIG" in capsys.readouterr().err


def test_what_is_no_socket_is_no_daemon_that_was_killed(tmp_path, capsys):
    (tmp_path / "file").touch()
    assert run(["status", "--socket", str(tmp_path / "file")]) == 1
    assert capsys.readouterr().err.strip() == f"{tmp_path}/file: is no socket of a daemon"


def test_daemons_of_other_configs_are_not_shown_for_a_broken_one(daemon, broken, capsys):
    other = broken.rename(broken.with_name("another.yaml"))
    assert run(["status", "-c", str(other), "--json"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "no daemon of a config of this name answers; --socket PATH" in captured.err
    assert f"error: {other}:" in captured.err


def test_a_daemon_with_a_state_directory_of_its_own_is_found_without_its_config(daemon, capsys):
    run(["status", "--json"])
    assert 7 in [answer.get("pid") for answer in json.loads(capsys.readouterr().out)]


def test_only_sockets_that_listen_under_the_name_of_a_status_are_asked(tmp_path, monkeypatch):
    monkeypatch.setattr("canest.telemetry.status_socket.find_sockets", lambda: iter([]))
    paths = {name: tmp_path / name for name in ("status-a.sock", "live-a.sock", "status-connected.sock")}
    for path in paths.values():
        with socket.socket(socket.AF_UNIX) as left_behind:
            left_behind.bind(str(path))
    head, row = "Num       RefCount Protocol Flags    Type St Inode Path\n", "0: 2 0 {} 0001 01 1 {}\n"
    table = tmp_path / "unix"
    table.write_text(
        head
        + row.format("00010000", paths["status-a.sock"]) * 2
        + row.format("00010000", paths["live-a.sock"])
        + row.format("00000000", paths["status-connected.sock"])
        + row.format("00010000", tmp_path / "status-gone.sock")
        + row.format("00010000", "status-relative.sock")
        + "0: 2 0 00010000 0001 01 2\nrest of a name\n"
    )
    assert running_sockets(table) == [paths["status-a.sock"]]
    assert running_sockets(tmp_path / "nowhere") == []
