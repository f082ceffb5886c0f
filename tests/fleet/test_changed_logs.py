"""A log that has changed: no result of its earlier content stays, whether it can be read now or not."""

from __future__ import annotations

from pathlib import Path

import pytest

from canest.core.errors import LogError, OutputError
from canest.fleet import process_log as processing
from canest.fleet import run as fleet_run
from canest.fleet.job import Settings
from canest.fleet.manifest import Manifest, Rule
from canest.fleet.query import ask
from canest.fleet.run import Request, Tally, run_fleet
from canest.system.shipped_files import shipped
from tests.fleet.conftest import candump
from tests.fleet.test_run import vin_lines

BY_PATH, BY_VIN = Rule("*", "truck-1", "kenworth"), Rule("*", "", "kenworth")
NOISE = bytes(range(1, 256)) * 80


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    def run_here(jobs, bundles, settings, workers):
        return (processing.process_log(job, bundles, settings) for job in jobs)

    monkeypatch.setattr(fleet_run, "run_local", run_here)


@pytest.fixture
def source(tmp_path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    for number, name in enumerate(("a.log", "b.log")):
        start_s = 1_700_000_000 + 60 * number
        (folder / name).write_bytes(vin_lines(start_s - 1) + candump(3, start_s))
    return folder


def resumed(source: Path, rule: Rule) -> tuple[Tally, list[str]]:
    """Run with --resume; return what came of it, and the logs that the lake has trips and samples of."""
    lake = str(source.parent / "lake")
    request = Request(source.as_posix(), lake, Manifest((rule,)), Settings(), resume=True)
    tally = run_fleet(request, lambda logs: None, lambda outcome: None, lambda: None)
    trips, samples = (ask(lake, f"select distinct log from {t} order by log") for t in ("trips", "samples"))
    found = [row[0] for row in trips.rows()]
    assert [row[0] for row in samples.rows()] == found
    return tally, found


@pytest.mark.parametrize("rule", [BY_PATH, BY_VIN], ids=["by path", "by VIN"])
def test_a_log_that_cannot_be_read_any_more_loses_its_result(source, rule):
    assert resumed(source, rule)[1] == ["a.log", "b.log"]
    (source / "a.log").write_bytes(NOISE)
    tally, found = resumed(source, rule)
    assert (list(tally.failed), tally.present) == (["a.log"], 1)
    assert found == ["b.log"]


def test_what_has_not_changed_keeps_its_result_where_its_vin_cannot_be_read(source, monkeypatch):
    def refused(rules, path):
        raise LogError("takes more than the budget")

    resumed(source, BY_VIN)
    monkeypatch.setattr(processing, "choose_by_vin", refused)
    tally, found = resumed(source, BY_VIN)
    assert list(tally.failed) == found == ["a.log", "b.log"]


def test_a_result_that_cannot_be_written_leaves_the_old_one(source, monkeypatch):
    def full(*arguments):
        raise OutputError("no space left")

    resumed(source, BY_PATH)
    (source / "a.log").write_bytes(candump(4))
    monkeypatch.setattr(processing, "_replayed", full)
    tally, found = resumed(source, BY_PATH)
    assert (list(tally.failed), found) == (["a.log"], ["a.log", "b.log"])


@pytest.mark.parametrize("resume", [True, False])
def test_another_source_takes_no_result_away(source, resume):
    """Loggers give the same names again and again: 0001.log of two trucks, each in a folder of its own."""
    assert resumed(source, BY_PATH)[1] == ["a.log", "b.log"]
    other = source.parent / "other"
    other.mkdir()
    (other / "a.log").write_bytes(candump(5, 1_700_009_000))
    rule = Rule("*", "truck-2", "kenworth")
    lake = str(source.parent / "lake")
    request = Request(other.as_posix(), lake, Manifest((rule,)), Settings(), resume=resume)
    tally = run_fleet(request, lambda logs: None, lambda outcome: None, lambda: None)
    assert "another log of this path, of vehicle truck-1" in tally.failed["a.log"]
    found = ask(lake, "select distinct vehicle, log from trips order by log").rows()
    assert list(found) == [["truck-1", "a.log"], ["truck-1", "b.log"]]


def test_a_vehicle_has_a_new_name_in_the_manifest(source):
    resumed(source, BY_PATH)
    tally, found = resumed(source, Rule("*", "truck-9", "kenworth"))
    assert not tally.failed and found == ["a.log", "b.log"]
    lake = str(source.parent / "lake")
    assert list(ask(lake, "select distinct vehicle from trips").rows()) == [["truck-9"]]


def test_a_lake_below_source_has_no_logs(source):
    lake = str(source / "lake")
    for _ in range(2):
        request = Request(source.as_posix(), lake, Manifest((BY_PATH,)), Settings(), resume=True)
        tally = run_fleet(request, lambda logs: None, lambda outcome: None, lambda: None)
        assert (tally.logs, tally.passed_over, tally.failed) == (2, [], {})
    assert tally.present == 2


def test_the_name_of_a_config_is_no_part_of_a_key(source, tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text(shipped_config("kenworth"))
    resumed(source, Rule("*", "truck-1", str(tmp_path / "mine.yaml")))
    monkeypatch.chdir(tmp_path)
    tally, _ = resumed(source, Rule("*", "truck-1", "mine.yaml"))
    assert (tally.present, tally.done) == (2, 0)


def shipped_config(name):
    return (shipped("configs") / f"{name}.yaml").read_text(encoding="utf-8")
