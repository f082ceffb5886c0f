"""What a bus, a disk and a clock can do to a daemon that must go on. One daemon lives through all of it.

Every test breaks one thing on a bus on which a drive is played, mends it, and waits for estimates of now.
How long that took is a property of the test's report (``recovered_s``).
"""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rig

pytestmark = pytest.mark.vcan

BUS = "vtf"
#: From the return of a bus to an estimate on it: 1.5 s of that is the look whether somebody uses our group.
RECOVERY_S = 2.0
#: Where the bus was there all the time: the next broadcast but one or two.
SOON_S = 1.0
ENGINE_EEC1 = 0x0CF00400
GEARBOX_ETC1 = 0x0CF00203
FOREIGN_EEC1 = 0x0CF00431
#: From addresses that no other test uses: how many arrived is how many were counted.
COUNTED = {"down": 0x51, "deleted": 0x52}

Record = Callable[[str, object], None]


@pytest.fixture(scope="module")
def bus() -> Iterator[str]:
    rig.add_vcan(BUS)
    yield BUS
    subprocess.run(["ip", "link", "delete", BUS], check=False, capture_output=True)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def running(bus: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[rig.Daemon]:
    folder = tmp_path_factory.mktemp("faults") / "state"
    daemon = rig.Daemon(bus, folder, "--set", "service.save_every_s=1")
    daemon.remember(rig.TRUE_MASS_KG, 100.0)
    with daemon:
        yield daemon


@pytest.fixture
def daemon(running: rig.Daemon) -> rig.Daemon:
    """The daemon, started again should the test before have been the end of it."""
    if not running.alive:
        running.start()
    return running


@pytest.fixture
def drive(bus: str, logs: Path) -> Iterator[None]:
    with rig.playing(bus, rig.cycle_log(logs)):
        yield


@pytest.fixture
def receiver(daemon: rig.Daemon, drive: None) -> Iterator[rig.BroadcastReceiver]:
    """A receiver on a bus where all is well."""
    with rig.BroadcastReceiver(BUS) as receiver:
        receiver.until(lambda received: received.fresh, 60.0, "an estimate before the fault")
        yield receiver


@contextlib.contextmanager
def none_lost(daemon: rig.Daemon, address: int) -> Iterator[None]:
    """Frames sent from the block's beginning on are all counted: a wanted group, an address of their own."""
    words = ["-e", "-i", "-g", "2", "-n", "300", "-I", f"0CF004{address:02X}", "-L", "8", "-D", "r"]
    with subprocess.Popen(["cangen", BUS, *words], stderr=subprocess.DEVNULL):
        yield
    sender = f"pgn_61444_from_0x{address:02X}"
    rig.wait_until(
        lambda: daemon.status()["other_senders"].get(sender) == 300, 30.0, f"the frames of {sender} to count"
    )


def cansend(*frames: str) -> None:
    for frame in frames:
        subprocess.run(["cansend", BUS, frame], check=True, timeout=20)


def cangen(*options: str) -> None:
    subprocess.run(["cangen", BUS, "-e", "-i", *options], check=True, timeout=60, stderr=subprocess.DEVNULL)


def test_interface_down_and_up(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver, record_property: Record
) -> None:
    rig.ip("link", "set", BUS, "down")
    time.sleep(1.0)
    rig.ip("link", "set", BUS, "up")
    back_s = time.monotonic()
    with none_lost(daemon, COUNTED["down"]):
        record_property("recovered_s", receiver.fresh(back_s, RECOVERY_S, "the interface came up"))
    assert daemon.alive


def test_interface_deleted_and_made_anew(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver, record_property: Record
) -> None:
    rig.ip("link", "delete", BUS)
    time.sleep(1.0)
    assert daemon.alive
    rig.add_vcan(BUS)
    back_s = time.monotonic()
    # what is sent before the daemon has seen the new interface reaches nobody
    rig.wait_until(lambda: daemon.status()["bus"]["state"] == "up", RECOVERY_S, "the interface to be seen")
    # new receiver: the old socket is bound to the interface that is gone
    with none_lost(daemon, COUNTED["deleted"]), rig.BroadcastReceiver(BUS) as new_receiver:
        record_property("recovered_s", new_receiver.fresh(back_s, RECOVERY_S, "the interface came back"))
    assert daemon.status()["bus"]["interface_lost"] >= 1


def test_silent_bus_is_reported_and_is_no_fault(
    daemon: rig.Daemon, logs: Path, record_property: Record
) -> None:
    with rig.BroadcastReceiver(BUS) as receiver:
        with rig.playing(BUS, rig.cycle_log(logs)):
            receiver.until(lambda received: received.fresh, 60.0, "an estimate before the silence")
        quiet = receiver.until(
            lambda received: received.signals["EstimateStatus"] == 3, 60.0, "the silence to be reported"
        )
        assert quiet.mass_kg is None
        assert "quiet" in daemon.status()["why_not_valid"]
        with rig.playing(BUS, rig.cycle_log(logs)):
            record_property("recovered_s", receiver.fresh(time.monotonic(), RECOVERY_S, "traffic came back"))


def test_one_silent_ecu_freezes_the_estimate(daemon: rig.Daemon, logs: Path) -> None:
    """Without the engine's torque nothing is learned, the mass stays, and the gate says why."""
    stale = rig.gate_code("stale")
    with rig.BroadcastReceiver(BUS) as receiver:
        with rig.playing(BUS, rig.cycle_log(logs)):
            receiver.until(lambda received: received.fresh, 60.0, "an estimate before the fault")
        with rig.playing(BUS, rig.cycle_log(logs, without=(ENGINE_EEC1,))):
            gated = receiver.until(
                lambda received: received.fresh and received.signals["EstimateGate"] == stale,
                60.0,
                "the gate",
            )
            time.sleep(1.0)
            later = receiver.until(lambda received: received.fresh, 60.0, "a frozen estimate")
            assert later.mass_kg == pytest.approx(gated.mass_kg, rel=1e-3)
        with rig.playing(BUS, rig.cycle_log(logs)):
            receiver.until(
                lambda received: received.fresh and received.signals["EstimateGate"] != stale, 60.0, "its end"
            )


def test_a_frozen_signal_closes_a_gate_and_leaves_the_mass(daemon: rig.Daemon, logs: Path) -> None:
    """The gearbox repeats one frame for ever: its shaft speed no longer fits the engine's and the wheels'."""
    gates = [rig.gate_code(label) for label in ("implausible", "driveline")]
    with rig.BroadcastReceiver(BUS) as receiver:
        with rig.playing(BUS, rig.cycle_log(logs)):
            before = receiver.until(lambda received: received.fresh, 60.0, "an estimate before the fault")
        with rig.playing(BUS, rig.cycle_log(logs, frozen=(GEARBOX_ETC1,))):
            receiver.until(lambda received: received.signals["EstimateGate"] in gates, 60.0, "the gate")
            time.sleep(2.0)
            assert_unmoved(
                before, receiver.until(lambda received: received.fresh, 60.0, "an estimate meanwhile")
            )
        with rig.playing(BUS, rig.cycle_log(logs)):
            back = receiver.until(
                lambda received: received.fresh and not received.signals["EstimateGate"], 60.0, "its end"
            )
            assert_unmoved(before, back)


def test_flood_of_random_frames_changes_nothing(daemon: rig.Daemon, receiver: rig.BroadcastReceiver) -> None:
    """As many as a full bus of 500 kbit/s carries at most; a whole minute of it is in `test_minute`."""
    before = receiver.until(lambda received: received.fresh, 60.0, "an estimate")
    cangen("-g", "10", "-c", "80", "-n", "40000", "-I", "r", "-L", "r", "-D", "r")
    assert_unmoved(
        before, receiver.until(lambda received: received.fresh, 60.0, "an estimate after the flood")
    )
    assert daemon.alive


def test_spoofed_address_is_counted_and_not_used(daemon: rig.Daemon, receiver: rig.BroadcastReceiver) -> None:
    """Wild torque and engine speed in the engine's group, but from another address."""
    before = receiver.until(lambda received: received.fresh, 60.0, "an estimate")
    cangen("-g", "1", "-n", "1000", "-I", f"{FOREIGN_EEC1:08X}", "-L", "8", "-D", "r")
    after = receiver.until(lambda received: received.fresh, 60.0, "an estimate after the fault")
    assert_unmoved(before, after)
    foreign = "pgn_61444_from_0x31"
    rig.wait_until(
        lambda: daemon.status()["other_senders"].get(foreign) == 1000, 30.0, "the foreign frames' count"
    )


def test_outliers_from_the_right_address_do_not_move_a_mass(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver
) -> None:
    """Random bytes under the engine's own identifier, between its true frames: implausible jumps."""
    before = receiver.until(lambda received: received.fresh, 60.0, "an estimate")
    cangen("-g", "30", "-n", "60", "-I", f"{ENGINE_EEC1:08X}", "-L", "8", "-D", "r")
    assert_unmoved(
        before, receiver.until(lambda received: received.fresh, 60.0, "an estimate after the jumps")
    )


def test_short_frames_and_broken_transport_sessions_are_counted(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver
) -> None:
    """A short EEC1, and an EC1 announced by the engine whose first packet bears number seven."""

    def faults() -> tuple[int, int]:
        status = daemon.status()
        broken = sum(n for reason, n in status["transport"].items() if reason != "complete")
        return status["senders"]["pgn_61444_from_0x00"]["wrong_length"], broken

    short, broken = faults()
    cansend("0CF00400#F1B7", "18ECFF00#20270006FFE3FE00", "18EBFF00#07AABBCCDDEEFF00", "18ECFF00#20FF")
    rig.wait_until(
        lambda: faults()[0] > short and faults()[1] > broken, 30.0, "the counts of the short and the stray"
    )
    receiver.fresh(time.monotonic(), SOON_S, "malformed frames")


def test_bus_off_is_reported_and_over_with_the_next_frame(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver
) -> None:
    """A vcan cannot go bus-off, but the error frames of a controller that does can be sent on it."""
    cansend("20000040#0000000000000000")
    rig.wait_until(lambda: daemon.status()["bus"].get("bus_off", 0) >= 1, 30.0, "the bus-off count")
    cansend("20000100#0000000000000000")
    receiver.fresh(time.monotonic(), SOON_S, "the controller restarted")
    assert daemon.status()["bus"]["state"] == "up"


def test_bus_off_is_over_when_the_link_is_set_down_and_up(daemon: rig.Daemon, logs: Path) -> None:
    """What `restart-ms` does by itself, a person does with `ip link`: the socket is the same afterwards."""
    opened = daemon.status()["bus"]["opened"]
    with rig.BroadcastReceiver(BUS) as receiver:
        cansend("20000040#0000000000000000")
        rig.wait_until(lambda: daemon.status()["bus"]["state"] == "bus-off", 30.0, "bus-off")
        rig.ip("link", "set", BUS, "down")
        rig.wait_until(lambda: daemon.status()["bus"]["state"] == "down", 30.0, "the link to be down")
        rig.ip("link", "set", BUS, "up")
        with rig.playing(BUS, rig.cycle_log(logs)):
            receiver.fresh(time.monotonic(), RECOVERY_S, "the link was up again after bus-off")
    bus = daemon.status()["bus"]
    assert (bus["state"], bus["opened"]) == ("up", opened)


def test_address_lost_to_a_lower_name_is_left_and_another_claimed(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver, record_property: Record
) -> None:
    ours = receiver.until(lambda received: True, 60.0, "a broadcast").source
    cansend(f"18EEFF{ours:02X}#0000000000000000")  # NAME 0 wins against everybody
    begin_s = time.monotonic()
    moved = receiver.until(lambda received: received.source != ours, 60.0, "a broadcast from another address")
    assert 128 <= moved.source <= 247
    record_property("recovered_s", moved.t_s - begin_s)
    assert daemon.status()["broadcast"]["addresses_lost"] >= 1


@pytest.mark.guest
@pytest.mark.parametrize("hours", [-24, 24])
def test_clock_set(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver, logs: Path, hours: int, record_property: Record
) -> None:
    now_s = time.time()
    begin_s = time.monotonic()
    try:
        time.clock_settime(time.CLOCK_REALTIME, now_s + 3600 * hours)
        set_s = time.monotonic()
        # canplayer waits for the time of its next frame: set back, the one that plays is silent for a day
        again = rig.playing(BUS, rig.cycle_log(logs)) if hours < 0 else contextlib.nullcontext()
        with again:
            time.sleep(0.3)  # what was already on its way
            record_property("recovered_s", receiver.fresh(set_s, RECOVERY_S, f"the clock went {hours} h"))
    finally:
        time.clock_settime(time.CLOCK_REALTIME, now_s + time.monotonic() - begin_s)
    receiver.fresh(time.monotonic(), RECOVERY_S, "the clock went back to normal")


@pytest.mark.guest
def test_full_disk_and_read_only_directory_cost_only_the_saving(
    daemon: rig.Daemon, receiver: rig.BroadcastReceiver
) -> None:
    folder = str(daemon.folder)
    begin = daemon.log.stat().st_size
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], check=True)
    try:
        subprocess.run(["dd", "if=/dev/zero", f"of={folder}/ballast"], check=False, capture_output=True)
        rig.wait_until(
            lambda: "No space left" in daemon.messages(begin), 60.0, "the full disk to be reported"
        )
        receiver.fresh(time.monotonic(), SOON_S, "the disk was full")
        Path(folder, "ballast").unlink()
        saved = Path(folder, f"learned-{BUS}.json")
        rig.wait_until(saved.exists, 60.0, "the mass to be saved once there is space")
        remount = ["mount", "-o", "remount,ro", folder]  # refused while the daemon has a file of it open
        rig.wait_until(
            lambda: subprocess.run(remount, check=False, capture_output=True).returncode == 0,
            60.0,
            "nothing to be written for a moment",
        )
        rig.wait_until(
            lambda: "Read-only file system" in daemon.messages(begin),
            60.0,
            "the read-only disk to be reported",
        )
        receiver.fresh(time.monotonic(), SOON_S, "the disk was read-only")
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def test_survivor_is_the_one_that_was_started(running: rig.Daemon) -> None:
    """All of the above in one life, without an exception caught on the way."""
    status = running.status()
    assert status["failures"] == 0
    assert running.messages().count("started") == 1
    assert running.stop()[0] == 0


def assert_unmoved(before: rig.ReceivedBroadcast, after: rig.ReceivedBroadcast) -> None:
    """A mass may not move by more than 2 %, or than two of its own std where that has grown."""
    assert before.mass_kg is not None
    share = max(0.02, 0.02 * after.signals["EstimatedMassStd"])
    assert after.mass_kg == pytest.approx(before.mass_kg, rel=share), after.signals
