"""Small files are joined to parts: nothing is lost, doubled or brought back, whatever happens meanwhile."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from canest.core.errors import UsageError
from canest.fleet import compact as compacting
from canest.fleet.compact import compact
from canest.fleet.job import Outcome
from canest.fleet.lake import MARKER, Lake
from canest.fleet.query import ask
from canest.fleet.result_names import is_part, result_of
from canest.fleet.storage import Storage
from canest.fleet.tables import POSITIONS, SAMPLES, TableWriter, trips_file
from tests.fleet.conftest import candump, command, files_of, run

DAY = "vehicle=t1/date=2026-03-01"


def outcome(
    log: str, key: str = "0000000000000001", place: str = DAY, positions: bool = False, rows: int = 3
) -> Outcome:
    """Return what a worker hands back: two legs, and samples that name the key by their speed."""
    legs = [{"log": log, "leg": leg, "status": "valid", "key": key, "mass_kg": 1e4} for leg in (1, 2)]
    columns = {**SAMPLES, **(POSITIONS if positions else {})}
    samples = TableWriter(columns, {"canest.key": key})
    values: dict[str, object] = {name: [None] * rows for name in columns}
    values |= {"log": [log] * rows, "t_s": np.arange(rows) * 1.0, "speed_mps": [int(key, 16)] * rows}
    if rows > 3:
        values["distance_m"] = np.random.default_rng(ord(log[0])).random(rows)
    samples.write(values)
    file = f"{place}/{result_of(log, key)}.parquet"
    files = {f"samples/{file}": samples.content(), f"trips/{file}": trips_file(legs, {"canest.key": key})}
    return Outcome(log, key=key, files=files, written=f"trips/{file}", trips=2, samples=rows)


def filled(folder: Path, *outcomes: Outcome) -> Path:
    lake = Lake.create(str(folder))
    for result in outcomes or [outcome(f"{n}.log") for n in range(4)]:
        lake.commit(result)
    return folder


def content(folder: Path) -> tuple[list[list[str]], list[list[str]]]:
    """Return what a user finds: each log's legs by key, and its samples by what they say of it."""
    trips = ask(str(folder), "select vehicle, log, leg, key from trips order by all")
    samples = ask(str(folder), "select vehicle, log, t_s, speed_mps from samples order by all")
    return list(trips.rows()), list(samples.rows())


def parts(folder: Path) -> list[str]:
    return sorted(name for name in files_of(folder) if is_part(name))


class Stop(BaseException):
    """The process ends here."""


class Meanwhile:
    """Lets something happen before the n-th change of a file, as another process would do it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.changes = 0
        self._at, self._happens, self._thread = 0, lambda: None, threading.Thread()
        for name in ("write", "remove"):
            real = getattr(Storage, name)

            def changed(storage: Storage, *arguments: object, real: Callable[..., None] = real) -> None:
                self.changes += 1
                if self.changes == self._at:
                    self._happens()
                real(storage, *arguments)

            monkeypatch.setattr(Storage, name, changed)

    def stop(self, at: int) -> None:
        """End the process there."""
        self._at, self.changes = at, 0

        def happens() -> None:
            raise Stop

        self._happens = happens

    def do(self, at: int, action: Callable[[], object]) -> None:
        """Begin something else there; it may have to wait for a lock."""
        self._at, self.changes = at, 0
        self._thread = threading.Thread(target=action)

        def happens() -> None:
            self._thread.start()
            self._thread.join(0.1)

        self._happens = happens

    def end(self) -> bool:
        """Wait until it has ended; return whether it ever began."""
        if self._thread.ident is None:
            return False
        self._thread.join(20)
        assert not self._thread.is_alive()
        return True


@pytest.fixture
def meanwhile(monkeypatch) -> Meanwhile:
    return Meanwhile(monkeypatch)


def test_a_vehicle_and_day_become_one_file_per_table_with_the_same_rows(tmp_path):
    folder = filled(tmp_path / "lake")
    before = content(folder)
    done = compact(str(folder))
    assert (done.folders, done.before, done.after) == (1, 8, 2)
    assert len(files_of(folder)) == 3
    assert content(folder) == before
    found = files_of(folder)
    assert compact(str(folder)).folders == 0
    assert files_of(folder) == found


def test_later_logs_join_the_part_and_the_order_of_runs_makes_no_difference(tmp_path):
    logs = [outcome(f"{n}.log") for n in range(4)]
    folder = filled(tmp_path / "late", *logs[2:])
    compact(str(folder))
    compact(str(filled(folder, *(outcome(f"{n}.log") for n in range(2)))))
    at_once = filled(tmp_path / "once")
    compact(str(at_once))
    assert files_of(folder) == files_of(at_once)


def test_a_log_whose_content_changed_leaves_its_part(tmp_path):
    folder = filled(tmp_path / "lake")
    compact(str(folder))
    Lake.create(str(folder)).commit(outcome("1.log", "0000000000000002"))
    expected = filled(tmp_path / "expected", *(outcome(f"{n}.log") for n in (0, 2, 3)),
                      outcome("1.log", "0000000000000002"))  # fmt: skip
    assert content(folder) == content(expected)
    compact(str(folder))
    compact(str(expected))
    assert files_of(folder) == files_of(expected)


def test_a_log_that_is_of_another_vehicle_now_leaves_its_part(tmp_path):
    folder = filled(tmp_path / "lake")
    compact(str(folder))
    lake = Lake.create(str(folder))
    lake.commit(outcome("1.log", place="vehicle=t2/date=2026-03-01"))
    trips, samples = content(folder)
    assert [row[:2] for row in trips if row[1] == "1.log"] == [["t2", "1.log"]] * 2
    assert (len(trips), len(samples)) == (8, 12)


def test_a_run_without_resume_finds_its_results_in_the_parts(tmp_path):
    folder = filled(tmp_path / "lake")
    compact(str(folder))
    before = files_of(folder)
    filled(folder)
    assert files_of(folder) == before


@pytest.mark.parametrize("rows", [0, 3])
def test_a_part_whose_samples_are_lost_is_mended_whatever_a_log_had_of_them(tmp_path, rows):
    folder = filled(tmp_path / "lake", outcome("a.log", rows=rows), outcome("b.log"))
    before = content(folder)
    compact(str(folder))
    (lost,) = folder.glob("samples/*/*/*")
    lost.unlink()
    filled(folder, outcome("a.log", rows=rows), outcome("b.log"))
    resumed = Lake.create(str(folder))
    assert all(resumed.keys(log, with_samples=True) for log in ("a.log", "b.log"))
    assert content(folder) == before


def test_files_of_other_columns_stay_apart(tmp_path):
    results = [outcome(f"{n}.log", positions=n > 1) for n in range(4)]
    folder = filled(tmp_path / "lake", *results)
    before = content(folder)
    compact(str(folder))
    assert len(parts(folder)) == 4
    assert content(folder) == before
    assert compact(str(folder)).folders == 0


def test_parts_are_not_larger_than_memory_allows(tmp_path, monkeypatch):
    folder = filled(tmp_path / "lake", *(outcome(f"{n}.log", rows=20_000) for n in range(9)))
    before = content(folder)
    size = sum(map(len, files_of(folder).values())) / 9
    monkeypatch.setattr(compacting, "PART_BYTES", int(3.5 * size))
    compact(str(folder))
    assert len(parts(folder)) == 6
    assert content(folder) == before


@pytest.mark.parametrize("number", range(1, 12))
def test_killed_at_any_step_no_row_is_lost_or_seen_twice_and_the_next_one_completes_it(
    tmp_path, meanwhile, number
):
    folder = filled(tmp_path / "lake")
    before = content(folder)
    undisturbed = tmp_path / "undisturbed"
    shutil.copytree(folder, undisturbed)
    compact(str(undisturbed))
    meanwhile.stop(number)
    try:
        compact(str(folder))
    except Stop:
        assert meanwhile.changes == number
    else:
        assert meanwhile.changes < number == 11  # 2 parts written, 8 files removed
    assert content(folder) == before
    assert Lake.create(str(folder)).keys("3.log") == {"0000000000000001"}
    compact(str(folder))
    assert files_of(folder) == files_of(undisturbed)


def replace_one(lake: Lake) -> None:
    lake.commit(outcome("1.log", "0000000000000002"))


def assert_replaced(folder: Path) -> None:
    trips, samples = content(folder)
    assert len(trips) == 8
    assert {row[3] for row in trips if row[1] == "1.log"} == {"0000000000000002"}
    assert len(samples) == 12
    assert {row[3] for row in samples if row[1] == "1.log"} == {"2.0"}


@pytest.mark.parametrize("number", range(1, 11))
def test_a_run_that_replaces_a_log_at_any_step_wins(tmp_path, meanwhile, number):
    folder = filled(tmp_path / "lake")
    lake = Lake.create(str(folder))  # of a run that began before
    meanwhile.do(number, lambda: replace_one(lake))
    compact(str(folder))
    assert meanwhile.end()
    assert_replaced(folder)


@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize("number", range(1, 9))
def test_parts_that_are_made_at_any_step_of_a_replacement_do_not_keep_what_it_replaces(
    tmp_path, meanwhile, number, joined
):
    folder = filled(tmp_path / "lake", *(outcome(f"{n}.log") for n in range(3)))
    if joined:
        compact(str(folder))
    filled(folder, outcome("3.log"))
    lake = Lake.create(str(folder))
    meanwhile.do(number, lambda: compact(str(folder)))
    replace_one(lake)
    assert meanwhile.end() == (number <= (8 if joined else 4))
    assert_replaced(folder)


@pytest.mark.parametrize("number", range(1, 9))
def test_a_run_that_replaces_a_log_while_a_killed_join_is_completed_wins(tmp_path, meanwhile, number):
    folder = filled(tmp_path / "lake")
    lake = Lake.create(str(folder))
    meanwhile.stop(2)  # the samples have their part, the trips have not
    with pytest.raises(Stop):
        compact(str(folder))
    meanwhile.do(number, lambda: replace_one(lake))
    compact(str(folder))
    assert meanwhile.end()
    assert_replaced(folder)


@pytest.mark.parametrize("number", range(1, 11))
def test_a_vehicle_that_is_forgotten_at_any_step_stays_forgotten(tmp_path, meanwhile, number):
    folder = filled(tmp_path / "lake")
    meanwhile.do(number, lambda: Lake.open(str(folder)).remove_vehicle("vehicle=t1"))
    compact(str(folder))
    assert meanwhile.end()
    assert list(files_of(folder)) == ["canest-lake.json"]


@pytest.mark.parametrize("number", range(1, 9))
def test_parts_that_are_made_while_a_vehicle_is_forgotten_are_forgotten_too(tmp_path, meanwhile, number):
    folder = filled(tmp_path / "lake")
    meanwhile.do(number, lambda: compact(str(folder)))
    Lake.open(str(folder)).remove_vehicle("vehicle=t1")
    assert meanwhile.end()
    assert list(files_of(folder)) == ["canest-lake.json"]


def test_two_that_join_at_once_give_what_one_does(tmp_path, meanwhile):
    folder, alone = filled(tmp_path / "lake"), filled(tmp_path / "alone")
    meanwhile.do(2, lambda: compact(str(folder)))
    compact(str(folder))
    assert meanwhile.end()
    compact(str(alone))
    assert files_of(folder) == files_of(alone)


@pytest.mark.slow
def test_a_user_joins_resumes_and_sees_what_changed(lake, logs, manifest, tmp_path):
    folder, source = tmp_path / "lake", tmp_path / "logs"
    shutil.copytree(lake, folder)
    shutil.copytree(logs, source)
    for number in range(3):
        (source / f"t1/more{number}.log").write_bytes(candump(10, 1_700_000_000 + 60 * number))
    assert run(source, folder, manifest, "--resume").code == 0
    sql = "select count(*), max(t_s) - min(t_s) from samples where log = 't1/more0.log'"
    assert command("query", folder, sql).out.splitlines()[1] == "9,8.0"
    before = command("query", folder, "from trips order by log, leg").out
    done = command("compact", folder)
    assert (done.code, done.out) == (0, "8 files of 1 vehicles and days became 2\n"), done.err
    assert command("query", folder, "from trips order by log, leg").out == before
    assert command("compact", folder).out == "nothing to join\n"
    (source / "t1/more0.log").write_bytes(candump(12, 1_700_000_000))
    again = run(source, folder, manifest, "--resume")
    assert (again.tally["done"], again.tally["present"]) == (1, 10), again.err
    assert command("query", folder, sql).out.splitlines()[1] == "11,10.0"


def test_a_lake_that_another_run_begins_is_that_runs_lake(tmp_path, monkeypatch):
    """Its marker grows under a temporary name, and takes its own between two looks at the folder."""
    folder = tmp_path / "lake"
    folder.mkdir()
    (folder / f".{MARKER}.canest-0123456789abcdef.part").write_bytes(b"{")
    assert Lake.create(str(folder)).results == {}

    begun = tmp_path / "begun"
    whole = (folder / MARKER).read_bytes()
    names = Storage.names

    def meanwhile(self, below):
        if not below:
            begun.mkdir()
            (begun / MARKER).write_bytes(whole)
        return names(self, below)

    with monkeypatch.context() as patched:
        patched.setattr(Storage, "names", meanwhile)
        Lake.create(str(begun))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    with pytest.raises(UsageError, match="is not empty and no lake"):
        Lake.create(str(tmp_path / "other"))
