"""What other controllers report of the mass: every sender by its own address, against ours and a ticket."""

import numpy as np
import pytest

import canest
from canest.cli.main import run
from canest.cli.summary import result_lines
from canest.core.frames import EXTENDED, FrameBlock
from canest.offline.leg import Leg
from canest.offline.replay import ReplayResult
from canest.offline.reported_masses import ReportedMasses

CVW = 0x18FE7000


def with_reports(frames, masses_kg):
    """Return frames with the CVW of every sender in between, once a second."""
    rows = []
    for k, (source, mass_kg) in enumerate(masses_kg.items()):
        payload = b"\xff\xff" + (mass_kg // 10).to_bytes(2, "little") + b"\xff" * 4
        stamps = np.arange(frames.t_us[0] + 500_000 + 1000 * k, frames.t_us[-1], 1_000_000)
        rows += [(t, CVW | source | EXTENDED, payload) for t in stamps.tolist()]
    both = FrameBlock.concatenate([frames, FrameBlock.from_frames(rows)])
    return both[np.argsort(both.t_us, kind="stable")]


@pytest.fixture(scope="module")
def drive():
    return canest.demo_drive()


@pytest.fixture(scope="module")
def summary(drive):
    frames = with_reports(drive.frames, {0x0B: 21_300, 0x31: 22_600, 0x27: 0})
    return canest.replay(frames, "class8", mass_kg=21_000.0).summary


def test_every_sender_stands_by_its_own_address(summary):
    found = {mass["sender"]: mass for mass in summary["reported_masses"]}
    assert {name: mass["mass_kg"] for name, mass in found.items()} == {"0x0B": 21_300, "0x31": 22_600}
    assert found["0x0B"]["values"] == found["0x31"]["values"] == 180
    (leg,) = summary["legs"]
    assert leg["reported_kg"] == {"0x0B": 21_300, "0x31": 22_600}
    ours = 100 * (21_300 / leg["mass_kg"] - 1)
    assert found["0x0B"]["difference_pct"] == pytest.approx(ours, abs=0.01)
    assert found["0x31"]["agrees"] is False
    assert found["0x31"]["error_pct"] == pytest.approx(7.62, abs=0.01)


def test_nobody_owns_the_reports(summary):
    assert not any("reported_mass" in note for note in summary["notes"])


def test_the_terminal_names_who_differs_and_who_is_nearest_to_the_ticket(summary):
    shown = "\n".join(result_lines(ReplayResult("a.log", summary), []))
    assert "0x0B: 21,300 kg, +" in shown and "0x31 reports 6.1 % more than 0x0B" in shown
    assert "nearest to the truth is 0x0B, +1.4 % (others: 0x31 +7.6 %, ours " in shown


def test_the_report_has_a_table_of_them(drive, tmp_path, capsys):
    pytest.importorskip("plotly")
    write_candump(with_reports(drive.frames, {0x0B: 21_300, 0x31: 22_600}), tmp_path / "a.log")
    page = tmp_path / "a.html"
    assert run(["replay", str(tmp_path / "a.log"), "-c", "class8", "--report", str(page)]) == 0
    assert "Masses that other controllers report" in page.read_text()


def test_reports_never_move_the_estimate(drive):
    plain = canest.replay(drive.frames, "class8")
    other = canest.replay(with_reports(drive.frames, {0x0B: 9_000}), "class8")
    assert np.array_equal(plain.mass_kg, other.mass_kg, equal_nan=True)


def test_a_named_source_is_the_only_one_compared(drive):
    config = canest.load_config("class8", {"signals.reported_mass.source": 0x31})
    frames = with_reports(drive.frames, {0x0B: 21_300, 0x31: 22_600})
    (only,) = canest.replay(frames, config).summary["reported_masses"]
    assert only["sender"] == "0x31"


def test_a_makers_estimate_in_a_table(tmp_path):
    t = np.arange(0, 30, 0.1)
    rows = "".join(f"{s:.1f},80,{10 + s / 10:.2f},1.62\n" for s in t.tolist())
    (tmp_path / "car.csv").write_text("t_s,torque,speed,weight\n" + rows)
    (tmp_path / "car.yaml").write_text(
        "vehicle: {name: car, mass_min_kg: 1000, mass_max_kg: 2500, wheel_radius_m: 0.3, "
        "gear_ratios: {1: 9.0}, final_drive: 1.0,\n  drag_area_m2: 0.7, rolling_resistance: 0.01}\n"
        "dbc: []\nsignals:\n"
        "  engine_torque: {column: torque, unit: Nm}\n  vehicle_speed: {column: speed, unit: m/s}\n"
        "  reported_mass: {column: weight, unit: t}\n"
    )
    (only,) = canest.replay(tmp_path / "car.csv", tmp_path / "car.yaml").summary["reported_masses"]
    assert (only["sender"], only["mass_kg"]) == ("weight", 1_620)


def test_check_shows_each_value_beside_its_own_sender(drive, tmp_path, capsys):
    path = tmp_path / "a.log"
    # the address that is shown first is not the first that sends
    write_candump(with_reports(drive.frames[:20_000], {0x31: 22_600, 0x0B: 21_300}), path)
    run(["check", "-c", "class8", str(path), "-v"])
    lines = capsys.readouterr().out.splitlines()
    at = next(n for n, line in enumerate(lines) if line.strip().startswith("reported_mass"))
    assert "0x0B" in lines[at] and "2.13e+04" in lines[at]
    assert "0x31" in lines[at + 1] and "2.26e+04" in lines[at + 1]
    hint = next(line for line in lines if "signals.reported_mass" in line)
    assert "0x31 reports 6.1 % more than 0x0B" in hint and "name one" not in hint


def write_candump(frames, path):
    columns = (getattr(frames, name).tolist() for name in ("t_us", "can_id", "length", "data"))
    path.write_text(
        "".join(
            f"({t / 1e6:.6f}) can0 {i & 0x1FFFFFFF:08X}#{d.to_bytes(8, 'little')[:n].hex().upper()}\n"
            for t, i, n, d in zip(*columns, strict=True)
        )
    )


def test_each_leg_has_its_own_reports_where_the_clock_was_set_back(drive):
    frames = drive.frames
    reports = with_reports(frames, {0x0B: 20_000})
    again = with_reports(frames, {0x0B: 30_000})
    back_us = 60_000_000  # within what the first part took
    shift = frames.t_us[-1] - frames.t_us[0] - back_us
    masses = ReportedMasses(drive.config)
    first = FrameBlock(reports.t_us, reports.can_id, reports.length, reports.data)
    second = FrameBlock(again.t_us + shift, again.can_id, again.length, again.data)
    masses.push(first)
    masses.push(second)
    begin, end = int(frames.t_us[0]), int(frames.t_us[-1])
    took = end - begin
    legs = [
        Leg(begin / 1e6, end / 1e6, 2e4, 200.0, 1.0, status="valid", load=1, passed_us=(begin, end)),
        Leg(
            (begin + shift) / 1e6, (end + shift) / 1e6, 3e4, 200.0, 1.0, status="valid", load=2,
            passed_us=(end, end + took),
        ),
    ]  # fmt: skip
    _, found = masses.compared(legs)
    assert [leg.reported_kg["0x0B"] for leg in found] == [20_000, 30_000]


def test_two_clocks_in_turn_leave_the_reports_where_they_are(drive):
    """A second device's stamps, 30 s behind, between those of the first."""
    frames = drive.frames
    middle_us = frames.t_us[0] + 90_000_000
    early = with_reports(frames[frames.t_us < middle_us], {0x0B: 20_000})
    late = with_reports(frames[frames.t_us >= middle_us], {0x0B: 30_000})
    both = FrameBlock.concatenate([early, late])
    behind = FrameBlock(both.t_us - 30_000_000, both.can_id & 0 | 0x123, both.length, both.data)
    order = np.argsort(np.concatenate([np.arange(len(both)), np.arange(len(both)) + 0.5]), kind="stable")
    masses = ReportedMasses(drive.config)
    masses.push(FrameBlock.concatenate([both, behind])[order])
    ((stamps, _values),) = masses._kept.values()
    assert len(stamps) < 400 and stamps[-1] - stamps[0] < 200e6 + 200 * 30e6
