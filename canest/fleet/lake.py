"""The lake: which results it has, and how new ones get in.

A result is some rows of trips and of samples: a file of each, of one name, that of its log and of its key.
The trips come last, so a log whose trips are there is done. A log has one result: an older one goes when a
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
from canest.fleet.job import Outcome
from canest.fleet.part_files import read_table, results_in, write_part
from canest.fleet.result_names import SUFFIX, is_part, log_id, log_of, part_of, result_in, superseded
from canest.fleet.storage import Storage
from canest.fleet.tables import SCHEMA_VERSION
from canest.fleet.vehicle_lock import vehicle_lock
from canest.system.atomic_file import is_temporary

MARKER = "canest-lake.json"
TRIPS_FOLDER, SAMPLES_FOLDER = "trips", "samples"
_READERS = 16  #: of the ends of parts, which may lie far away


@dataclass(slots=True)
class Lake:
    """A lake in a folder. results: digest of a log -> key -> its file of trips."""

    storage: Storage
    results: defaultdict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))

    @staticmethod
    def create(url: str) -> Lake:
        """Return the lake of a folder, made where there is none. Errors: UsageError, OutputError."""
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
        lake._read_names()
        return lake

    @staticmethod
    def open(url: str) -> Lake:
        """Return a lake that is there. Errors: UsageError."""
        lake = Lake(Storage.of(url))
        if not lake._marked():
            raise UsageError("no lake", where=url, expected=f"the folder -o of canest fleet run ({MARKER})")
        return lake

    def keys(self, log: str) -> frozenset[str]:
        """Return the keys of the results that a log has."""
        return frozenset(self.results.get(log_id(log), ()))

    def commit(self, outcome: Outcome) -> None:
        """Write what a worker has not written, and remove what the result replaces. Errors: OutputError."""
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
        if same_folder and is_part(old) and self.storage.exists(old):  # equal to what a part has
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
            self.storage.write(f"{posixpath.dirname(part)}/{part_of(left)}", write_part([table], left))
        self.storage.remove(part)

    def _marked(self) -> bool:
        return bool(self.storage.files.exists(f"{self.storage.root}/{MARKER}"))

    def _read_names(self) -> None:
        names = [name for name in self.storage.names(TRIPS_FOLDER) if name.endswith(SUFFIX)]
        for name, results in self.results_of(names).items():
            for result in results:
                log, _, key = result.partition("-")
                self.results[log][key] = name


def _is_stranger(name: str) -> bool:
    """Return whether a file of a folder is no part of a lake that another run begins right now."""
    return not is_temporary(name.rpartition("/")[2])
