"""No result replaces what it was made from, or another result."""

from __future__ import annotations

import lzma
import os
import shutil
from pathlib import Path

import pytest

from canest.simulation.reading import SCENARIOS
from canest.system.shipped_files import shipped

KENWORTH = Path(__file__).parents[1] / "data" / "kenworth" / "normal.log.xz"


@pytest.fixture
def log(tmp_path):
    return shutil.copy(KENWORTH, tmp_path / "drive.log.xz")


@pytest.mark.parametrize("option", ["-o", "--json", "--report"])
def test_a_log_is_never_written_over(canest, log, tmp_path, option):
    before = log.read_bytes()
    link = tmp_path / "link.csv"
    os.link(log, link)
    for name in (log, link):
        done = canest("replay", log, "-c", "kenworth", option, name)
        assert done.code == 2
        assert f"{option}: would overwrite the log" in done.err
    assert log.read_bytes() == before


def test_nor_a_table_in_the_directory_that_gets_the_estimates(canest, tmp_path):
    tables = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for table in tables:
        table.write_text("t_s,v\n0,1\n")
    done = canest("replay", *tables, "-c", "bmw-i3", "-o", tmp_path)
    assert done.code == 2
    assert all(table.read_text() == "t_s,v\n0,1\n" for table in tables)


def test_nor_the_config_the_truth_or_another_result(canest, log, tmp_path):
    truth = tmp_path / "drive.truth.csv"
    truth.write_text("t_s,mass_kg\n0,7000\n")
    replay = ("replay", log, "-c", "kenworth", "--truth", truth)
    for options in (["-o", truth], ["-o", tmp_path / "x.csv", "--json", tmp_path / "x.csv"]):
        done = canest(*replay, *options)
        assert done.code == 2
        assert "would overwrite" in done.err
    assert truth.read_text() == "t_s,mass_kg\n0,7000\n"
    assert not (tmp_path / "x.csv").exists()
    config = shutil.copy(shipped("configs") / "kenworth.yaml", tmp_path / "my.yaml")
    text = config.read_text()
    assert canest("replay", log, "-c", config, "-o", config).code == 2
    assert config.read_text() == text
    done = canest("compare", log, "-c", "kenworth", "--truth", truth, "--json", log)
    assert done.code == 2


@pytest.mark.parametrize("victim", ["revised.yaml", "diagnosis.json", "report.html"])
def test_nor_what_a_diagnosis_was_made_from(canest, log, tmp_path, victim):
    inputs = {"revised.yaml": shipped("configs") / "kenworth.yaml", "report.html": log, "diagnosis.json": log}
    taken = tmp_path / victim
    shutil.copy(inputs[victim], taken)
    before = taken.read_bytes()
    log, config = (log, taken) if victim.endswith(".yaml") else (taken, "kenworth")
    done = canest("diagnose", log, "-c", config, "-o", tmp_path)
    assert done.code == 2
    assert "-o: would overwrite the " in done.err
    assert taken.read_bytes() == before


def test_nor_the_scenario_that_a_drive_is_simulated_from(canest, tmp_path):
    scenario = tmp_path / "s1.yaml"
    shutil.copy(SCENARIOS / "pulse-21t.yaml", scenario)
    before = scenario.read_text()
    done = canest("simulate", scenario, "-o", tmp_path)
    assert done.code == 2
    assert done.err.startswith("error: -o: would overwrite the scenario")
    assert scenario.read_text() == before
    assert list(tmp_path.iterdir()) == [scenario]


def test_nor_what_check_looks_at(canest, log, tmp_path):
    before = log.read_bytes()
    config = shutil.copy(shipped("configs") / "kenworth.yaml", tmp_path / "my.yaml")
    dbc = shutil.copy(shipped("dbc") / "j1939.dbc", tmp_path / "j1939.dbc")
    for victim, what in ((log, "the log"), (config, "the config"), (dbc, "the DBC")):
        done = canest("check", log, "-c", config, "--json", victim)
        assert done.code == 2
        assert f"--json: would overwrite {what}" in done.err
    assert log.read_bytes() == before


def test_nor_what_the_daemon_runs_with(canest, tmp_path):
    config = shutil.copy(shipped("configs") / "vcan.yaml", tmp_path / "my.yaml")
    before = config.read_text()
    done = canest("run", "-c", config, "--record", config)
    assert done.code == 2
    assert "service.record: would overwrite the config" in done.err
    both = tmp_path / "both.log"
    done = canest("run", "-c", config, "--record", both, "--log-estimates", both)
    assert done.code == 2
    assert "service.log_estimates: would overwrite service.record" in done.err
    assert config.read_text() == before


@pytest.mark.parametrize("option", ["--record", "--log-estimates"])
def test_the_daemon_does_not_start_to_write_into_what_is_no_file(canest, tmp_path, option):
    config = shutil.copy(shipped("configs") / "vcan.yaml", tmp_path / "my.yaml")
    fifo = tmp_path / "pipe"
    os.mkfifo(fifo)
    for path, kind in ((fifo, "FIFO"), (tmp_path, "directory"), ("/dev/null", "device")):
        done = canest("run", "-c", config, option, path)
        assert done.code == 2
        assert f"{path} is a {kind}, expected a regular file" in done.err


def test_devices_may_be_named_as_often_as_one_likes(canest, log):
    done = canest("replay", log, "-c", "kenworth", "-o", "/dev/null", "--json", "/dev/null")
    assert done.code == 0


def test_warnings_of_many_logs_are_shown(canest, log, tmp_path):
    cut = tmp_path / "cut.log.xz"
    cut.write_bytes(log.read_bytes()[:20_000])
    done = canest("replay", log, cut, "-c", "kenworth", "--json", tmp_path / "all.json")
    assert done.code == 0
    (note,) = (line for line in done.out.splitlines() if line.startswith("note: "))
    assert note.startswith("note: cut.log.xz: ")
    assert "the log ends before it should" in note


@pytest.mark.parametrize("name", ["est.csv.part", ".est.csv.tmp"])
def test_a_log_that_is_named_like_half_a_result_is_kept(canest, tmp_path, name):
    log = tmp_path / name
    log.write_bytes(lzma.decompress(KENWORTH.read_bytes()))
    before = log.read_bytes()
    done = canest("replay", log, "-c", "kenworth", "-o", tmp_path / "est.csv")
    assert done.code == 0
    assert log.read_bytes() == before
    assert len((tmp_path / "est.csv").read_text().splitlines()) > 1000
