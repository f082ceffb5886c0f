"""Further columns and formats of `canest replay -o`, and what several reports share."""

from __future__ import annotations

import csv
import gzip
import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from canest.cli.replay import command
from canest.core.errors import OutputError
from canest.core.frames import FrameBlock
from canest.logs import open_log
from canest.logs.candump_writer import CandumpWriter
from canest.node.estimate_frame import decode
from canest.simulation import simulate

ROOT = Path(__file__).resolve().parents[2]
#: half of what a decimal of est.csv is worth, and a little
HALF_STEPS = {
    "mass_kg": 0.051,
    "mass_std_kg": 0.051,
    "grade": 5.1e-7,
    "grade_std": 5.1e-7,
    "torque_Nm": 0.051,
}
HEADER = "t_s,mass_kg,mass_std_kg,grade,grade_std,status,gate"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.log"
    frames = simulate("mixed-36t").frames
    with CandumpWriter(path) as writer:
        writer.write(frames[frames.t_us < frames.t_us[0] + 60_000_000])
    return path


def replay(*arguments):
    done = CliRunner().invoke(command, [*map(str, arguments), "-c", "class8"], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.output


def rows(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_columns_come_behind_those_of_the_contract(log, tmp_path):
    replay(log, "-o", tmp_path / "est.csv")
    replay(log, "-o", tmp_path / "more.csv", "--columns", "speed_mps,distance_m,gear,residual_N")
    plain, more = ((tmp_path / name).read_text().splitlines() for name in ("est.csv", "more.csv"))
    assert plain[0] == HEADER
    assert more[0] == HEADER + ",speed_mps,distance_m,gear,residual_N"
    assert all(long.startswith(short + ",") for short, long in zip(plain[1:], more[1:], strict=True))
    table = rows(tmp_path / "more.csv")
    speed = np.array([float(row["speed_mps"] or 0) for row in table])
    distance = np.array([float(row["distance_m"]) for row in table])
    np.testing.assert_allclose(distance, np.cumsum(speed) * 0.02, atol=1.0)
    assert distance[-1] > 50
    assert {row["gear"] for row in table} - {""} <= {str(gear) for gear in range(1, 19)}


def test_the_end_of_the_name_is_the_format(log, tmp_path):
    for name in ("est.csv", "est.csv.gz"):
        replay(log, "-o", tmp_path / name, "--columns", "torque_Nm")
    assert gzip.decompress((tmp_path / "est.csv.gz").read_bytes()) == (tmp_path / "est.csv").read_bytes()


def test_a_name_without_an_ending_is_a_csv_as_the_help_says(log, tmp_path):
    for name in ("est.csv", "est"):
        replay(log, "-o", tmp_path / name)
    assert (tmp_path / "est").read_bytes() == (tmp_path / "est.csv").read_bytes()
    shown = " ".join(CliRunner().invoke(command, ["--help"]).output.split())
    assert "a name without an ending holds csv" in shown


@pytest.mark.skipif(importlib.util.find_spec("asammdf") is None, reason="asammdf (extra: formats)")
def test_an_mf4_has_the_same_columns(log, tmp_path):
    from asammdf import MDF

    replay(log, "-o", tmp_path / "est.csv", "--columns", "torque_Nm")
    replay(log, "-o", tmp_path / "est.mf4", "--columns", "torque_Nm")
    table = rows(tmp_path / "est.csv")
    with MDF(tmp_path / "est.mf4") as mdf:
        for name, half_step in HALF_STEPS.items():
            signal = mdf.get(name)
            expected = np.array([float(row[name] or "nan") for row in table])
            np.testing.assert_allclose(signal.samples, expected, rtol=0, atol=half_step)
            stamps = mdf.start_time.timestamp() + signal.timestamps
            np.testing.assert_allclose(stamps, [float(row["t_s"]) for row in table], rtol=0, atol=5e-7)
        assert mdf.start_time.timestamp() == float(table[0]["t_s"]) > 1e9
        for name in ("status", "gate"):
            assert [s.decode() for s in mdf.get(name).samples] == [row[name] for row in table]


@pytest.mark.skipif(importlib.util.find_spec("asammdf") is None, reason="asammdf (extra: formats)")
def test_an_mf4_of_a_clock_that_is_no_calendar_keeps_its_seconds(tmp_path):
    from asammdf import MDF

    replay(ROOT / "tests/data/kenworth/normal.log.xz", "-o", tmp_path / "est.mf4")
    with MDF(tmp_path / "est.mf4") as mdf:
        assert mdf.start_time.timestamp() == 0.0
        assert 0 <= mdf.get("mass_kg").timestamps[0] < 1


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="pyarrow (extra: formats)")
def test_a_parquet_read_back_by_pandas_has_the_same_columns(log, tmp_path):
    pandas = pytest.importorskip("pandas")
    for name in ("est.csv", "est.parquet"):
        replay(log, "-o", tmp_path / name, "--columns", "torque_Nm")
    read = pandas.read_parquet(tmp_path / "est.parquet")
    missing = {name: [""] for name in HALF_STEPS}  # a gate that is open has an empty name
    table = pandas.read_csv(tmp_path / "est.csv", keep_default_na=False, na_values=missing)
    assert list(read.columns) == list(table.columns)
    for name, half_step in HALF_STEPS.items() | {("t_s", 5e-7)}:
        np.testing.assert_allclose(read[name], table[name], rtol=0, atol=half_step)
    for name in ("status", "gate"):
        assert read[name].astype(str).tolist() == table[name].tolist()


def read_mcap(path):
    """Return (log_time, message, schema, channel) of each message, in the order of time."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [(m.log_time, json.loads(m.data), schema, c) for schema, c, m in reader.iter_messages()]


def as_text(message, name, decimals):
    return f"{message[name]:.{decimals}f}" if name in message else ""


@pytest.mark.skipif(importlib.util.find_spec("mcap") is None, reason="mcap (extra: mcap)")
def test_an_mcap_read_back_equals_the_csv(log, tmp_path):
    from jsonschema import Draft7Validator

    for name in ("est.csv", "est.mcap"):
        replay(log, "-o", tmp_path / name, "--columns", "torque_Nm,residual_N,gear")
    table, read = rows(tmp_path / "est.csv"), read_mcap(tmp_path / "est.mcap")
    assert len(table) == len(read) > 2900
    decimals = {
        "mass_kg": 1, "mass_std_kg": 1, "grade": 6, "grade_std": 6, "torque_Nm": 1,
        "residual_N": 1, "gear": 0,
    }  # fmt: skip
    for row, (t_ns, message, _, _) in zip(table, read, strict=True):
        assert t_ns == round(float(row["t_s"]) * 1e6) * 1000
        assert {name: row[name] for name in decimals} == {
            name: as_text(message, name, digits) for name, digits in decimals.items()
        }
        assert (message["status"], message["gate"]) == (row["status"], row["gate"])
    _, message, schema, channel = read[-1]
    assert (channel.topic, channel.message_encoding) == ("/canest/estimate", "json")
    assert (schema.name, schema.encoding) == ("canest.Estimate", "jsonschema")
    content = json.loads(schema.data)
    Draft7Validator.check_schema(content)
    assert set(message) <= set(content["properties"])
    for _, message, *_ in read[::100]:
        Draft7Validator(content).validate(message)


@pytest.mark.skipif(importlib.util.find_spec("mcap") is None, reason="mcap (extra: mcap)")
def test_the_schema_of_an_mcap_has_only_types_that_its_readers_know(log, tmp_path):
    """Foxglove refuses a schema with a list of types, such as a number or null."""
    replay(log, "-o", tmp_path / "est.mcap")
    types = {
        p["type"] for p in json.loads(read_mcap(tmp_path / "est.mcap")[0][2].data)["properties"].values()
    }
    assert types == {"number", "integer", "string"}


def test_without_its_package_a_format_names_what_to_install(log, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(OutputError, match=r"cannot write MCAP.*mcap package: .*install.*mcap"):
        replay(log, "-o", tmp_path / "est.mcap")
    assert not list(tmp_path.iterdir())


def test_a_log_of_frames_is_what_a_daemon_would_have_sent(log, tmp_path):
    replay(log, "-o", tmp_path / "est.csv")
    replay(log, "-o", tmp_path / "est.log")
    frames = FrameBlock.concatenate(list(open_log(tmp_path / "est.log")))
    assert set(np.diff(frames.t_us).tolist()) == {200_000}
    by_stamp = {round(float(row["t_s"]) * 1e6): row for row in rows(tmp_path / "est.csv")}
    for t_us, can_id, word in zip(
        frames.t_us.tolist(), frames.can_id.tolist(), frames.data.tolist(), strict=True
    ):
        received = decode(word.to_bytes(8, "little"), can_id)
        assert received.intact
        mass = by_stamp[t_us]["mass_kg"]
        assert not mass or abs(received.estimate.mass_kg - float(mass)) <= 1.1


def frames_of(path):
    return FrameBlock.concatenate(list(open_log(path)))


def test_a_blf_read_back_by_python_can_and_cantools_equals_the_csv(log, tmp_path):
    """Within the broadcast's resolution: 2 kg, 0.4 % of the mass, 0.01 %, 0.04 %."""
    import can
    import cantools

    for name in ("est.csv", "est.blf", "est.log"):
        replay(log, "-o", tmp_path / name)
    by_stamp = {round(float(row["t_s"]) * 1e6): row for row in rows(tmp_path / "est.csv")}
    message = cantools.database.load_file(ROOT / "dbc" / "canest.dbc").messages[0]
    with can.BLFReader(tmp_path / "est.blf") as reader:
        read = [(round(m.timestamp * 1e6), m.arbitration_id, bytes(m.data)) for m in reader]
    candump = frames_of(tmp_path / "est.log")
    assert [t_us for t_us, *_ in read] == candump.t_us.tolist()
    assert [word for *_, word in read] == [d.to_bytes(8, "little") for d in candump.data.tolist()]
    compared = 0
    for t_us, _, data in read:
        row, decoded = by_stamp[t_us], message.decode(data, decode_choices=True)
        assert str(decoded["EstimateStatus"]) == row["status"]
        if not row["mass_kg"]:
            continue
        assert abs(decoded["EstimatedMass"] - float(row["mass_kg"])) <= 1.05
        if decoded["EstimatedGradeStd"] < 10.0:  # beyond it the byte is full
            assert abs(decoded["EstimatedGrade"] - 100 * float(row["grade"])) <= 0.0051
            assert abs(decoded["EstimatedGradeStd"] - 100 * float(row["grade_std"])) <= 0.0401
        compared += 1
    assert compared > 100


@pytest.mark.parametrize("name", ["both.log", "both.blf"])
def test_estimates_beside_the_frames_of_the_log(log, tmp_path, name):
    replay(log, "-o", tmp_path / "est.log")
    replay(log, "-o", tmp_path / name, "--with-frames")
    recorded, own, both = frames_of(log), frames_of(tmp_path / "est.log"), frames_of(tmp_path / name)
    assert len(both) == len(recorded) + len(own)
    ours = np.isin(both.can_id, np.unique(own.can_id))
    for column in ("t_us", "can_id", "length", "data"):
        np.testing.assert_array_equal(getattr(both, column)[~ours], getattr(recorded, column))
        np.testing.assert_array_equal(getattr(both, column)[ours], getattr(own, column))
    assert (np.diff(both.t_us) >= 0).all()
    at = np.flatnonzero(ours)
    later = at[at + 1 < len(both)]
    assert (both.t_us[later + 1] > both.t_us[later]).all(), "ours comes behind what it was estimated from"


@pytest.mark.parametrize("start_s", [0.0, 1_790_000_000.123456])
def test_a_blf_keeps_the_clock_and_every_kind_of_frame(tmp_path, start_s):
    from canest.core.frames import ERROR, EXTENDED, REMOTE
    from canest.logs.blf_writer import BlfFrames

    start_us = round(start_s * 1e6)
    frames = [
        (start_us + 1, 0x18FF5A9E | EXTENDED, bytes(range(8))), (start_us + 1234, 0x123, b"abc"),
        (start_us + 2_000_001, 0x7FF | REMOTE, b""), (start_us + 2_000_002, 0x7 | ERROR, b""),
        (start_us + 3_599_999_999, 0x1 | EXTENDED, b"x"),
    ]  # fmt: skip
    with (tmp_path / "all.blf").open("wb") as file:
        writer = BlfFrames(file, tmp_path / "all.blf")
        writer.write(FrameBlock.from_frames(frames[:2]))
        writer.write(FrameBlock.from_frames(frames[2:]))
        writer.close()
    read = frames_of(tmp_path / "all.blf")
    assert read.t_us.tolist() == [t_us for t_us, *_ in frames]
    errors = [bool(can_id & ERROR) for _, can_id, _ in frames]
    assert [bool(can_id & ERROR) for can_id in read.can_id.tolist()] == errors
    sent = [(can_id, data) for _, can_id, data in frames if not can_id & ERROR]
    got = [
        (can_id, word.to_bytes(8, "little")[:length])
        for can_id, length, word in zip(
            *(c.tolist() for c in (read.can_id, read.length, read.data)), strict=True
        )
        if not can_id & ERROR
    ]
    assert got == sent


def test_a_frame_of_can_fd_fits_no_blf_of_frames(tmp_path):
    from canest.logs.blf_writer import BlfFrames

    with (tmp_path / "fd.blf").open("wb") as file, pytest.raises(OutputError, match=r"a frame of 12 bytes"):
        BlfFrames(file, tmp_path / "fd.blf").write(FrameBlock.from_frames([(0, 0x1, bytes(12))]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "est.csv", "--with-frames"), "--with-frames needs a log of frames: -o NAME.log or NAME.blf"),
        (("--with-frames",), "--with-frames needs a log of frames"),
        (
            ("-o", "est.csv", "--columns", "sped_mps"),
            "no such column, found 'sped_mps', expected a column, perhaps speed_mps$",
        ),
        (("-o", "est.csv", "--columns", "qqq"), r"one of speed_mps, .* \(14 in all: --columns list\)$"),
        (("--columns", "speed_mps"), "--columns needs a file"),
        (("-o", "est.log", "--columns", "speed_mps"), "a log of frames has no further columns"),
    ],
)
def test_columns_that_cannot_be_written(log, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(Exception, match=message):
        replay(log, *arguments)
    assert not list(tmp_path.iterdir())


def test_columns_are_listed(log):
    assert "distance_m           driven since the start of the log" in replay(log, "--columns", "list")


@pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="plotly (extra: report)")
def test_reports_of_several_logs_share_one_script_and_have_an_index(log, tmp_path):
    other = tmp_path / "other drive.log"
    other.write_bytes(log.read_bytes())
    replay(log, other, "--report", tmp_path / "reports", "-j", 1)
    folder = tmp_path / "reports"
    names = {path.name for path in folder.iterdir()}
    assert names == {"drive.html", "other drive.html", "index.html", "plotly.min.js"}
    assert (folder / "drive.html").stat().st_size < 500_000
    assert '<script src="plotly.min.js"></script>' in (folder / "drive.html").read_text()
    index = (folder / "index.html").read_text()
    assert '<a href="other%20drive.html">other drive</a>' in index
    assert "2 of 2 logs replayed" in index


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1"])
def test_estimates_on_a_redirected_stdout_stand_alone(log, tmp_path, name):
    """A summary behind them would overwrite their begin, since stdout knows nothing of what was appended."""
    alone, redirected = tmp_path / "est.csv", tmp_path / "stdout.csv"
    replay(log, "-o", alone)
    run = [sys.executable, "-m", "canest", "replay", str(log), "-c", "class8", "-o", name]
    with redirected.open("wb") as stdout:
        subprocess.run(run, check=True, stdout=stdout, cwd=ROOT)
    assert redirected.read_bytes() == alone.read_bytes()
    with redirected.open("wb") as stdout:
        refused = subprocess.run(
            [*run, "--json", "-"], stdout=stdout, stderr=subprocess.PIPE, cwd=ROOT, check=False
        )
    assert refused.returncode == 2
    assert b"--json: would overwrite -o" in refused.stderr
