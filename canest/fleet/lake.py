"""The lake: which results it has, and how new ones get in.

A result is some rows of trips and of samples: a file of each, of one name, that of its log and of its key.
The trips come last, so a log whose trips are there is done; a result that has lost its samples is not. A
damaged file has no results, and the next run removes it. A log has one result: an older one goes when a
newer is there. `compact.py` joins the files of a vehicle and day to parts, which have several results.
"""

from __future__ import annotations

import json
import posixpath
from collections import defaultdict
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from canest.core.errors import UsageError
from canest.fleet.damaged import damage, damaged_files
from canest.fleet.job import Outcome
from canest.fleet.part_files import read_table, results_in, write_part
from canest.fleet.result_names import (
    MARKER,
    SUFFIX,
    is_part,
    log_id,
    log_of,
    part_of,
    result_in,
    result_of,
    superseded,
)
from canest.fleet.storage import Storage
from canest.fleet.tables import SCHEMA_VERSION
from canest.fleet.vehicle_lock import vehicle_lock
from canest.fleet.vehicle_names import vehicle_of
from canest.system.atomic_file import is_temporary

TRIPS_FOLDER, SAMPLES_FOLDER = "trips", "samples"
_READERS = 16  #: of the ends of parts, which may lie far away


@dataclass(slots=True)
class Lake:
    """A lake in a folder. results: digest of a log -> key -> its file of trips.

    without_samples: results that have trips alone. removed: damaged files that it had.
    """

    storage: Storage
    results: defaultdict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))
    without_samples: set[str] = field(default_factory=set)
    removed: list[str] = field(default_factory=list)

    @staticmethod
    def create(url: str) -> Lake:
        """Return the lake of a folder, made where there is none; its damaged files are removed.

        Errors: UsageError, OutputError, CanestError.
        """
        lake = Lake(Storage.of(url))
        if not lake._marked():
            strangers = lake.storage.is_local and any(map(_is_stranger, lake.storage.names("")))
            if strangers and not lake._marked():  # another run may have begun it meanwhile
                raise UsageError(
                    "is not empty and no lake",
                    where=url,
                    expected="a new folder, or the lake of an earlier run",
                )
            lake.storage.write(MARKER, json.dumps({"canest_lake": SCHEMA_VERSION}).encode() + b"\n")
        lake._read_results()
        return lake

    @staticmethod
    def open(url: str) -> Lake:
        """Return a lake that is there. Errors: UsageError."""
        lake = Lake(Storage.of(url))
        if not lake._marked():
            raise UsageError("no lake", where=url, expected=f"the folder -o of canest fleet run ({MARKER})")
        return lake

    def keys(self, log: str, *, with_samples: bool = False) -> frozenset[str]:
        """Return the keys of the results that a log has. with_samples: of those that have samples."""
        keys = frozenset(self.results.get(log_id(log), ()))
        if with_samples:
            return frozenset(key for key in keys if result_of(log, key) not in self.without_samples)
        return keys

    def vehicles(self, log: str) -> tuple[tuple[str, str], ...]:
        """Return key and vehicle of each result that a log has."""
        known = self.results.get(log_id(log), {})
        return tuple((key, vehicle_of(file.split("/")[1])) for key, file in known.items())

    def files(self, table: str) -> list[str]:
        """Return the files of a table, in order. Errors: CanestError, for a damaged one too."""
        sizes = self._sizes(table)
        for name in damaged_files(self.storage, sizes):
            raise damage(self.storage, name)
        return list(sizes)

    def commit(self, outcome: Outcome) -> None:
        """Write what a worker has not written, and remove the results that the log has of other keys.

        Without files nothing is written: the log cannot be read, or was done before. Errors: OutputError.
        """
        log, known = log_id(outcome.name), self.results[log_id(outcome.name)]
        if outcome.written:
            self._put(outcome, known.get(outcome.key, ""))
        for key in [key for key in known if key != outcome.key]:
            self._remove(known.pop(key), f"{log}-{key}")
        outcome.files.clear()

    def results_of(self, files: Iterable[str]) -> dict[str, frozenset[str]]:
        """Return the results of each file; parts are asked some at a time. Errors: CanestError."""
        names = list(files)
        parts = [name for name in names if is_part(name)]
        with ThreadPoolExecutor(_READERS) as readers:
            found = dict(
                zip(parts, readers.map(lambda name: results_in(self.storage, name), parts), strict=True)
            )
        return {name: found[name] if name in found else results_in(self.storage, name) for name in names}

    def superseded(self, files: Iterable[str]) -> set[str]:
        """Return which files of a table others replace: while parts are made, rows stand in two files.

        Errors: CanestError.
        """
        folders: defaultdict[str, list[str]] = defaultdict(list)
        for name in files:
            if name.endswith(SUFFIX):
                folders[posixpath.dirname(name)].append(name)
        mixed = [names for names in folders.values() if len(names) > 1 and any(map(is_part, names))]
        held = self.results_of(name for names in mixed for name in names)
        return set().union(*(superseded({name: held[name] for name in names}) for names in mixed))

    def remove_vehicle(self, folder: str) -> int:
        """Remove all files of a vehicle's folder (vehicle=NAME); return how many. Errors: OutputError."""
        with vehicle_lock(self.storage, folder):
            tables = (TRIPS_FOLDER, SAMPLES_FOLDER)
            names = [name for table in tables for name in self.storage.names(f"{table}/{folder}")]
            for name in names:
                self.storage.remove(name)
        return len(names)

    def _put(self, outcome: Outcome, old: str) -> None:
        """Write a result. old: the file that had it before, '' for none."""
        known, new = self.results[log_id(outcome.name)], outcome.written
        same_folder = posixpath.dirname(old) == posixpath.dirname(new)
        lacks_samples = outcome.samples is not None and result_in(new) in self.without_samples
        in_part = same_folder and is_part(old) and not lacks_samples
        if in_part and self.storage.exists(old):  # equal to what a part has
            if not outcome.files:  # the worker has written it
                with vehicle_lock(self.storage, new.split("/")[1]):
                    self.storage.remove(new)
                    self.storage.remove(SAMPLES_FOLDER + new.removeprefix(TRIPS_FOLDER))
            return
        for name, content in outcome.files.items():
            self.storage.write(name, content)
        # of the same key, but of a vehicle or day that is another now
        if old and not same_folder:
            self._remove(old, result_in(new))
        known[outcome.key] = new

    def _remove(self, trips: str, result: str) -> None:
        """Remove a result from the folder in which its trips were, wherever they stand there now."""
        folder = posixpath.dirname(trips).removeprefix(f"{TRIPS_FOLDER}/")
        with vehicle_lock(self.storage, posixpath.dirname(folder)):
            for table in (TRIPS_FOLDER, SAMPLES_FOLDER):
                self.storage.remove(f"{table}/{folder}/{result}{SUFFIX}")
                for name in self.storage.names(f"{table}/{folder}"):
                    if is_part(name) and result in results_in(self.storage, name):
                        self._rewrite(name, result)

    def _rewrite(self, part: str, without: str) -> None:
        left = results_in(self.storage, part) - {without}
        if left:
            table = read_table(self.storage.read(part), set(map(log_of, left)))
            folder = posixpath.dirname(part)
            self.storage.write(f"{folder}/{part_of(left)}", write_part([table], left))
            self.storage.sync(folder)
        self.storage.remove(part)

    def _marked(self) -> bool:
        return bool(self.storage.files.exists(f"{self.storage.root}/{MARKER}"))

    def _sizes(self, table: str) -> dict[str, int]:
        return {name: size for name, size in self.storage.sizes(table).items() if name.endswith(SUFFIX)}

    def _read_results(self) -> None:
        sampled = set().union(*self.results_of(self._whole_files(SAMPLES_FOLDER)).values())
        for name, results in self.results_of(self._whole_files(TRIPS_FOLDER)).items():
            self.without_samples |= results - sampled
            for result in results:
                log, _, key = result.partition("-")
                self.results[log][key] = name

    def _whole_files(self, table: str) -> list[str]:
        """Return the files of a table, without its damaged ones, which are removed."""
        sizes = self._sizes(table)
        for name in damaged_files(self.storage, sizes):
            with vehicle_lock(self.storage, name.split("/")[1]):
                self.storage.remove(name)
            self.removed.append(name)
            del sizes[name]
        return list(sizes)


def _is_stranger(name: str) -> bool:
    """Return whether a file of a folder is no part of a lake that another run begins right now."""
    return not is_temporary(name.rpartition("/")[2])
