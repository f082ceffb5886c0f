"""The shipped unit under a real systemd: ready, watched, restarted, reloaded, ended, nothing learned lost."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rig

import canest.live.install

pytestmark = [pytest.mark.vcan, pytest.mark.guest]

BUS = "vts"
UNIT = "canest@guest.service"
GROUP = "239.74.163.2"
CONFIG = Path("/etc/canest/guest.yaml")
STATE = Path("/var/lib/canest/guest")
UNITS = Path("/etc/systemd/system")
#: As the unit says.
WATCHDOG_S = 10.0
RECOVERY_S = 2.0
#: How often systemctl and journalctl are asked, each a process that takes the emulated processor a while.
ASK_S = 0.5

Record = Callable[[str, object], None]


def systemctl(*words: str, timeout_s: float = 120.0) -> str:
    done = subprocess.run(
        ["systemctl", *words], capture_output=True, text=True, timeout=timeout_s, check=False
    )
    assert done.returncode == 0, f"systemctl {' '.join(words)}: {done.stdout}{done.stderr}\n{journal()}"
    return done.stdout.strip()


def show(name: str) -> str:
    return systemctl("show", "--value", "--property", name, UNIT)


def main_pid() -> int:
    return int(show("MainPID"))


def journal() -> str:
    words = ["journalctl", "--no-pager", "-o", "cat", "-u", UNIT]
    return subprocess.run(words, capture_output=True, text=True, timeout=60, check=False).stdout


def other_senders() -> dict[str, int]:
    return rig.ask(Path(f"/run/canest/guest/status-{BUS}.sock"))["other_senders"]


def config_text(**broken: str) -> str:
    text = (rig.ROOT / "configs" / "vcan.yaml").read_text().replace("channel: vcan0", f"channel: {BUS}")
    text = text.replace('service: {learn: "on"}', 'service: {learn: "on+save", save_every_s: 1}')
    assert BUS in text
    assert "save_every_s" in text
    return text + "".join(f"{key}: {value}\n" for key, value in broken.items())


@pytest.fixture(scope="module")
def unit() -> Iterator[str]:
    """The unit installed as on a vehicle, but for where this Python lives, and started."""
    rig.add_vcan(BUS)
    (UNITS / "canest@.service").write_text((rig.ROOT / "systemd" / "canest@.service").read_text())
    CONFIG.parent.mkdir(exist_ok=True)
    CONFIG.write_text(config_text())
    program = Path("/opt/canest/bin/canest")
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(f'#!/bin/sh\ncd {shlex.quote(str(rig.ROOT))}\nexec {sys.executable} -m canest "$@"\n')
    program.chmod(0o755)
    for place in (sys.prefix, sys.base_prefix, str(rig.ROOT)):
        for folder in (Path(place), *Path(place).parents):
            folder.chmod(folder.stat().st_mode | 0o555)  # to be read by the unit's own user
    drop_in = UNITS / "canest@.service.d" / "guest.conf"
    drop_in.parent.mkdir()
    places = " ".join({sys.prefix, sys.base_prefix, str(rig.ROOT)})
    # An emulated Python takes long to start; and this one may live in a home or below /tmp.
    drop_in.write_text(
        f"[Service]\nTimeoutStartSec=300\nTimeoutStopSec=20\nProtectHome=tmpfs\nBindReadOnlyPaths={places}\n"
    )
    systemctl("daemon-reload")
    systemctl("start", UNIT, timeout_s=300)
    yield UNIT
    subprocess.run(["systemctl", "stop", UNIT], check=False, timeout=60)


@pytest.fixture
def receiver(unit: str, tmp_path: Path) -> Iterator[rig.BroadcastReceiver]:
    """BroadcastReceiver on a bus on which a drive is played."""
    with rig.playing(BUS, rig.cycle_log(tmp_path)), rig.BroadcastReceiver(BUS) as receiver:
        yield receiver


def await_new_life(pid: int, since_s: float, limit_s: float) -> float:
    """Wait until the main process is another one; return the seconds that took from ``since_s`` on."""
    rig.wait_until(lambda: main_pid() not in (0, pid), 120.0, "systemd to start it again", ASK_S)
    took_s = time.monotonic() - since_s
    assert took_s <= limit_s * rig.slowness(), f"started again after {took_s:.1f} s, limit {limit_s} s"
    rig.wait_until(
        lambda: show("ActiveState") == "active", rig.START_S, "the new life to be ready", 2 * ASK_S
    )
    return took_s


def test_started_by_the_unit_it_is_ready_and_broadcasts(receiver: rig.BroadcastReceiver) -> None:
    assert show("ActiveState") == "active"
    received = receiver.until(
        lambda received: received.signals["EstimateStatus"] == 2, 120.0, "a valid estimate"
    )
    assert received.mass_kg == pytest.approx(rig.TRUE_MASS_KG, rel=0.05)
    rig.wait_until(
        lambda: re.search(r"valid: mass 2[01]\.\d t", show("StatusText")), 10.0, "a STATUS to read", ASK_S
    )


def test_it_runs_as_nobody_in_particular_with_nothing_it_could_use(unit: str) -> None:
    status = Path(f"/proc/{main_pid()}/status").read_text()
    assert int(re.search(r"^Uid:\s+(\d+)", status, re.M)[1]) >= 61184  # systemd's range of dynamic users
    assert re.search(r"^CapEff:\s+0+$", status, re.M)
    assert re.search(r"^NoNewPrivs:\s+1$", status, re.M)
    assert re.search(r"^Seccomp:\s+2$", status, re.M)


def test_metrics_file_lies_where_a_node_exporter_reads_it(receiver: rig.BroadcastReceiver) -> None:
    metrics = Path("/run/canest/guest/canest.prom")
    line = 'canest_status{status="valid"} 1.0\n'
    rig.wait_until(lambda: metrics.exists() and line in metrics.read_text(), 30.0, "the metrics")
    assert metrics.stat().st_mode & 0o777 == 0o644


def test_status_socket_answers_in_the_runtime_directory(unit: str) -> None:
    status = rig.ask(Path(f"/run/canest/guest/status-{BUS}.sock"))
    assert status["pid"] == main_pid()
    assert status["failures"] == 0


def test_killed_process_is_restarted_with_the_saved_mass(
    receiver: rig.BroadcastReceiver, record_property: Record
) -> None:
    before = receiver.until(
        lambda received: received.signals["EstimateStatus"] == 2, 120.0, "a valid estimate"
    )
    time.sleep(2.0)  # saved every second
    lives = journal().count("mass-restored")
    pid, begin_s = main_pid(), time.monotonic()
    os.kill(pid, signal.SIGKILL)
    record_property("restarted_s", await_new_life(pid, begin_s, 3.0))
    first = receiver.until(lambda received: received.fresh, 60.0, "an estimate of the new life")
    assert first.mass_kg == pytest.approx(before.mass_kg, rel=0.03)
    foreign = ["cangen", BUS, "-e", "-i", "-g", "2", "-n", "300", "-I", "0CF00453", "-L", "8", "-D", "r"]
    subprocess.run(foreign, check=True, timeout=60)  # what is sent after its return is counted, all of it
    rig.wait_until(lambda: other_senders().get("pgn_61444_from_0x53") == 300, 30.0, "all frames to count")
    assert journal().count("mass-restored") == lives + 1


def test_reload_of_a_broken_config_is_refused_without_stopping(receiver: rig.BroadcastReceiver) -> None:
    pid = main_pid()
    CONFIG.write_text(config_text(vehicel="{}"))
    try:
        systemctl("reload", UNIT)
        rig.wait_until(lambda: "reload-refused" in journal(), 30.0, "the refusal", ASK_S)
        assert "vehicel" in journal()
        receiver.fresh(time.monotonic(), RECOVERY_S, "a reload was refused")
        assert main_pid() == pid
    finally:
        CONFIG.write_text(config_text())


def test_reload_of_a_good_config_is_taken(receiver: rig.BroadcastReceiver) -> None:
    pid = main_pid()
    systemctl("reload", UNIT)
    rig.wait_until(lambda: "reloaded" in journal(), 30.0, "the reload", ASK_S)
    receiver.fresh(time.monotonic(), RECOVERY_S, "a reload")
    assert main_pid() == pid


def test_stopped_process_is_restarted_by_the_watchdog(
    receiver: rig.BroadcastReceiver, record_property: Record
) -> None:
    pid = main_pid()
    os.kill(pid, signal.SIGSTOP)
    # The deadline, then 0.5 s before the next start (RestartSec) and what systemd itself takes.
    took_s = await_new_life(pid, time.monotonic(), WATCHDOG_S + 3.0)
    record_property("restarted_s", took_s)
    assert "watchdog" in show("Result") + journal().lower() + systemctl("show", UNIT).lower()
    receiver.until(lambda received: received.fresh, 60.0, "an estimate of the new life")


def test_interface_deleted_and_made_anew(receiver: rig.BroadcastReceiver, record_property: Record) -> None:
    receiver.until(lambda received: received.fresh, 60.0, "an estimate before the fault")
    pid = main_pid()
    rig.ip("link", "delete", BUS)
    time.sleep(1.0)
    rig.add_vcan(BUS)
    back_s = time.monotonic()
    with rig.BroadcastReceiver(BUS) as new_receiver:
        record_property("recovered_s", new_receiver.fresh(back_s, RECOVERY_S, "the interface came back"))
    assert main_pid() == pid


def test_counters_come_with_sigusr1(unit: str) -> None:
    os.kill(main_pid(), signal.SIGUSR1)
    rig.wait_until(lambda: "bus.late_frames=" in journal(), 30.0, "the counters", ASK_S)


def test_sigterm_ends_within_a_second_with_the_mass_saved(receiver: rig.BroadcastReceiver) -> None:
    receiver.until(lambda received: received.fresh, 60.0, "an estimate")
    pid = main_pid()
    begin_s, begin_wall_s = time.monotonic(), time.time()
    os.kill(pid, signal.SIGTERM)
    rig.wait_until(lambda: not Path(f"/proc/{pid}").exists(), 20.0, "its end")
    took_s = time.monotonic() - begin_s
    assert took_s <= 1.0 * rig.slowness()
    assert next(STATE.glob("learned-*.json")).stat().st_mtime >= begin_wall_s - 0.1
    rig.wait_until(lambda: show("ActiveState") == "inactive", 20.0, "systemd to note it", ASK_S)
    assert (show("Result"), show("ExecMainStatus")) == ("success", "0")


def status_of_odd() -> dict[str, Any] | None:
    """Return the state of the bus once its first attempt to open it is over."""
    path = Path(f"/run/canest/odd/status-udp_multicast-{GROUP}.sock")
    try:
        bus = rig.ask(path)["bus"]
    except OSError:
        return None
    return None if bus["reason"] == "being opened" else bus


def test_installed_from_any_folder_with_a_private_umask_it_reaches_the_network_its_config_names(
    unit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped_unit = UNITS / "canest@.service"
    before = shipped_unit.read_text()
    program = Path("/opt/my canest 50%i/bin/canest")
    program.parent.mkdir(parents=True)
    program.write_bytes(Path("/opt/canest/bin/canest").read_bytes())
    for path in (program, program.parent, program.parents[1]):
        path.chmod(0o755)
    monkeypatch.setattr(canest.live.install, "this_executable", lambda: program)
    config = tmp_path / "odd.yaml"
    multicast = f"interface: udp_multicast, channel: {GROUP}"
    config.write_text(config_text().replace(f"interface: socketcan, channel: {BUS}", multicast))
    rig.ip("link", "set", "lo", "up")
    rig.ip("route", "add", f"{GROUP}/32", "dev", "lo")
    umask = os.umask(0o077)
    try:
        done = canest.live.install.install(config, None, force=True)
        systemctl("start", "canest@odd.service", timeout_s=300)
        first = subprocess.check_output(["systemctl", "show", "--property=Environment", "canest@odd.service"])
        assert str(program.parent) in first.decode()
        assert rig.wait_until(status_of_odd, 60.0, "its status", ASK_S)["state"] == "up"
        (drop_in,) = (path for path in done.written if path.name == "network.conf")
        drop_in.unlink()
        systemctl("daemon-reload")
        systemctl("restart", "canest@odd.service", timeout_s=300)
        bus = rig.wait_until(status_of_odd, 60.0, "its status", ASK_S)
        assert bus["state"] == "absent"
        assert "RestrictAddressFamilies of the unit forbids AF_INET" in bus["reason"]
    finally:
        os.umask(umask)
        subprocess.run(["systemctl", "stop", "canest@odd.service"], check=False, timeout=60)
        shipped_unit.write_text(before)
        systemctl("daemon-reload")


@pytest.mark.parametrize("name", ["can0.network"])
def test_networkd_accepts_every_key_of_the_example(name: str) -> None:
    """networkd complains of what it does not know and goes on, so nobody else would notice."""
    networkd = Path("/lib/systemd/systemd-networkd")
    folder = Path("/etc/systemd/network")
    folder.mkdir(parents=True, exist_ok=True)
    lines = (rig.ROOT / "systemd" / name).read_text()
    (folder / name).write_text(lines)
    (folder / "typo.network").write_text(lines.replace("BitRate=", "BitRaet="))
    done = subprocess.run(
        ["timeout", "-s", "TERM", "5", str(networkd)],
        env={"SYSTEMD_LOG_TARGET": "console", "SYSTEMD_LOG_LEVEL": "info"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "typo.network" in done.stderr  # so the silence about ours says something
    assert name not in done.stderr.replace("typo.network", "")
