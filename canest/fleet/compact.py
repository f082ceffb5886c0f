"""`canest fleet compact`: joins the small files of a vehicle and day to parts.

Parts are written first, then what they replace is removed, under the lock of the vehicle. A run may go on
meanwhile: its new files wait for the next time; what it replaces it takes out of the part (`Lake.commit`).
"""

from __future__ import annotations

import os
import posixpath
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field

from canest.fleet.lake import SAMPLES_FOLDER, TRIPS_FOLDER, Lake
from canest.fleet.part_files import columns_of, read_table, write_part
from canest.fleet.result_names import SUFFIX, log_of, part_of, superseded
from canest.fleet.vehicle_lock import vehicle_lock

#: a part has about so many bytes of both tables at most; whatever is half as large already stays as it is
PART_BYTES = 128 << 20
_REQUESTS = 8  #: to a store at a time


@dataclass(slots=True)
class Compacted:
    """What was done. folders: of vehicles and days that had files to join. before, after: files in them."""

    folders: int = 0
    before: int = 0
    after: int = 0
    logs_left: int = field(default=0)  #: with two results, of which the next run with --resume removes one


def compact(url: str, progress: Callable[[float], None] = lambda share: None) -> Compacted:
    """Join the files of each vehicle and day; a second time there is nothing to do.

    Errors: UsageError for no lake, CanestError.
    """
    lake = Lake.open(url)
    total, folders = Compacted(), _folders(lake)
    workers = len(os.sched_getaffinity(0)) if lake.storage.is_local else _REQUESTS
    with ThreadPoolExecutor(workers) as pool, _given_up(pool):
        for number, done in enumerate(pool.map(lambda folder: _Folder(lake, folder).compact(), folders), 1):
            total.logs_left += done.logs_left
            if done.after < done.before:
                total.folders += 1
                total.before += done.before
                total.after += done.after
            progress(number / len(folders))
    return total


@contextmanager
def _given_up(pool: ThreadPoolExecutor) -> Iterator[None]:
    """Drop what waits where the work ends early: Ctrl-C, a full disk."""
    try:
        yield
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise


def _folders(lake: Lake) -> list[str]:
    """Return the folders, vehicle=.../date=..., that have several files of a table."""
    files: Counter[tuple[str, str]] = Counter()
    for table in (TRIPS_FOLDER, SAMPLES_FOLDER):
        for name in lake.files(table):
            files[table, posixpath.dirname(name).removeprefix(f"{table}/")] += 1
    return sorted({folder for (_, folder), number in files.items() if number > 1})


@dataclass(slots=True)
class _Bundle:
    """What becomes one part.

    sources: file -> content, of both tables. rows: file -> its results that are taken.
    """

    results: set[str] = field(default_factory=set)
    sources: dict[str, bytes] = field(default_factory=dict)
    rows: dict[str, set[str]] = field(default_factory=dict)
    trips: int = 0  #: files of trips
    size: int = 0  #: bytes of all files

    def add(self, trips: str, contents: Mapping[str, bytes], rows: Mapping[str, set[str]]) -> None:
        """Take a file of trips with its samples."""
        self.results |= rows[trips]
        self.sources |= contents
        for name, results in rows.items():
            self.rows.setdefault(name, set()).update(results)
        self.trips += 1
        self.size += sum(map(len, contents.values()))


class _Folder:
    """One vehicle and day."""

    def __init__(self, lake: Lake, folder: str) -> None:
        self._lake, self._storage, self._folder = lake, lake.storage, folder

    def compact(self) -> Compacted:
        """Join its files. Errors: CanestError."""
        before = self._count()
        while True:
            with vehicle_lock(self._storage, posixpath.dirname(self._folder)):
                self._tidy()
                trips = self._lake.results_of(self._files(TRIPS_FOLDER))
                left = _with_two_results(trips)
                bundle = next((b for b in self._bundles(trips, left) if b.trips > 1), None)
                if bundle is None:
                    return Compacted(1, before, self._count(), len(left))
                self._join(bundle)
                self._tidy()

    def _count(self) -> int:
        return len(self._files(TRIPS_FOLDER)) + len(self._files(SAMPLES_FOLDER))

    def _files(self, table: str) -> list[str]:
        return [name for name in self._storage.names(f"{table}/{self._folder}") if name.endswith(SUFFIX)]

    def _tidy(self) -> None:
        """Remove what parts replace, once the disk has the parts."""
        for table in (TRIPS_FOLDER, SAMPLES_FOLDER):
            replaced = superseded(self._lake.results_of(self._files(table)))
            if replaced:
                self._storage.sync(f"{table}/{self._folder}")
            for name in sorted(replaced):
                self._storage.remove(name)

    def _bundles(self, trips: Mapping[str, frozenset[str]], left: set[str]) -> Iterator[_Bundle]:
        """Yield what is to be joined: files of equal columns, and not too large."""
        sizes = self._storage.sizes(f"{TRIPS_FOLDER}/{self._folder}")
        sizes |= self._storage.sizes(f"{SAMPLES_FOLDER}/{self._folder}")
        samples = self._lake.results_of(self._files(SAMPLES_FOLDER))
        has_samples = {result: name for name, results in samples.items() for result in results}
        alike: defaultdict[str, _Bundle] = defaultdict(_Bundle)
        for name, results in trips.items():
            rows: defaultdict[str, set[str]] = defaultdict(set, {name: set(results)})
            for result in results & has_samples.keys():
                rows[has_samples[result]].add(result)
            large = 2 * sum(sizes.get(file, 0) for file in rows) > PART_BYTES
            if large or not results or {log_of(result) for result in results} & left:
                continue
            contents = {file: self._storage.read(file) for file in rows}
            kind = "\n".join(sorted({columns_of(content) for content in contents.values()}))
            if alike[kind].size + sum(map(len, contents.values())) > PART_BYTES:
                yield alike.pop(kind)
            alike[kind].add(name, contents, rows)
        yield from alike.values()

    def _join(self, bundle: _Bundle) -> None:
        """Write a part. Errors: OutputError."""
        part = f"{self._folder}/{part_of(bundle.results)}"
        for table in (SAMPLES_FOLDER, TRIPS_FOLDER):  # the trips come last
            sources = [name for name in bundle.sources if name.startswith(f"{table}/")]
            if sources and f"{table}/{part}" not in sources:  # a join that was killed has left it
                self._storage.write(f"{table}/{part}", _joined(bundle, sources))


def _joined(bundle: _Bundle, sources: Sequence[str]) -> bytes:
    tables = [read_table(bundle.sources[name], set(map(log_of, bundle.rows[name]))) for name in sources]
    return write_part(tables, set().union(*(bundle.rows[name] for name in sources)))


def _with_two_results(files: Mapping[str, frozenset[str]]) -> set[str]:
    """Return the logs (their digests) that have two different results in a folder."""
    results = set().union(*files.values()) if files else set()
    count = Counter(map(log_of, results))
    return {log for log, times in count.items() if times > 1}
