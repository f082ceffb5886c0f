"""Further columns and formats of `canest replay -o`, and what several reports share."""

from __future__ import annotations

import csv
import gzip
import importlib.util
import json
import sys

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


@pytest.mark.skipif(importlib.util.find_spec("asammdf") is None, reason="asammdf (extra: formats)")
def test_an_mf4_has_the_same_columns(log, tmp_path):
    from asammdf import MDF

    replay(log, "-o", tmp_path / "est.csv", "--columns", "torque_Nm")
    replay(log, "-o", tmp_path / "est.mf4", "--columns", "torque_Nm")
    table = rows(tmp_path / "est.csv")
    with MDF(tmp_path / "est.mf4") as mdf:
        for name in ("mass_kg", "torque_Nm"):
            signal = mdf.get(name)
            expected = np.array([float(row[name] or "nan") for row in table])
            np.testing.assert_allclose(signal.samples, expected, atol=0.051)
            np.testing.assert_allclose(signal.timestamps, [float(row["t_s"]) for row in table])
        assert [s.decode() for s in mdf.get("status").samples] == [row["status"] for row in table]


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


def test_without_its_package_a_format_says_what_to_install(log, tmp_path, monkeypatch):
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
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
