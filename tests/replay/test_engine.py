"""The replay engine: scoring, tables, bad input, reasons."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config, parse_config
from canest.core.errors import LogError
from canest.core.estimates import Estimates
from canest.demo import DRIVE
from canest.logs.truth import Truth
from canest.offline.replay import ReplayResult, compiling_pays, replay
from canest.offline.scoring import Reference, Score

DATA = Path(__file__).parents[1] / "data"
KENWORTH = DATA / "kenworth" / "normal.log.xz"


def some_estimates(mass_kg: list[float], grade: list[float], first_us: int = 0) -> Estimates:
    n = len(mass_kg)
    nothing = np.zeros(n, np.uint8)
    t_us = first_us + 1_000_000 * np.arange(n, dtype=np.int64)
    mass, slope = np.array(mass_kg, float), np.array(grade, float)
    return Estimates(t_us, mass, 0.01 * mass, slope, np.full(n, 0.001), nothing, nothing)


class TestScore:
    def test_by_hand(self):
        truth = Truth(np.array([0, 10_000_000]), np.array([0.0, 0.1]), np.array([1000.0, 1000.0]))
        score = Score(truth, None, after_s=2)
        score.add(some_estimates([9e9, 9e9, 1010, 980, math.nan], [9, 9, 0.02, 0.03, math.nan]))
        errors = score.errors()
        assert errors["mass_rms_pct"] == pytest.approx(math.sqrt((1**2 + 2**2) / 2))
        assert errors["mass_max_pct"] == pytest.approx(2)
        assert errors["grade_rms_deg"] == pytest.approx(0, abs=1e-9)
        assert errors["without_estimate"] == 1

    def test_grade_in_degrees_of_the_angle(self):
        truth = Truth(np.array([0, 10_000_000]), np.array([0.0, 0.0]), None)
        score = Score(truth, None, after_s=0)
        score.add(some_estimates([1], [1.0]))
        assert score.errors()["grade_rms_deg"] == pytest.approx(45)
        assert score.errors()["mass_rms_pct"] is None

    def test_nothing_outside_the_truth_counts(self):
        truth = Truth(np.array([0, 1_000_000]), None, np.array([1000.0, 1000.0]))
        score = Score(truth, None, after_s=0)
        score.add(some_estimates([1010] * 10, [0] * 10))
        assert score.mass_samples == 2

    def test_a_truth_of_another_time_is_noted(self):
        truth = Truth(np.array([0, 300_000_000]), np.array([0.0, 0.1]), None)
        score = Score(truth, None, 5)
        score.add(some_estimates([1000] * 10, [0] * 10, first_us=1_700_000_000_000_000))
        message = "the truth is of another time, t_s 0 to 300, than the log's 1700000000 to 1700000009"
        assert score.notes() == [message]
        later = Score(truth, None, 5)
        later.add(some_estimates([1000] * 10, [0] * 10, first_us=295_000_000))
        assert later.notes() == []

    def test_a_true_mass_that_the_vehicle_cannot_have_is_noted(self):
        truth = Truth(np.array([0, 1]), None, np.array([1500.0, np.nan]))
        (message,) = Score(truth).beyond(7e3, 4e4)
        assert "true mass 1,500 kg is beyond vehicle.mass_min_kg = 7,000 kg" in message
        assert "vehicle.mass_max_kg = 40,000" in Score(truth, 2.1e7).beyond(7e3, 4e4)[0]
        assert Score(truth, 21e3).beyond(7e3, 4e4) == Score(None).beyond(7e3, 4e4) == []

    def test_what_comes_after_a_clock_set_back_counts(self):
        truth = Truth(np.array([0, 4_000_000_000]), None, np.array([1000.0, 1000.0]))
        score = Score(truth, None, after_s=5)
        score.add(some_estimates([1010] * 4, [0] * 4, first_us=3_600_000_000))
        for first_us in (10_000_000, 20_000_000):  # the first still within 5 s of driving
            score.add(some_estimates([1010] * 4, [0] * 4, first_us=first_us))
        assert score.mass_samples == 4 + 2 and score.notes() == []

    def test_what_was_wrong_with_the_table_of_the_truth_is_noted(self):
        score = Score(Truth(np.array([0, 1]), np.zeros(2), None, ("truth: line 3 skipped",)))
        assert score.notes() == ["truth: line 3 skipped"]
        score.add(some_estimates([1000] * 10, [0] * 10, first_us=1_700_000_000_000_000))
        assert [note[:9] for note in score.notes()] == ["truth: li", "the truth"]

    def test_a_truth_of_the_time_before_a_clock_set_back_is_of_this_time(self):
        score = Score(Truth(np.array([3_600_000_000, 3_700_000_000]), np.zeros(2), None), None, 5)
        score.add(some_estimates([1010] * 4, [0] * 4, first_us=3_600_000_000))
        score.add(some_estimates([1010] * 4, [0] * 4))
        assert score.notes() == []

    def test_cuts_do_not_matter(self):
        truth = Truth(np.array([0, 60_000_000]), np.array([0.0, 0.1]), np.array([900.0, 1100.0]))
        whole, cut = Score(truth, None, 5), Score(truth, None, 5)
        e = some_estimates(list(np.linspace(800, 1200, 50)), list(np.linspace(-0.1, 0.1, 50)))
        whole.add(e)
        for i in range(50):
            cut.add(Estimates(*(getattr(e, name)[i : i + 1] for name in Estimates.__slots__)))
        for key, value in whole.errors().items():
            assert cut.errors()[key] == pytest.approx(value)


TABLE_CONFIG = """
vehicle: {name: car, mass_min_kg: 1000, mass_max_kg: 2500, wheel_radius_m: 0.345, final_drive: 1.0,
  gear_ratios: {1: 9.665}, driveline_efficiency: 0.97, drag_area_m2: 0.69, rolling_resistance: 0.009}
dbc: []
signals:
  engine_torque: {column: torque_kNm, unit: kNm, stale_s: 0.5}
  vehicle_speed: {column: v_kmh, unit: km/h}
sampling: {time_column: seconds}
"""


def write_table(path: Path, mass_kg: float = 1600.0, changed: dict[int, str] | None = None) -> Path:
    """A car on the level that follows its torque, at 10 Hz: forces as in the config, by a sum of its own."""
    rows, v = ["seconds,v_kmh,torque_kNm"], 10.0
    for i in range(1800):
        torque = 60 + 45 * math.copysign(1, math.sin(i / 25))
        rows.append((changed or {}).get(i, f"{i / 10:.1f},{v * 3.6:.5f},{torque / 1000:.6f}"))
        force = torque * 9.665 * 0.97 / 0.345 - 0.5 * 1.2 * 0.69 * v * v - 0.009 * mass_kg * 9.80665
        v += 0.1 * force / mass_kg
        v = max(v, 4.0)
    path.write_text("\n".join(rows) + "\n")
    return path


class TestTables:
    def test_units_are_converted_and_the_mass_found(self, tmp_path):
        config = parse_config(TABLE_CONFIG)
        result = replay(write_table(tmp_path / "trip.csv"), config, reference=Reference(mass_kg=1600.0))
        assert result.summary["frames"] == 1800
        assert result.summary["samples"] == pytest.approx(9000, abs=10)
        assert result.summary["mass_kg"] == pytest.approx(1600, rel=0.06)

    def test_broken_cells_are_counted_and_the_rest_is_used(self, tmp_path):
        changed = {500: "50.0,nan,0.1", 501: "50.1,,0.1", 502: "50.2,36,text", 503: "garbage"}
        result = replay(write_table(tmp_path / "trip.csv", changed=changed), parse_config(TABLE_CONFIG))
        assert result.summary["skipped_lines"] == 1
        assert result.summary["gates"]["invalid"] > 0
        assert result.summary["mass_kg"] == pytest.approx(1600, rel=0.08)
        assert any("garbage" in note for note in result.warnings)

    def test_rows_in_reverse_are_the_reason(self, tmp_path):
        path = write_table(tmp_path / "trip.csv")
        header, *rows = path.read_text().splitlines()
        path.write_text("\n".join([header, *reversed(rows)]) + "\n")
        result = replay(path, parse_config(TABLE_CONFIG))
        assert result.summary["reason"].startswith("time runs backwards: 1,799 of 1,800 stamps")

    def test_rows_that_come_too_far_apart_are_the_reason(self, tmp_path):
        path = write_table(tmp_path / "trip.csv")
        header, *rows = path.read_text().splitlines()
        cells = [row.split(",", 1) for row in rows]
        path.write_text("\n".join([header, *(f"{float(t) * 1000},{rest}" for t, rest in cells)]) + "\n")
        result = replay(path, parse_config(TABLE_CONFIG))
        assert result.summary["reason"].startswith("1,799 of 1,800 stamps come more than 2 s")
        assert "in seconds?" in result.summary["reason"]

    def test_an_empty_file_is_empty_whatever_its_name(self, tmp_path):
        for config in (parse_config(TABLE_CONFIG), load_config("kenworth")):
            (tmp_path / "trip.csv").write_bytes(b"")
            result = replay(tmp_path / "trip.csv", config)
            assert result.summary["reason"] == "the log is empty: it holds no frames"

    def test_missing_column_is_the_reason(self, tmp_path):
        path = tmp_path / "trip.csv"
        path.write_text("seconds,v_kmh\n" + "".join(f"{i / 10},36\n" for i in range(100)))
        result = replay(path, parse_config(TABLE_CONFIG))
        assert result.summary["mass_kg"] is None
        assert "column torque_kNm" in result.summary["reason"]
        assert "not in the table" in result.summary["reason"]

    def test_config_of_columns_for_a_log_of_frames(self):
        with pytest.raises(LogError, match="table columns"):
            replay(KENWORTH, parse_config(TABLE_CONFIG))

    def test_one_absurd_first_row_costs_one_row(self, tmp_path):
        changed = {0: "0.0,9e299,0.1"}
        sound = replay(write_table(tmp_path / "sound.csv"), parse_config(TABLE_CONFIG)).summary
        hurt = replay(write_table(tmp_path / "hurt.csv", changed=changed), parse_config(TABLE_CONFIG)).summary
        assert hurt["updated"] > 0.97 * sound["updated"]

    def test_parquet_gives_what_csv_gives(self, tmp_path):
        parquet = pytest.importorskip("pyarrow.parquet")
        from pyarrow.csv import read_csv

        parquet.write_table(read_csv(write_table(tmp_path / "trip.csv")), tmp_path / "trip.parquet")
        config = parse_config(TABLE_CONFIG)
        a, b = (replay(tmp_path / f"trip.{kind}", config).summary for kind in ("csv", "parquet"))
        assert a["mass_kg"] == b["mass_kg"]
        assert a["samples"] == b["samples"]


def log_text() -> list[bytes]:
    import lzma

    return lzma.decompress(KENWORTH.read_bytes()).splitlines(keepends=True)


class TestBadInput:
    """Nothing that could be read is lost, and what could not is counted."""

    config = load_config("kenworth")

    def test_malformed_lines(self, tmp_path):
        lines = log_text()
        bad = {1000: b"(garbage\n", 2000: b"  (000.1)  can0  XYZ  [8]  00\n", 3000: b"\xff\xfe\x00\n"}
        path = tmp_path / "odd.log"
        path.write_bytes(b"".join(bad.get(i, b"") + line for i, line in enumerate(lines)))
        result = replay(path, self.config)
        clean = replay(KENWORTH, self.config)
        assert result.summary["skipped_lines"] == 3
        assert result.summary["frames"] == clean.summary["frames"]
        assert result.summary["mass_kg"] == clean.summary["mass_kg"]
        assert any("garbage" in note for note in result.warnings)

    def test_frames_of_wrong_length_are_reported(self, tmp_path):
        path = tmp_path / "short.log"
        path.write_text(
            "".join(
                f"({10 + n / 100:.6f}) can0 0CF00400#0102{'' if n % 2 else '03040506FFFF'}\n"
                for n in range(100)
            )
        )
        notes = replay(path, self.config).warnings
        assert "not decoded: 50 frames of wrong length" in notes

    def test_two_interfaces_in_one_log_are_reported_unless_one_is_chosen(self, tmp_path):
        path = tmp_path / "two.log"
        line = "({:.6f}) can{} 0CF00400#010203040506FFFF\n"
        path.write_text("".join(line.format(10 + n / 100, int(n % 4 == 0)) for n in range(100)))
        message = (
            "2 interfaces taken as one bus: can0 (75 frames), can1 (25 frames); --channel NAME takes one"
        )
        assert message in replay(path, self.config).warnings
        assert replay(path, self.config, channel="can0").warnings == []

    def test_a_reference_torque_that_nobody_sends_is_the_reason(self, tmp_path):
        config = load_config("kenworth", ["vehicle.reference_torque_Nm=null"])
        path = tmp_path / "nobam.log"
        path.write_bytes(
            b"".join(
                line
                for line in log_text()
                if b" 18EBFF" not in line
                and b" 18ECFF" not in line
                and b" 1CEBFF" not in line
                and b" 1CECFF" not in line
            )
        )
        reason = replay(path, config).summary["reason"]
        assert reason.startswith("reference_torque")
        assert "vehicle.reference_torque_Nm can give it instead" in reason

    def test_a_pedal_that_stands_for_the_brake_and_is_not_there_is_the_reason(self, tmp_path):
        path = tmp_path / "trip.csv"
        rows = [f"{n / 10},{36 + n / 100},{100 + n % 7},20" for n in range(600)]
        path.write_text("t_s,v_kmh,motor_Nm,ambient_C\n" + "\n".join(rows))
        reason = replay(path, load_config("bmw-i3")).summary["reason"]
        assert reason.startswith("accelerator ")
        assert "gates.brake.assume_when_pedal_released" in reason

    def test_truncated_archive_gives_what_it_holds(self, tmp_path):
        path = tmp_path / "cut.log.xz"
        path.write_bytes(KENWORTH.read_bytes()[:-40_000])
        result = replay(path, self.config)
        assert 1000 < result.summary["frames"] < 19957
        assert any("ends before it should" in note for note in result.warnings)

    def test_empty_log(self, tmp_path):
        path = tmp_path / "empty.log"
        path.write_bytes(b"")
        result = replay(path, self.config, output=tmp_path / "est.csv")
        assert result.summary["frames"] == result.summary["samples"] == 0
        assert "empty" in result.summary["reason"]
        assert (tmp_path / "est.csv").read_text().count("\n") == 1

    def test_log_of_another_vehicle(self):
        result = replay(DATA / "ip332" / "bike.log.xz", self.config)
        assert result.summary["status"] == "unestimated"
        assert "EEC1" in result.summary["reason"]

    def test_nothing_that_the_config_wants(self, tmp_path):
        path = tmp_path / "car.log"
        path.write_text("".join(f"({i * 0.01:.6f}) can0 1A0#0011223344556677\n" for i in range(300)))
        result = replay(path, self.config)
        assert result.summary["frames"] == 300
        assert "was never seen in 300 frames" in result.summary["reason"]

    def test_clock_set_back_by_an_hour_is_noted(self, tmp_path):
        lines = log_text()
        path = tmp_path / "jump.log"
        moved = [line.replace(b"(0", b"(36", 1) for line in lines[:10_000]]
        path.write_bytes(b"".join(moved + lines[10_000:]))
        result = replay(path, self.config)
        assert result.summary["mass_kg"] is not None
        assert any("clock set back" in note for note in result.warnings)

    def test_error_and_remote_frames_change_nothing(self, tmp_path):
        lines = log_text()
        odd = b" (000.500000)  can0  20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME\n"
        odd += b" (000.500000)  can0  0CF00400   [8]  remote request\n"
        path = tmp_path / "odd.log"
        at = next(i for i, line in enumerate(lines) if b"(000.5" in line)
        path.write_bytes(b"".join([*lines[:at], odd, *lines[at:]]))
        result = replay(path, self.config)
        assert result.summary["mass_kg"] == replay(KENWORTH, self.config).summary["mass_kg"]
        assert result.summary["not_decoded"] == {"remote frames": 1, "error frames": 1}
        assert "not decoded: 1 remote frames, 1 error frames" in result.summary["notes"]


def test_samples_that_another_address_owns_are_noted():
    anyone = "signals.vehicle_speed={message: CCVS1, signal: WheelBasedVehicleSpeed}"
    notes = replay(KENWORTH, load_config("kenworth", [anyone])).warnings
    assert notes == [
        "vehicle_speed comes from several addresses: not used 300 from 0x31; name one with source:"
    ]


def test_reading_in_small_blocks_gives_the_same_file(tmp_path, monkeypatch):
    config = load_config("class8")
    replay(DRIVE, config, output=tmp_path / "a.csv")
    from canest.logs import candump_reader

    monkeypatch.setattr(candump_reader, "_TEXT_BYTES", 3000)
    from canest.pipeline import table_map as module

    small = module.open_log
    monkeypatch.setattr(module, "open_log", lambda *a, **k: small(*a, **k, block_frames=100))
    replay(DRIVE, config, output=tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_compilation_is_for_long_logs_only(tmp_path):
    short, long = tmp_path / "a.log", tmp_path / "b.log"
    for path, size in ((short, 30_000_000), (long, 1_000_000_000)):
        with path.open("wb") as file:
            file.truncate(size)
    assert not compiling_pays([short])
    from canest.core import jit

    for logs, passes in (([long], 1), ([short] * 5, 1), ([short], 5)):
        assert compiling_pays(logs, passes) == jit.available()


def test_listener_sees_every_sample():
    seen = []
    result = replay(KENWORTH, load_config("kenworth"), listener=lambda s, e: seen.append((len(s), len(e))))
    assert sum(n for n, _ in seen) == result.summary["samples"]
    assert all(a == b for a, b in seen)


def test_warnings_under_their_old_name():
    result = ReplayResult("drive.log", {}, warnings=["ends before it should"])
    with pytest.warns(DeprecationWarning, match=r"ReplayResult\.warnings"):
        assert result.notes is result.warnings
