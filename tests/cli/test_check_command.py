"""`canest check`: what is there, what is not, and what to do about it."""

from __future__ import annotations

import json
import lzma
import re
from pathlib import Path

import pytest

from canest.config import load_config
from canest.demo import DRIVE
from canest.doctor.missing_signals import missing_signal_warnings
from canest.system.shipped_files import shipped

DATA = Path(__file__).parents[1] / "data"
KENWORTH = DATA / "kenworth" / "normal.log.xz"
BIKE = DATA / "ip332" / "bike.log.xz"


def report(canest, *arguments) -> dict:
    done = canest("check", *arguments, "--json", "-")
    assert done.code == 0, done.err
    return json.loads(done.out)


def role(found: dict, name: str) -> dict:
    return next(r for r in found["roles"] if r["role"] == name)


def test_kenworth_has_everything(canest):
    found = report(canest, "-c", "kenworth", KENWORTH)
    assert found["stops"] == ""
    # nobody on this bus reports a mass, which is only compared
    assert {r["role"]: r["verdict"] for r in found["roles"] if r["verdict"] != "ok"} == {
        "reported_mass": "not found"
    }
    torque = role(found, "engine_torque_pct")
    assert torque["senders"][0]["address"] == 0
    assert 49 < torque["senders"][0]["rate_hz"] < 51
    assert torque["values"] == 1499


def test_a_log_of_the_wrong_kind_is_named(canest):
    found = report(canest, "-c", "bmw-i3", KENWORTH)
    assert found["stops"] == "the config maps only table columns, and this log holds frames"


def test_two_senders_of_one_group_are_both_shown(canest):
    senders = role(report(canest, "-c", "kenworth", KENWORTH), "brake_switch")["senders"]
    assert {s["address"]: s["valid"] > 0 for s in senders} == {0x00: False, 0x31: True}
    assert next(s for s in senders if s["address"] == 0)["not_available"] == 300


def test_bike_names_what_stops_the_estimator(canest):
    found = report(canest, "-c", "kenworth", BIKE)
    assert "engine_torque_pct" in found["stops"]
    assert "not available" in found["stops"]


def test_signal_from_another_address_is_suggested(canest):
    found = report(canest, "-c", "kenworth", BIKE)
    assert role(found, "vehicle_speed")["verdict"] == "elsewhere"
    assert any("0x0B" in hint and "vehicle_speed" in hint for hint in found["hints"])


def test_strict_exits_with_1_where_the_config_does_not_fit(canest):
    assert canest("check", "-c", "kenworth", BIKE, "--strict").code == 1
    assert canest("check", "-c", "kenworth", KENWORTH, "--strict").code == 0


def test_wrong_wheel_radius_shows_in_the_speeds(canest):
    found = report(canest, "-c", "kenworth", KENWORTH, "--set", "vehicle.wheel_radius_m=0.45")
    assert any("wheel_radius_m 0.50" in hint for hint in found["hints"])
    assert not any("wheel_radius" in hint for hint in report(canest, "-c", "kenworth", KENWORTH)["hints"])


def test_gear_outside_the_table_is_named(canest):
    found = report(canest, "-c", "kenworth", KENWORTH, "--set", "vehicle.gear_ratios={1: 3.1, 2: 1.81}")
    assert any("gears 3, 4" in hint for hint in found["hints"])


def test_a_log_in_reverse_stops_the_estimator(canest, tmp_path):
    path = tmp_path / "reversed.log"
    lines = lzma.decompress(KENWORTH.read_bytes()).splitlines(keepends=True)
    path.write_bytes(b"".join(reversed(lines)))
    assert report(canest, "-c", "kenworth", path)["stops"].startswith("time runs backwards: ")
    done = canest("replay", path, "-c", "kenworth")
    assert done.code == 0
    assert "because   time runs backwards: " in done.out


def test_differences_in_place_of_times_are_reported(canest, tmp_path):
    path = tmp_path / "delta.log"
    before, lines = 0.0, []
    for line in lzma.decompress(KENWORTH.read_bytes()).decode().strip().splitlines():
        stamp, rest = float(line.strip()[1:11]), line.split(")", 1)[1]
        lines.append(f" ({stamp - before:010.6f}){rest}\n")
        before = stamp
    path.write_text("".join(lines))
    message = report(canest, "-c", "kenworth", path)["stops"]
    assert message.startswith("time runs backwards: ") and "candump -t d writes differences" in message


def test_a_clock_that_stands_still_or_is_two_clocks_stops_the_estimator(canest, tmp_path):
    path = tmp_path / "flawed.log"
    lines = lzma.decompress(KENWORTH.read_bytes()).strip().splitlines(keepends=True)
    path.write_bytes(b"".join(b" (000.000000)" + line[line.index(b")") + 1 :] for line in lines))
    message = report(canest, "-c", "kenworth", path)["stops"]
    assert message.startswith("time stands still: all ") and message.endswith(" stamps are the same")
    assert f"because   {message}" in canest("replay", path, "-c", "kenworth").out
    # every third frame was stamped by a logger an hour ahead
    some = lines[:900]
    path.write_bytes(b"".join(x.replace(b"(0", b"(36", 1) if i % 3 else x for i, x in enumerate(some)))
    message = report(canest, "-c", "kenworth", path)["stops"]
    assert message.startswith("the time stamps jump back ") and message.endswith("of two clocks in one log")
    assert f"because   {message}" in canest("replay", path, "-c", "kenworth").out


def test_where_time_stands_still_nothing_is_compared(canest, tmp_path):
    """Values of one moment gave the wheel another radius."""
    path = tmp_path / "still.log"
    lines = lzma.decompress(DRIVE.read_bytes()).splitlines(keepends=True)
    path.write_bytes(b"".join(b"(1700000000.000001)" + line[line.index(b")") + 1 :] for line in lines))
    found = report(canest, "-c", "class8", path)
    assert found["stops"].startswith("time stands still: all ")
    assert not any("agree with" in hint for hint in found["hints"])
    assert "agree with" not in canest("replay", path, "-c", "class8").out


def test_a_gear_ratio_without_a_signal_is_named(canest, tmp_path):
    """A ratio has ways, of which one is enough; the gates that close without any do not say which."""
    source = "signals.gear={message: ETC2, signal: TransCurrentGear, source: 0x31}"
    ratio = "signals.gear_ratio={message: ETC2, signal: TransActualGearRatio, source: 0x31}"
    shaft = "signals.output_shaft_speed={message: ETC1, signal: Trans1OutputShaftSpeed, source: 0x31}"
    engine = "signals.engine_speed={message: EEC1, signal: EngSpeed, source: 0x31}"
    elsewhere = [part for change in (source, ratio, shaft, engine) for part in ("--set", change)]
    found = report(canest, "-c", "kenworth", KENWORTH, *elsewhere)
    assert role(found, "gear")["need"] == "ratio"
    assert found["stops"].startswith("no gear ratio: gear_ratio (actual transmission ratio (SPN 526))")
    assert "gear (current gear number" in found["stops"] and "output_shaft_speed" in found["stops"]
    done = canest("replay", KENWORTH, "-c", "kenworth", *elsewhere)
    assert "because   no gear ratio: gear_ratio (actual" in done.out
    assert not report(canest, "-c", "kenworth", KENWORTH, *elsewhere[:4])["stops"]


def test_messages_that_end_before_the_signal_are_the_reason(canest, tmp_path):
    path = tmp_path / "short.log"
    text = lzma.decompress(KENWORTH.read_bytes())
    path.write_bytes(
        b"".join(x for x in text.splitlines(keepends=True) if b"ECFF00" not in x and b"EBFF00" not in x)
        + b" (029.990000)  can0  18FEE300   [8]  FF FF FF FF FF FF FF FF\n"
    )
    found = report(canest, "-c", "kenworth", path, "--set", "vehicle.reference_torque_Nm=null")
    message = "no frame holds it: they end before it, or their multiplexor never selects it"
    assert role(found, "reference_torque")["hint"] == message
    assert f"({message})" in found["stops"]


def test_a_signal_that_comes_too_seldom_is_reported(canest, tmp_path):
    path = tmp_path / "slow.log"
    lines = lzma.decompress(KENWORTH.read_bytes()).splitlines(keepends=True)
    torque = [line for line in lines if b"0CF00400" in line]
    path.write_bytes(b"".join(line for line in lines if b"0CF00400" not in line or line in torque[::25]))
    found = report(canest, "-c", "kenworth", path)
    message = "comes every 0.5 s, and a value counts for 0.25 s only (stale_s)"
    assert role(found, "engine_torque_pct")["hint"] == message
    assert f"signals.engine_torque_pct: {message}" in found["hints"]
    slow = ("--set", "signals.engine_torque_pct.stale_s=1")
    assert not role(report(canest, "-c", "kenworth", path, *slow), "engine_torque_pct")["hint"]


def test_a_dbc_without_the_j1939_attribute_is_reported(canest, tmp_path):
    """Most hand-made DBC lack the attributes: their messages are then matched by the whole identifier."""
    dbc = (shipped("dbc") / "j1939.dbc").read_text()
    (tmp_path / "plain.dbc").write_text("".join(x for x in dbc.splitlines(True) if not x.startswith("BA_")))
    text = (shipped("configs") / "kenworth.yaml").read_text().replace("[j1939.dbc]", "[plain.dbc]")
    config = tmp_path / "plain.yaml"
    config.write_text(text)
    done = canest("check", "-c", config)
    assert done.code == 2 and "is no J1939 message" in done.err and 'VFrameFormat "J1939PG"' in done.err
    kept = [x for x in text.splitlines() if "reference_torque:" not in x]
    config.write_text(re.sub(r", source: 0x[0-9A-F]+", "", "\n".join(kept)))
    (hint,) = [h for h in report(canest, "-c", config, KENWORTH)["hints"] if "J1939PG" in h]
    assert hint.startswith("EEC1.") and "more) is matched by its whole identifier" in hint


def test_bus_of_eleven_bit_identifiers(canest, tmp_path):
    path = tmp_path / "car.log"
    path.write_text("".join(f"({i * 0.01:.6f}) can0 1A0#0011223344556677\n" for i in range(200)))
    found = report(canest, "-c", "kenworth", path)
    assert any("11-bit" in hint for hint in found["hints"])
    assert found["stops"]


def test_empty_log(canest, tmp_path):
    path = tmp_path / "empty.log"
    path.write_text("")
    assert "nothing was received" in report(canest, "-c", "kenworth", path)["stops"]


def test_what_was_not_read_or_not_decoded_is_noted(canest, tmp_path):
    lines = lzma.decompress(KENWORTH.read_bytes()).decode().splitlines(keepends=True)
    lines[100:100] = [
        " (000.500000)  vcan1  0CF00400   [8]  remote request\n",
        "(garbage\n",
    ]
    path = tmp_path / "odd.log"
    path.write_text("".join(lines))
    found = report(canest, "-c", "kenworth", path)
    assert "not decoded: 1 remote frames" in found["notes"]
    assert "line 102 skipped: not a candump line: '(garbage'" in found["notes"]
    assert any("--channel NAME takes one" in note for note in found["notes"])
    assert role(found, "engine_speed")["senders"][0]["remote_frames"] == 1
    assert "note  not decoded: 1 remote frames" in canest("check", "-c", "kenworth", path).out


def test_a_config_counts_its_signals_by_their_source(canest):
    def verdict(name, *changes):
        done = canest("check", "-c", name, *(part for change in changes for part in ("--set", change)))
        assert done.code == 0, done.err
        return done.out

    assert "signals all in " in verdict("kenworth")
    assert "signals all columns of a table, estimator" in verdict("bmw-i3")
    mixed = verdict("kenworth", "signals.altitude={column: alt, unit: m}")
    assert " in j1939.dbc and 1 columns of a table, estimator" in mixed


def test_table_columns(canest, tmp_path):
    path = tmp_path / "trip.csv"
    rows = "".join(f"{i / 10},{40 + i % 7},{30 + i % 11},20\n" for i in range(300))
    path.write_text("t_s,motor_Nm,v_kmh,throttle_pct\n" + rows)
    found = report(canest, "-c", "bmw-i3", path)
    assert role(found, "engine_torque")["verdict"] == "ok"
    assert role(found, "vehicle_speed")["high"] == 40 / 3.6
    assert role(found, "altitude")["verdict"] == "not found"


def test_a_person_reads_a_table(canest):
    done = canest("check", "-c", shipped("configs") / "kenworth.yaml", KENWORTH)
    assert "engine_torque_pct" in done.out
    assert "ready" in done.out


def test_live_bus(canest):
    import threading
    import time

    import can

    stop = threading.Event()

    def sender() -> None:
        with can.Bus(interface="virtual", channel="check-test") as bus:
            while not stop.is_set():
                bus.send(can.Message(arbitration_id=0x0CF00400, data=bytes(8), is_extended_id=True))
                time.sleep(0.01)

    thread = threading.Thread(target=sender)
    thread.start()
    try:
        found = report(
            canest, "-c", "class8", "--live", "--seconds", "0.5",
            "--set", "bus.interface=virtual", "--set", "bus.channel=check-test",
        )  # fmt: skip
    finally:
        stop.set()
        thread.join()
    assert role(found, "engine_speed")["verdict"] == "ok"
    assert role(found, "vehicle_speed")["verdict"] == "not found"


def test_live_bus_that_never_was_there(canest, monkeypatch):
    import can

    def absent(**_) -> None:
        raise OSError(19, "No such device")

    monkeypatch.setattr(can, "Bus", absent)
    bus = ("--set", "bus.interface=virtual", "--set", "bus.channel=gone")
    done = canest("check", "-c", "class8", "--live", "--seconds", "0.2", *bus)
    assert done.code == 1
    assert done.err == "error: virtual:gone: could not be opened in 0.2 s (No such device)\n"


def test_a_bracket_in_a_columns_name_is_printed(canest, tmp_path):
    (tmp_path / "trip.csv").write_text("t_s,v [/h]\n" + "".join(f"{i / 10},{i}\n" for i in range(99)))
    done = canest(
        "check", "-c", "bmw-i3", tmp_path / "trip.csv", "--set", "signals.vehicle_speed={column: 'v [/h]'}"
    )
    assert done.code == 0 and "v [/h]" in done.out


def test_friction_and_brakes_without_a_signal_are_reported(canest, tmp_path):
    silent = ("FEDF00#", "F0000F#", "FEF1", "F0010B#")  # EEC3, ERC1, CCVS1, EBC1
    with lzma.open(DRIVE, "rt") as file:
        lines = [line for line in file.readlines()[:20_000] if not any(s in line for s in silent)]
    log = tmp_path / "silent.log"
    log.write_text("".join(lines))
    hints = report(canest, log, "-c", "class8")["hints"]
    notes = json.loads(canest("replay", log, "-c", "class8", "--json", "-").out)["notes"]
    for sentences in (hints, notes):
        for what in ("engine's friction", "a retarder acts", "the brake acts"):
            assert any(what in sentence for sentence in sentences), (what, sentences)
    whole = tmp_path / "whole.log"
    with lzma.open(DRIVE, "rt") as file:
        whole.write_text("".join(file.readlines()[:20_000]))
    assert not any("no signal reports" in hint for hint in report(canest, whole, "-c", "class8")["hints"])


def test_a_time_in_milliseconds_is_refused_at_once(canest, tmp_path):
    log = tmp_path / "ms.csv"
    log.write_text("t_s,v_kmh,motor_Nm\n" + "".join(f"{20 * k * 1000},30,40\n" for k in range(6000)))
    for command, *more in (("check",), ("replay",), ("compare", "--mass", 1500)):
        done = canest(command, log, "-c", "bmw-i3", *more)
        assert done.code == 1
        assert "20000 s from row to row" in done.err


def test_a_log_of_frames_in_milliseconds_is_named_at_once(canest, tmp_path):
    """Frames come in bursts: fewer than half of the stamps follow a gap."""
    log = tmp_path / "ms.log"
    lines = lzma.decompress(KENWORTH.read_bytes()).decode().strip().splitlines()
    stamps = [float(line.strip()[1:11]) for line in lines]
    log.write_text(
        "".join(
            f"({1e3 * (t - stamps[0]):.3f}){line.split(')', 1)[1]}\n"
            for t, line in zip(stamps, lines, strict=True)
        )
    )
    found = report(canest, "-c", "kenworth", log)
    assert found["stops"].endswith("(sampling.hold_s) after the one before: are they in seconds?")
    assert found["samples"] < 50_000
    assert any("were left out: are they in seconds?" in note for note in found["notes"])
    assert f"because   {found['stops']}" in canest("replay", log, "-c", "kenworth").out


def test_an_unknown_text_is_not_called_a_table_for_certain(canest, tmp_path):
    log = tmp_path / "odd.csv"
    log.write_text("a;b;c\nx;y;z\n")
    done = canest("replay", log, "-c", "class8")
    assert (
        done.code == 1
        and "no log of frames" in done.err
        and "table of decoded signals?" in done.err
        and "Vehicle Spy" in done.err
    )


@pytest.mark.parametrize(
    ("roles", "message"),
    [
        (("brake_switch", "brake_pedal"), "No such role is mapped: on J1939 it is SPN 597, in CCVS1"),
        (("brake_switch",), None),  # the pedal shows it
        (("engine_friction_pct",), "no signal reports the engine's friction"),
    ],
)
def test_an_unmapped_role_is_reported_as_a_missing_signal(roles, message):
    config = load_config("class8")
    kept = {role: source for role, source in config.signals.items() if role not in roles}
    hints = missing_signal_warnings(config.model_copy(update={"signals": kept}), kept)
    assert (len(hints) == 1 and message in hints[0]) if message else not hints
    assert not missing_signal_warnings(config, config.signals)


def test_a_pedal_that_counts_as_braking_needs_no_brake():
    config = load_config("bmw-i3")
    assert not missing_signal_warnings(config, config.signals)


def test_an_engine_speed_alone_gives_no_speed_without_a_clutch_signal(canest, tmp_path):
    some = tmp_path / "engine.log"
    frame = "(1700000000.{:06d}) can0 0CF00400#F07D9128A000F0FF\n"
    some.write_text("".join(frame.format(20_000 * n) for n in range(40)))
    message = report(canest, "-c", "class8", some)["stops"]
    assert "engine_speed gives none while driveline_engaged and lockup_engaged and clutch_slip" in message


@pytest.mark.parametrize(
    ("removed", "words"),
    [
        ((), ", 0 effects\n"),
        (("gear_ratio",), ", 0 effects\n"),
        (("gear_ratios",), ", 0 effects\n"),
        (("gear_ratios", "gear_ratio"), "one gear, though gear is mapped: is vehicle.gear_ratios missing?"),
    ],
    ids=["both", "table", "ratio", "none"],
)
def test_a_gearbox_without_ratios_is_asked_about(canest, tmp_path, removed, words):
    lines = (shipped("configs") / "class8.yaml").read_text().splitlines(keepends=True)
    kept = [line for line in lines if not line.strip().startswith(tuple(f"{key}:" for key in removed) or "-")]
    (tmp_path / "truck.yaml").write_text("".join(kept))
    done = canest("check", "-c", tmp_path / "truck.yaml")
    assert done.code == 0 and words in done.out
