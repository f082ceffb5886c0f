"""The commands around the daemon, as a user types them; the daemon itself as a process with signals."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import pytest

from canest.cli.main import run
from canest.config import load_config
from canest.live.install import install, unit_text
from canest.system.shipped_files import shipped
from canest.telemetry.status_socket import StatusServer, read_status, socket_path
from tests.live.rig import Rig, free_port, wait_for

ROOT = Path(__file__).resolve().parents[2]
QUIET = ["--set", "bus.interface=virtual", "--set", "bus.channel=quiet", "--set", "estimator.name=rlsmf"]


class Process:
    """`canest run` as systemd would start it."""

    def __init__(self, tmp_path, *arguments):
        self.notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.notify.bind(str(tmp_path / "notify"))
        self.notify.settimeout(30)
        self.log = (tmp_path / "log").open("w+")
        environment = os.environ | {
            "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1000000",
            "STATE_DIRECTORY": str(tmp_path / "state"), "RUNTIME_DIRECTORY": str(tmp_path / "run"),
            "PYTHONPATH": str(ROOT), "JOURNAL_STREAM": "1:1",
        }  # fmt: skip
        self.process = subprocess.Popen(
            [sys.executable, "-m", "canest", "run", *arguments],
            env=environment, stderr=self.log, stdout=subprocess.DEVNULL, cwd=tmp_path,
        )  # fmt: skip

    def wait_for_notification(self, beginning):
        """Wait until systemd would have wait_for_notification a message."""
        while True:
            message = self.notify.recv(4096).decode()
            if message.startswith(beginning):
                return message

    def log_text(self):
        self.log.flush()
        return Path(self.log.name).read_text()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.notify.close()
        self.log.close()


@pytest.fixture
def truck(tmp_path):
    text = (ROOT / "configs" / "vcan.yaml").read_text()
    path = tmp_path / "truck.yaml"
    path.write_text(text.replace('service: {learn: "on"}', 'service: {learn: "on+save"}'))
    return path


DATABASE = """VERSION ""
BU_: X
BO_ 257 MOT: 8 X
 SG_ Torque : 0|16@1- (0.1,0) [0|0] "Nm" X
 SG_ Speed : 16|16@1+ (0.01,0) [0|0] "" X
 SG_ Brake : 32|1@1+ (1,0) [0|1] "" X
"""
WITHOUT_UNIT = """dbc: [van.dbc]
signals:
  engine_torque: {message: MOT, signal: Torque}
  vehicle_speed: {message: MOT, signal: Speed}
  brake_switch: {message: MOT, signal: Brake}
vehicle: {mass_min_kg: 800, mass_max_kg: 5000, wheel_radius_m: 0.34, final_drive: 9.0, drag_area_m2: 2.0,
  rolling_resistance: 0.01}
"""


def test_what_is_odd_about_a_config_is_logged_at_the_start(tmp_path):
    (tmp_path / "van.dbc").write_text(DATABASE)
    (tmp_path / "van.yaml").write_text(WITHOUT_UNIT)
    with Process(tmp_path, "-c", str(tmp_path / "van.yaml"), *QUIET) as daemon:
        daemon.wait_for_notification("READY=1")
        assert "<4>config-notes" in daemon.log_text()
        assert "MOT.Speed is taken as m/s" in daemon.log_text()


def test_a_life_under_systemd(tmp_path, truck):
    with Process(tmp_path, "-c", str(truck), *QUIET) as daemon:
        daemon.wait_for_notification("READY=1")
        daemon.wait_for_notification("STATUS=")
        daemon.wait_for_notification("WATCHDOG=1")
        [path] = (tmp_path / "run").glob("status-*.sock")
        assert read_status(path)["why_not_valid"].startswith("no frame has been received")

        daemon.process.send_signal(signal.SIGUSR1)
        assert wait_for(lambda: "<5>counters" in daemon.log_text())

        good = truck.read_text()
        truck.write_text(good + "\nunknown_section: 1\n")
        daemon.process.send_signal(signal.SIGHUP)
        daemon.wait_for_notification("RELOADING=1\nMONOTONIC_USEC=")
        daemon.wait_for_notification("READY=1")
        assert wait_for(lambda: "reload-refused" in daemon.log_text())
        assert "unknown_section" in daemon.log_text()

        truck.write_text(good.replace("rolling_resistance: 0.0060", "rolling_resistance: 0.0065"))
        daemon.process.send_signal(signal.SIGHUP)
        assert wait_for(lambda: "<5>reloaded" in daemon.log_text())

        begin = time.monotonic()
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(5) == 0
        assert time.monotonic() - begin < 1.0
        daemon.wait_for_notification("STOPPING=1")
        assert not path.exists()


def served(port):
    """Return what Prometheus would read, '' where nobody serves."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as answer:
            return answer.read().decode()
    except OSError:
        return ""


def test_a_reload_moves_the_metrics_port_and_the_status_socket(tmp_path, truck):
    pytest.importorskip("prometheus_client")
    text, first, second = truck.read_text(), free_port(), free_port()
    quiet = ["--set", "bus.interface=virtual", "--set", "estimator.name=rlsmf"]

    def reload(daemon, **changes):
        service = f'service: {{learn: "on+save", metrics_port: {changes["port"]}}}'
        changed = text.replace('service: {learn: "on+save"}', service)
        truck.write_text(changed.replace("channel: vcan0", f"channel: {changes.get('channel', 'vcan0')}"))
        daemon.process.send_signal(signal.SIGHUP)
        daemon.wait_for_notification("RELOADING=1")
        daemon.wait_for_notification("READY=1")

    with Process(tmp_path, "-c", str(truck), *quiet) as daemon, socket.socket() as occupied:
        daemon.wait_for_notification("READY=1")
        assert wait_for(
            (tmp_path / "run" / "canest.prom").exists
        )  # what a service writes without any setting
        reload(daemon, port=first)
        assert wait_for(lambda: "canest_uptime_seconds" in served(first), 15)
        reload(daemon, port=second)
        assert wait_for(lambda: "canest_uptime_seconds" in served(second) and not served(first))
        occupied.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        occupied.bind(("127.0.0.1", first))
        occupied.listen()
        reload(daemon, port=first, channel="elsewhere")
        assert wait_for(lambda: "service.metrics_port: cannot be opened" in daemon.log_text())
        assert "canest_uptime_seconds" in served(second)
        assert read_status(tmp_path / "run" / "status-virtual-vcan0.sock")["reloads"] == 2
        occupied.close()
        reload(daemon, port=first, channel="elsewhere")
        assert wait_for((tmp_path / "run" / "status-virtual-elsewhere.sock").exists)
        assert read_status(tmp_path / "run" / "status-virtual-elsewhere.sock")["reloads"] == 3
        assert not (tmp_path / "run" / "status-virtual-vcan0.sock").exists()
        reload(daemon, port="null")
        assert wait_for(lambda: served(first) == "")
        daemon.process.terminate()
        assert daemon.process.wait(5) == 0


def test_a_metrics_port_that_is_taken_at_the_start_is_reported_and_done_without(tmp_path, truck):
    pytest.importorskip("prometheus_client")
    with socket.socket() as occupied:
        occupied.bind(("127.0.0.1", 0))
        occupied.listen()
        port = f"service.metrics_port={occupied.getsockname()[1]}"
        with Process(tmp_path, "-c", str(truck), *QUIET, "--set", port) as daemon:
            daemon.wait_for_notification("READY=1")
            daemon.wait_for_notification("WATCHDOG=1")
            assert "no-metrics-port" in daemon.log_text()


def test_a_daemon_imports_neither_what_is_heavy_nor_what_cannot_run_hardened(tmp_path):
    code = (
        "import sys; from canest.config import load_config; from canest.live.daemon import Daemon;"
        "from canest.bus.pythoncan import PythonCanReceiver;"
        f"c = load_config('vcan', ['bus.interface=virtual', 'service.state_dir={tmp_path}']);"
        "Daemon(c).close();"
        "print(*sorted({m.split('.')[0] for m in sys.modules}));"
        "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT, timeout=60
    )
    modules, peak_kb = result.stdout.splitlines()[-2:]
    assert not {"numba", "scipy", "rich", "plotly", "pyarrow", "pandas", "click"} & set(modules.split())
    assert int(peak_kb) < 120_000


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["run"], 2, "-c"),
        (["run", "-c", "no-such-config"], 2, "no-such-config"),
        (["run", "-c", "vcan", "--set", "bus.interface=nosuch"], 2, "found 'nosuch'"),
        (["check", "-c", "vcan", "--set", "bus.interface=pkan"], 2, "perhaps pcan"),
        (["run", "-c", "vcan", "--set", "broadcast.rate_hz=500"], 2, "rate_hz"),
        (["run", "-c", "bmw-i3"], 2, "signals: the config maps only table columns"),
        (["check", "--live", "-c", "bmw-i3"], 2, "a bus carries frames"),
        (["status", "--socket", "/no/such/socket"], 1, "no daemon"),
        (["monitor", "can0"], 2, "INTERFACE:CHANNEL"),
        (["monitor", "--pgn", "1"], 2, "proprietary-B"),
        (["monitor", "nosuch:x"], 2, "nosuch:x: unknown interface, found 'nosuch'"),
        (["replay", "drive.log", "--to", "pkan:x"], 2, "perhaps pcan"),
        # python-can would look a name up within the receive loop, and then refuse it
        (["monitor", "udp_multicast:some.host"], 2, "found 'some.host', expected its address"),
        (["monitor", "udp_multicast:10.0.0.1"], 2, "no multicast group"),
        (["run", "-c", "vcan", "--set", "bus.interface=udp_multicast"], 2, "bus.channel: no multicast group"),
        (["install-service", "--install", "-c", "no-such-config"], 2, "no-such-config"),
        (["install-service", "-c", "no-such-config"], 2, "no-such-config"),
    ],
)
def test_every_mistake_is_one_line_and_the_right_exit_code(capsys, arguments, code, expected):
    assert run(arguments) == code
    errors = capsys.readouterr().err.strip()
    assert expected in errors and "Traceback" not in errors and len(errors.splitlines()) == 1


def test_status_shows_what_a_person_on_call_needs(tmp_path, drive, monkeypatch, capsys):
    settings = load_config("vcan", [f"service.state_dir={tmp_path}", "service.learn='off'"])
    from canest.telemetry.snapshot import flat, snapshot

    with Rig(monkeypatch, settings, drive) as rig:
        rig.run(45)
        content = snapshot(rig.daemon.view(rig.now_us))
    assert content["senders"]["pgn_61444_from_0x00"]["frames"] > 0
    assert all(re.fullmatch(r"[\w.]+", key) for key in flat(content))  # a line of key=value splits at spaces
    monkeypatch.setattr("canest.telemetry.status_socket.read_status", lambda path: content)
    assert run(["status", "--socket", "x"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for part in (
        "class8 on vcan0: valid",
        "mass 2",
        "learned from",
        "frames/s",
        "from address 0x9e",
        "ticks",
    ):
        assert part in shown
    assert run(["status", "--socket", "x", "--verbose"]) == 0
    assert "PGN 61444 from 0x00" in capsys.readouterr().out
    assert run(["status", "--socket", "x", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [content]


def test_status_of_a_killed_daemon_shows_what_it_had_learned(tmp_path, drive, monkeypatch, capsys):
    changes = [f"service.state_dir={tmp_path}", "service.learn='on+save'"]
    with Rig(monkeypatch, load_config("vcan", changes), drive) as rig:
        rig.run(60)
    config = tmp_path / "c.yaml"
    config.write_text(
        (ROOT / "configs/vcan.yaml").read_text().replace('"on"}', f'"on+save", state_dir: {tmp_path}}}')
    )
    with socket.socket(socket.AF_UNIX) as left_behind:
        left_behind.bind(str(tmp_path / "status-vcan0.sock"))
    assert run(["status", "-c", str(config)]) == 1
    captured = capsys.readouterr()
    assert "last learned: 2" in captured.out and "killed" in captured.err


def test_status_finds_a_daemon_in_the_state_directory_of_its_config(tmp_path, truck, capsys):
    truck.write_text(truck.read_text().replace('"on+save"}', f'"on+save", state_dir: {tmp_path}/own}}'))
    server, asked = StatusServer(socket_path(load_config(truck))), threading.Event()
    assert server.path.parent == tmp_path / "own"

    def answer():
        while not asked.wait(0.01):
            server.poll(lambda: {"pid": 7})

    daemon = threading.Thread(target=answer)
    daemon.start()
    try:
        assert run(["status", "-c", str(truck), "--json"]) == 0
    finally:
        asked.set()
        daemon.join()
        server.close()
    assert json.loads(capsys.readouterr().out) == [{"pid": 7}]


def test_a_status_socket_left_behind_is_replaced_and_a_client_that_leaves_is_survived(tmp_path):
    path = tmp_path / "status.sock"
    with socket.socket(socket.AF_UNIX) as left_behind:
        left_behind.bind(str(path))
    server = StatusServer(path)
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
    server.poll(lambda: {"a": "x" * 100_000})
    server.poll(lambda: {})
    waiting = [socket.socket(socket.AF_UNIX) for _ in range(3)]
    for client in waiting:
        client.connect(str(path))
    server.poll(lambda: {})
    assert [client.recv(10) for client in waiting] == [b"{}"] * 3  # all of one look
    for client in waiting:
        client.close()
    server.close()
    assert not path.exists()


def test_the_status_socket_lies_in_systemds_runtime_directory(tmp_path):
    config = load_config("vcan", ["bus.channel=can0"])
    assert socket_path(config, {"RUNTIME_DIRECTORY": "/run/canest/truck"}) == Path(
        "/run/canest/truck/status-can0.sock"
    )
    assert socket_path(config, {"STATE_DIRECTORY": "/var/lib/canest"}).parent == Path("/var/lib/canest")


def test_monitor_shows_the_broadcast(capsys):
    import threading

    import can

    from canest.decode import j1939
    from canest.node.estimate_frame import Estimate, encode

    done = threading.Event()

    def broadcast():
        can_id = j1939.pack(0xFF5A, 0x9E)
        with can.Bus(interface="virtual", channel="m") as bus:
            for counter in range(1000):
                payload = encode(Estimate(21_346.0, 150.0, 0.031, 0.002, 2, 0), counter, can_id)
                bus.send(can.Message(arbitration_id=can_id & 0x1FFFFFFF, is_extended_id=True, data=payload))
                if done.wait(0.02):
                    return

    thread = threading.Thread(target=broadcast)
    thread.start()
    try:
        assert run(["monitor", "virtual:m", "--for", "1.5"]) == 0
    finally:
        done.set()
        thread.join()
    shown = capsys.readouterr().out
    assert shown.splitlines()[0] == "canest on virtual:m" and shown.endswith("\n")
    # into a pipe goes a line a second, not the last picture at the end
    last = shown.splitlines()[-1]
    assert last.startswith("mass 21,346 kg ± ") and "valid · learning · from 0x9e" in last


def test_the_unit_finds_the_canest_that_printed_it(capsys):
    assert run(["install-service"]) == 0
    printed = capsys.readouterr().out
    assert printed == unit_text()
    assert "Type=notify" in printed and f"Environment=PATH={Path(sys.executable).parent}:" in printed


def test_the_service_is_installed_below_a_root_and_keeps_an_existing_config(tmp_path, truck):
    first = install(truck, "bus1", tmp_path)
    assert [p.relative_to(tmp_path).as_posix() for p in first.written] == [
        "etc/systemd/system/canest@.service", "etc/canest/bus1.yaml",
    ]  # fmt: skip
    assert any("canest@bus1" in note for note in first.notes)
    (tmp_path / "etc/canest/bus1.yaml").write_text("mine")
    second = install(truck, "bus1", tmp_path)
    assert (tmp_path / "etc/canest/bus1.yaml").read_text() == "mine"
    assert any("kept" in note for note in second.notes)


@pytest.mark.parametrize("name", ["mine.dbc", "dbc/mine.dbc"])
def test_the_dbc_of_a_config_is_installed_with_it(tmp_path, name):
    folder, root = tmp_path / "here", tmp_path / "image"
    (folder / name).parent.mkdir(parents=True)
    (folder / name).write_bytes((shipped("dbc") / "j1939.dbc").read_bytes())
    text = (shipped("configs") / "class8.yaml").read_text().replace("[j1939.dbc]", f"[{name}]")
    (folder / "truck.yaml").write_text(text)
    (folder / "linked.yaml").symlink_to("truck.yaml")
    for config in ("truck", "linked"):
        assert (
            run(["install-service", "--install", "-c", f"{folder}/{config}.yaml", "--root", str(root)]) == 0
        )
        assert load_config(root / f"etc/canest/{config}.yaml").dbc == (str(root / "etc/canest" / name),)


def test_a_dbc_that_the_service_would_not_find_is_refused(tmp_path, capsys):
    folder, root = tmp_path / "here", tmp_path / "image"
    folder.mkdir()
    (tmp_path / "mine.dbc").write_bytes((shipped("dbc") / "j1939.dbc").read_bytes())
    text = (shipped("configs") / "class8.yaml").read_text().replace("[j1939.dbc]", "[../mine.dbc]")
    (folder / "truck.yaml").write_text(text)
    assert run(["install-service", "--install", "-c", f"{folder}/truck.yaml", "--root", str(root)]) == 2
    assert "../mine.dbc" in capsys.readouterr().err and not root.exists()


def test_a_config_of_before_that_is_refused_is_reported(tmp_path, capsys, truck):
    (tmp_path / "etc/canest").mkdir(parents=True)
    (tmp_path / "etc/canest/bus1.yaml").write_text("vehicle: {}")
    argv = ["install-service", "--install", "-c", str(truck), "--name", "bus1", "--root", str(tmp_path)]
    assert run(argv) == 2
    assert f"{tmp_path}/etc/canest/bus1.yaml" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_one_plain_error(tmp_path, capsys, truck):
    (tmp_path / "etc").write_text("a file")
    assert run(["install-service", "--install", "-c", str(truck), "--root", str(tmp_path)]) == 1
    assert "cannot be written (Not a directory)" in capsys.readouterr().err


@pytest.mark.parametrize(("number", "advice"), [(errno.EACCES, True), (errno.ENOSPC, False)])
def test_root_is_the_advice_for_a_lack_of_permission_alone(
    tmp_path, capsys, truck, monkeypatch, number, advice
):
    def fail(path, content):
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr("canest.live.install.write_atomically", fail)
    assert run(["install-service", "--install", "-c", str(truck), "--root", str(tmp_path)]) == 1
    assert ("expected root: sudo" in capsys.readouterr().err) is advice


@pytest.mark.parametrize("option", ["record", "log-estimates"])
def test_a_recording_into_a_place_without_permission_is_refused_at_the_start(
    tmp_path, capsys, monkeypatch, option
):
    monkeypatch.setattr(os, "access", lambda place, mode: place != tmp_path)
    path = tmp_path / "new" / "seen"
    assert run(["run", "-c", "vcan", f"--{option}", str(path)]) == 2
    errors = capsys.readouterr().err
    assert f"service.{option.replace('-', '_')}: {path}: cannot be written, " in errors
    assert errors.endswith(f"expected permission to write {tmp_path}\n")
