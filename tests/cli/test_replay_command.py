"""`canest replay` as its contract says, on real logs and the bundled drive."""

from __future__ import annotations

import csv
import json
import os
import sys
import threading
from itertools import pairwise
from pathlib import Path

import pytest

from canest.demo import DRIVE, TRUTH

DATA = Path(__file__).parents[1] / "data"
KENWORTH = DATA / "kenworth" / "normal.log.xz"
BIKE = DATA / "ip332" / "bike.log.xz"
SUMMARY_KEYS = {
    "frames", "skipped_lines", "samples", "updated", "gates", "estimator", "mass_kg", "mass_std_kg", "wall_s",
}  # fmt: skip
ERROR_KEYS = {"mass_rms_pct", "mass_max_pct", "grade_rms_deg", "after_s"}


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


class TestKenworth:
    @pytest.fixture
    def done(self, canest, tmp_path):
        result = canest(
            "replay", KENWORTH, "-c", "kenworth", "-o", tmp_path / "est.csv", "--json", tmp_path / "s.json"
        )
        assert result.code == 0, result.err
        return result, json.loads((tmp_path / "s.json").read_text()), rows_of(tmp_path / "est.csv")

    def test_every_frame_is_read_and_the_truck_weighed(self, done):
        _, summary, _ = done
        assert set(summary) >= SUMMARY_KEYS
        assert summary["frames"] == 19957
        assert summary["skipped_lines"] == 0
        assert 4000 <= summary["mass_kg"] <= 36000
        assert summary["mass_std_kg"] > 0

    def test_rows_gates_and_samples_agree(self, done):
        _, summary, rows = done
        assert list(rows[0]) == ["t_s", "mass_kg", "mass_std_kg", "grade", "grade_std", "status", "gate"]
        assert len(rows) == summary["samples"]
        assert sum(not row["gate"] for row in rows) == summary["updated"]
        for gate, count in summary["gates"].items():
            assert sum(row["gate"] == gate for row in rows) == count
        assert summary["updated"] + sum(summary["gates"].values()) == summary["samples"]

    def test_numbers_once_there_stay(self, done):
        _, summary, rows = done
        with_mass = [bool(row["mass_kg"]) for row in rows]
        assert with_mass == sorted(with_mass)
        assert float(rows[-1]["mass_kg"]) == pytest.approx(summary["mass_kg"], abs=0.06)
        assert {row["status"] for row in rows} <= {"unestimated", "converging", "valid"}

    def test_ticks_are_20_ms_apart(self, done):
        _, _, rows = done
        ticks = [round(float(row["t_s"]) * 1000) for row in rows]
        assert all(b - a == 20 for a, b in pairwise(ticks))
        assert all(tick % 20 == 0 for tick in ticks)

    def test_a_person_reads_the_same(self, done):
        result, _, _ = done
        assert "19,957" in result.out
        assert "gates" in result.out


class TestBike:
    def test_torque_never_available_is_a_reason_not_a_failure(self, canest):
        done = canest("replay", BIKE, "-c", "kenworth", "--json", "-")
        assert done.code == 0
        summary = json.loads(done.out)
        assert summary["mass_kg"] is None
        assert summary["updated"] == 0
        assert summary["status"] == "unestimated"
        assert "not available in all 10,750 frames" in summary["reason"]
        assert "SPN 513" in summary["reason"]


class TestWithoutSamples:
    TABLE = "t_s,speed,torque\n"

    @pytest.mark.parametrize("content", ["", TABLE])
    def test_a_truth_costs_no_result(self, canest, tmp_path, content):
        log = tmp_path / ("a.csv" if content else "a.log")
        log.write_text(content)
        config = tmp_path / "c.yaml"
        config.write_text(
            "vehicle: {name: a, mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, drag_area_m2: 1, "
            "final_drive: 4, driveline_efficiency: 0.9, rolling_resistance: 0.01}\ndbc: []\nsignals:\n"
            "  engine_torque: {column: torque, unit: Nm}\n  vehicle_speed: {column: speed, unit: km/h}\n"
        )
        files = ("--json", tmp_path / "a.json", "--report", tmp_path / "a.html")
        done = canest("replay", log, "-c", config if content else "class8", "--mass", "21000", *files)
        assert done.code == 0, done.err
        assert "because" in done.out
        errors = json.loads((tmp_path / "a.json").read_text())["errors"]
        assert errors["settled"]["samples"] == 0 and errors["mass_rms_pct"] is None
        assert (tmp_path / "a.html").is_file()


class TestBundledDrive:
    def test_errors_against_truth(self, canest):
        done = canest("replay", DRIVE, "-c", "class8", "--truth", TRUTH, "--json", "-")
        assert done.code == 0, done.err
        errors = json.loads(done.out)["errors"]
        assert set(errors) >= ERROR_KEYS
        assert errors["after_s"] == 60
        assert 0 < errors["mass_rms_pct"] < 6
        assert errors["mass_rms_pct"] <= errors["mass_max_pct"]
        assert 0 < errors["grade_rms_deg"] < 0.25

    def test_constant_mass_and_later_start_of_counting(self, canest):
        done = canest("replay", DRIVE, "-c", "class8", "--mass", "21000", "--after", "90", "--json", "-")
        errors = json.loads(done.out)["errors"]
        assert errors["after_s"] == 90
        assert errors["mass_rms_pct"] < 6
        assert errors["grade_rms_deg"] is None

    @pytest.mark.parametrize("option", ["--mass=nan", "--mass=0", "--mass=inf", "--after=-1"])
    def test_a_truth_that_cannot_be_is_refused(self, canest, option):
        done = canest("replay", KENWORTH, "-c", "kenworth", option)
        assert done.code == 2
        assert "expected a number from" in done.err

    def test_a_folder_for_one_log_is_made(self, canest, tmp_path):
        assert canest("replay", KENWORTH, "-c", "kenworth", "-o", f"{tmp_path}/new/").code == 0
        assert (tmp_path / "new" / "normal.csv").is_file()

    def test_truth_auto_beside_the_log(self, canest, tmp_path):
        (tmp_path / "a.log.xz").write_bytes(DRIVE.read_bytes())
        (tmp_path / "a.truth.csv.xz").write_bytes(TRUTH.read_bytes())
        done = canest("replay", tmp_path / "a.log.xz", "-c", "class8", "--truth", "auto", "--json", "-")
        assert json.loads(done.out)["errors"]["mass_rms_pct"] is not None

    def test_estimator_and_start_from_the_command_line(self, canest):
        done = canest(
            "replay", DRIVE, "-c", "class8", "--estimator", "rlsmf", "--initial-mass", "9000",
            "--set", "estimator.options.forgetting_mass=0.999", "--json", "-",
        )  # fmt: skip
        assert done.code == 0, done.err
        assert json.loads(done.out)["estimator"] == "rlsmf"

    def test_parquet_holds_what_csv_holds(self, canest, tmp_path):
        parquet = pytest.importorskip("pyarrow.parquet")
        for name in ("est.csv", "est.parquet"):
            assert canest("replay", KENWORTH, "-c", "kenworth", "-o", tmp_path / name).code == 0
        table = parquet.read_table(tmp_path / "est.parquet").to_pylist()
        rows = rows_of(tmp_path / "est.csv")
        assert len(table) == len(rows)
        for row, other in zip(rows[-50:], table[-50:], strict=True):
            assert float(row["mass_kg"]) == pytest.approx(other["mass_kg"], abs=0.06)
            assert row["status"] == other["status"]
            assert row["gate"] == other["gate"]


class TestManyLogs:
    def test_one_bad_log_does_not_stop_the_rest(self, canest, tmp_path):
        good, bad = tmp_path / "good.log.xz", tmp_path / "bad.log"
        good.write_bytes(KENWORTH.read_bytes())
        bad.write_bytes(b"\x00\x01\x02 no log\n" * 50)
        done = canest(
            "replay", bad, good, BIKE, "-c", "kenworth", "-o", tmp_path / "out", "--json", tmp_path / "s.json"
        )
        assert done.code == 1
        assert "bad.log" in done.err
        summary = json.loads((tmp_path / "s.json").read_text())
        assert summary["failed"] == 1
        assert [Path(log["log"]).name for log in summary["logs"]] == ["bad.log", "good.log.xz", "bike.log.xz"]
        assert "error" in summary["logs"][0]
        assert (tmp_path / "out" / "good.csv").is_file()
        assert (tmp_path / "out" / "bike.csv").is_file()
        assert not (tmp_path / "out" / "bad.csv").exists()

    def test_several_at_a_time_give_what_one_at_a_time_gives(self, canest, tmp_path):
        logs = []
        for name in ("a", "b", "c"):
            logs.append(tmp_path / f"{name}.log.xz")
            logs[-1].write_bytes(KENWORTH.read_bytes())
        assert canest("replay", *logs, "-c", "kenworth", "-o", tmp_path / "one", "-j", 1).code == 0
        assert canest("replay", *logs, "-c", "kenworth", "-o", tmp_path / "two", "-j", 2).code == 0
        for name in ("a", "b", "c"):
            assert (tmp_path / "one" / f"{name}.csv").read_bytes() == (
                tmp_path / "two" / f"{name}.csv"
            ).read_bytes()

    def test_logs_of_one_name_in_different_folders(self, canest, tmp_path):
        logs = []
        for folder in ("truck1", "truck2"):
            (tmp_path / folder).mkdir()
            logs.append(tmp_path / folder / "monday.log.xz")
            logs[-1].write_bytes(KENWORTH.read_bytes())
        done = canest("replay", *logs, "-c", "kenworth", "-o", tmp_path / "out", "-j", 1)
        assert done.code == 0
        rows = [line.split()[0] for line in done.out.splitlines()]
        assert rows[1:3] == ["truck1/monday.log.xz", "truck2/monday.log.xz"]
        assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
            "truck1-monday.csv",
            "truck2-monday.csv",
        ]

    def test_pooled_errors(self, canest, tmp_path):
        for name in ("a", "b"):
            (tmp_path / f"{name}.log.xz").write_bytes(DRIVE.read_bytes())
            (tmp_path / f"{name}.truth.csv.xz").write_bytes(TRUTH.read_bytes())
        done = canest(
            "replay", tmp_path / "a.log.xz", tmp_path / "b.log.xz", "-c", "class8", "--truth", "auto",
            "--json", "-", "-j", 1,
        )  # fmt: skip
        summary = json.loads(done.out)
        single = summary["logs"][0]["errors"]
        assert summary["errors"]["mass_rms_pct"] == pytest.approx(single["mass_rms_pct"])
        assert summary["errors"]["grade_rms_deg"] == pytest.approx(single["grade_rms_deg"])

    def test_a_log_without_its_truth_is_named(self, canest, tmp_path):
        for name in ("a", "b"):
            (tmp_path / f"{name}.log.xz").write_bytes(KENWORTH.read_bytes())
        call = ["replay", tmp_path / "a.log.xz", tmp_path / "b.log.xz", "-c", "kenworth", "-j", 1]
        done = canest(*call, "--truth", "auto")
        assert (done.code, done.out) == (2, "")
        assert "no log has its truth beside it" in done.err
        (tmp_path / "b.truth.csv").write_text("t_s,mass_kg\n0,7700\n")
        done = canest(*call, "--truth", "auto")
        assert done.code == 0
        assert "note: no truth beside 1 of 2 logs: a.log.xz" in done.err


class TestOntoABus:
    def test_frames_arrive_in_the_logs_rhythm(self, canest, tmp_path):
        import can

        path = tmp_path / "short.log"
        lines = [f"({100 + 0.02 * i:.6f}) can0 18FEF100#{i:016X}" for i in range(20)]
        path.write_text("\n".join([*lines, "(100.400000) can0 123#R2"]) + "\n")
        with can.Bus(interface="virtual", channel="play-test") as bus:
            done = canest("replay", path, "--to", "virtual:play-test", "--speed", "4")
            assert done.code == 0, done.err
            received = []
            while (message := bus.recv(0)) is not None:
                received.append(message)
        assert [bytes(m.data) for m in received[:20]] == [i.to_bytes(8, "big") for i in range(20)]
        assert received[20].is_remote_frame
        # 0.4 s at four times real time; a busy machine may send the first frame late
        assert 0.04 < received[20].timestamp - received[0].timestamp < 1.0
        assert "21 frames sent" in done.out

    def test_a_clock_that_is_set_back_does_not_turn_the_rest_into_a_flood(self, canest, tmp_path):
        import can

        path = tmp_path / "back.log"
        stamps = [*range(7300, 7310), *range(100, 110)]
        path.write_text("".join(f"({t + 0.05 * i:.6f}) can0 123#00\n" for i, t in enumerate(stamps)))
        with can.Bus(interface="virtual", channel="play-back") as bus:
            assert canest("replay", path, "--to", "virtual:play-back", "--speed", "20").code == 0
            times = [bus.recv(0).timestamp for _ in stamps]
        # nine steps of 1.05 s, at twenty times real time, on either side of the jump
        assert times[9] - times[0] > 0.4
        assert times[19] - times[10] > 0.4

    def test_a_clock_that_is_set_in_mid_log_does_not_stop_the_rhythm_for_years(self, canest, tmp_path):
        import can

        path = tmp_path / "forward.log"
        stamps = [0, 0.5, 1_790_000_000, 1_790_000_000.5]
        path.write_text("".join(f"({t:.6f}) can0 123#00\n" for t in stamps))
        with can.Bus(interface="virtual", channel="play-on") as bus:
            done = canest("replay", path, "--to", "virtual:play-on", "--speed", "100")
            times = [bus.recv(0).timestamp for _ in stamps]
        assert 0.5 < times[2] - times[1] < 5.0  # a minute at a hundred times real time
        assert "4 frames sent" in done.out and "1 pause cut to a minute (497,222.2 h left out)" in done.out

    def test_a_result_that_is_asked_for_is_written_too_and_nothing_is_sent_before_all_is_right(
        self, canest, tmp_path
    ):
        path, output = tmp_path / "short.log", tmp_path / "est.csv"
        path.write_text("".join(f"({100 + 0.01 * i:.6f}) can0 0CF00400#{i:016X}\n" for i in range(20)))
        play = ("replay", path, "--to", "virtual:play-and-write", "-o", output)
        done = canest(*play)
        assert (done.code, done.out) == (2, "")
        assert "missing option -c CONFIG" in done.err
        done = canest(*play, "-c", "kenworth")
        assert done.code == 0, done.err
        assert "20 frames sent" in done.out
        assert output.read_text().startswith("t_s,mass_kg")

    def test_can_fd_frames_of_which_eight_bytes_are_known_are_not_sent(self, canest, tmp_path):
        path = tmp_path / "fd.log"
        path.write_text(f"(1.000000) can0 18FEF100##0{'AB' * 12}\n(1.000000) can0 18FEF100##0{'AB' * 8}\n")
        done = canest("replay", path, "--to", "virtual:play-fd")
        assert done.code == 0, done.err
        assert "1 frames sent to virtual:play-fd" in done.out
        assert "1 CAN FD frames of more than eight bytes not sent" in done.out


def test_who_waits_for_a_pipe_is_told_so(canest, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    pipe = tmp_path / "x.log"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=("(1.0) can0 0CF00400#0011223344556677\n",))
    writer.start()
    done = canest("replay", pipe, "-c", "class8")
    writer.join()
    assert done.code == 0, done.err
    assert f"note: {pipe} is a pipe: waiting for what writes to it" in done.err
    assert "1 (0 lines skipped)" in done.out
