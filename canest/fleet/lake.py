"""The lake: which results it has, and how new ones get in.

A result is one file of trips and one of samples, of one name: that of its log and of its key. The trips come
last, so a log whose trips are there is done. A log has one result: an older one goes when a newer is there.
"""

from __future__ import annotations

import json
import posixpath
from collections import defaultdict
from dataclasses import dataclass, field

from canest.core.errors import UsageError
from canest.fleet.job import Outcome
from canest.fleet.result_key import log_id
from canest.fleet.storage import Storage
from canest.fleet.tables import SCHEMA_VERSION

MARKER = "canest-lake.json"


@dataclass(slots=True)
class Lake:
    """A lake in a folder. results: id of a log -> key -> its file of trips."""

    storage: Storage
    results: defaultdict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))

    @staticmethod
    def create(url: str) -> Lake:
        """Return the lake of a folder, made where there is none. Errors: UsageError, OutputError."""
        lake = Lake(Storage.of(url))
        if not lake._marked():
            if lake.storage.is_local and lake.storage.names(""):
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
        for name, content in outcome.files.items():
            self.storage.write(name, content)
        known = self.results[log_id(outcome.name)]
        if outcome.written:
            # of the same key, but of a vehicle or day that is another now
            old = known.get(outcome.key)
            if old is not None and old != outcome.written:
                self._remove(old)
            known[outcome.key] = outcome.written
        for key in [key for key in known if key != outcome.key]:
            self._remove(known.pop(key))
        outcome.files.clear()

    def remove_vehicle(self, folder: str) -> int:
        """Remove all files of a vehicle's folder (vehicle=NAME); return how many. Errors: OutputError."""
        names = [name for table in ("trips", "samples") for name in self.storage.names(f"{table}/{folder}")]
        for name in names:
            self.storage.remove(name)
        return len(names)

    def _remove(self, trips: str) -> None:
        self.storage.remove(trips)
        self.storage.remove("samples" + trips.removeprefix("trips"))

    def _marked(self) -> bool:
        return bool(self.storage.files.exists(f"{self.storage.root}/{MARKER}"))

    def _read_names(self) -> None:
        for name in self.storage.names("trips"):
            log, _, key = posixpath.basename(name).removesuffix(".parquet").partition("-")
            if key and name.endswith(".parquet"):
                self.results[log][key] = name
