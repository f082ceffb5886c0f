"""Power cuts and copies that did not end: results outlive them, or are named and made again."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from canest.core.errors import CanestError
from canest.fleet.compact import compact
from canest.fleet.lake import Lake
from canest.fleet.query import ask
from canest.fleet.report import write_report
from canest.fleet.storage import Storage
from tests.fleet.conftest import command, files_of, run
from tests.fleet.test_compact import DAY, content, filled, outcome

KEY = "0000000000000001"


@pytest.fixture
def happened(monkeypatch) -> list[tuple[str, Path]]:
    """What was synced and removed, in order."""
    events: list[tuple[str, Path]] = []
    sync, remove = os.fsync, Storage.remove

    def synced(descriptor: int) -> None:
        events.append(("synced", Path(f"/proc/self/fd/{descriptor}").readlink()))
        sync(descriptor)

    def removed(storage: Storage, name: str) -> None:
        events.append(("removed", Path(storage.root, name)))
        remove(storage, name)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Storage, "remove", removed)
    return events


def test_a_result_is_on_the_disk_before_it_has_its_name(tmp_path, happened):
    folder = filled(tmp_path / "lake", outcome("1.log"))
    temporaries = [path for what, path in happened if what == "synced"]
    assert len(temporaries) == len(files_of(folder)) == 3
    assert all(path.name.endswith(".part") for path in temporaries)


def assert_synced_before_removed(happened: list[tuple[str, Path]], removed: int) -> None:
    """Nothing goes before what replaces it is on the disk, with its name."""
    named: set[Path] = set()
    for what, path in happened:
        if what == "removed":
            removed -= 1
            assert path.parent in named, f"{path} went first"
        elif path.name.endswith(".part"):
            named.discard(path.parent)
        else:
            named.add(path)
    assert not removed


def test_a_part_is_on_the_disk_before_what_it_replaces_goes(tmp_path, happened):
    folder = filled(tmp_path / "lake")
    happened.clear()
    compact(str(folder))
    assert_synced_before_removed(happened, removed=8)


def test_a_part_without_a_log_is_on_the_disk_before_the_one_with_it_goes(tmp_path, happened):
    folder = filled(tmp_path / "lake")
    compact(str(folder))
    Lake.create(str(folder)).commit(outcome("1.log", "0000000000000002"))
    parts = [event for event in happened if "part-" in event[1].name or event[1].is_dir()][-6:]
    assert_synced_before_removed(parts, removed=2)


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def zeroed(path: Path) -> None:
    path.write_bytes(bytes(path.stat().st_size))


damages = pytest.mark.parametrize("damage", [emptied, cut, zeroed])
tables = pytest.mark.parametrize("table", ["trips", "samples"])


def damaged(folder: Path, table: str, damage: Callable[[Path], None]) -> Path:
    """Damage a file of a table; return it."""
    path = min((folder / table / DAY).iterdir())
    damage(path)
    return path


@damages
def test_a_damaged_file_is_named_with_what_to_do(tmp_path, damage):
    folder = filled(tmp_path / "lake")
    path = damaged(folder, "trips", damage)
    for action in (
        lambda: ask(str(folder), "from trips"),
        lambda: write_report(str(folder), str(tmp_path / "report"), lambda share: None),
        lambda: compact(str(folder)),
    ):
        with pytest.raises(CanestError, match=r"is damaged: .* --resume removes it") as caught:
            action()
        assert str(caught.value).startswith(f"{path}: ")
    assert len(files_of(folder)) == 9


@damages
@tables
@pytest.mark.parametrize("joined", [False, True])
def test_a_run_removes_a_damaged_file_and_its_results_are_not_done(tmp_path, damage, table, joined):
    folder = filled(tmp_path / "lake")
    if joined:
        compact(str(folder))
    before = content(folder)
    path = damaged(folder, table, damage)
    lake = Lake.create(str(folder))
    assert [folder / name for name in lake.removed] == [path]
    logs = [f"{n}.log" for n in range(4)]
    missing = [log for log in logs if not lake.keys(log, with_samples=True)]
    assert len(missing) == (4 if joined else 1)
    assert all(lake.keys(log, with_samples=True) == {KEY} for log in logs if log not in missing)
    for log in missing:
        lake.commit(outcome(log))
    assert content(folder) == before
    compact(str(folder))
    assert content(folder) == before


def test_trips_alone_are_done_where_no_samples_are_asked_for(tmp_path):
    folder = filled(tmp_path / "lake", outcome("1.log"))
    for path in (folder / "samples" / DAY).iterdir():
        path.unlink()
    lake = Lake.create(str(folder))
    assert lake.keys("1.log") == {KEY}
    assert lake.keys("1.log", with_samples=True) == frozenset()


@pytest.mark.slow
def test_a_user_resumes_after_a_power_cut(lake, logs, manifest, tmp_path):
    folder = tmp_path / "lake"
    assert run(logs, folder, manifest).code == 0
    undisturbed = files_of(folder)
    path = min(folder.glob("samples/*/*/*.parquet"))
    emptied(path)
    done = command("query", folder, "from samples")
    assert (done.code, len(done.err.splitlines())) == (1, 1)
    assert done.err.startswith(f"error: {path}: is damaged")
    done = run(logs, folder, manifest, "--resume")
    assert (done.tally["done"], done.tally["present"]) == (1, 7), done.err
    assert done.tally["damaged"] == [path.relative_to(folder).as_posix()]
    assert "was damaged and is removed" in done.err
    assert files_of(folder) == undisturbed
