"""One log to its files of the lake: which vehicle, which config, replay, tables."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from canest.core import jit
from canest.core.errors import CanestError, LogError, OutputError
from canest.doctor.reasons import why_unestimated
from canest.doctor.warnings import stream_warnings
from canest.fleet import vehicle_names
from canest.fleet.bundle import Bundle
from canest.fleet.job import Bundles, FleetJob, Outcome, Settings
from canest.fleet.manifest import VIN_MARK, Rule
from canest.fleet.recording import CALENDAR_END_US, EPOCH_US, Recording
from canest.fleet.result_key import content_digest, result_key
from canest.fleet.result_names import SUFFIX, result_of
from canest.fleet.storage import Storage, StoreError, download
from canest.fleet.tables import trips_file
from canest.fleet.trips import trip_rows
from canest.fleet.vin import vin_of
from canest.logs.budget import log_budget
from canest.logs.log_warnings import log_warnings, truncation_warnings
from canest.offline.legs import Legs
from canest.offline.log_run import LogRun

#: hive's name for "no value": the folder of logs whose clock is no calendar
NO_DATE = "__HIVE_DEFAULT_PARTITION__"


def process_log(job: FleetJob, bundles: Bundles, settings: Settings) -> Outcome:
    """Return the result of a log, or why there is none. Whatever goes wrong with this log stays with it.

    An error has the key that the result would have, as far as it was known by then.
    """
    log = _Log(job.log.url)
    try:
        with log, log_budget(settings.budget):
            return _process(job, bundles, settings, log)
    except CanestError as error:
        key = "" if isinstance(error, OutputError) else log.key  # nothing is wrong with the log
        # by its name below SOURCE it is known, wherever its copy lies
        text = str(error).replace(f"{job.log.url}: ", "").replace(f"{log.copy}: ", "")
        return Outcome(job.log.name, error=text, key=key, unreachable=isinstance(error, StoreError))
    except Exception as error:
        return Outcome(job.log.name, error=f"unexpected {type(error).__name__}: {error}", key=log.key)


class _Log:
    """A log on this machine: itself, or a copy that is fetched when it is wanted and removed in the end.

    key: of its result, once its content is here and its vehicle known.
    """

    def __init__(self, url: str) -> None:
        self._url, self._stack = url, ExitStack()
        self.copy: Path | None = None
        self.key = ""

    def path(self) -> Path:
        """Return the file. Errors: LogError where it cannot be fetched, or is a pipe."""
        if "://" not in self._url:
            path = Path(self._url)
            if path.is_fifo():  # its content would be gone when it is read again
                raise LogError("is a pipe", expected="a file: canest replay reads a pipe")
            return path
        if self.copy is None:
            self.copy = download(self._url, Path(self._stack.enter_context(TemporaryDirectory())))
        return self.copy

    def __enter__(self) -> None:
        pass

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def _process(job: FleetJob, bundles: Bundles, settings: Settings, log: _Log) -> Outcome:
    name = job.log.name
    vehicle, rule, digest = job.rules[0][0].vehicle, *job.rules[0]
    if rule.asks_for_vin:
        path = log.path()
        try:
            chosen = choose_by_vin(job.rules, path)
        except LogError:
            log.key = _key_without_vin(job, bundles, settings, path)
            raise
        if isinstance(chosen, str):
            return Outcome(name, unmatched=chosen)
        vehicle, digest = chosen
    vehicle, bundle = vehicle_names.vehicle_name(vehicle, settings.vin_key), bundles[digest]
    revision = job.log.revision or content_digest(log.path())
    key = result_key(revision, bundle, vehicle, settings)
    if key in job.keys_in_lake:  # done before
        return Outcome(name, key=key, present=True)
    for old_key, old in job.results_in_lake:
        if old != vehicle and old_key != result_key(revision, bundle, old, settings):
            raise LogError(
                f"the lake has another log of this path, of vehicle {old}",
                expected="one SOURCE for all logs of a lake, or a lake for each; where only its name is "
                "new, canest fleet forget the old one",
            )
    path, log.key = log.path(), key
    return _replayed(job, path, bundle, vehicle, (key, settings))


def _key_without_vin(job: FleetJob, bundles: Bundles, settings: Settings, path: Path) -> str:
    """Return the key of a log whose VIN cannot be read: as in the lake, unless it has changed.

    Errors: CanestError.
    """
    revision = job.log.revision or content_digest(path)
    for key, vehicle in job.results_in_lake:
        if key in {result_key(revision, bundles[digest], vehicle, settings) for _, digest in job.rules}:
            return key
    return result_key(revision, bundles[job.rules[0][1]], "", settings)


def choose_by_vin(rules: Sequence[tuple[Rule, str]], path: Path) -> tuple[str, str] | str:
    """Return the vehicle and the config's digest that the log's own VIN leads to, or why there is none.

    Errors: LogError.
    """
    reader = vin_of(path)
    vin = reader.vin
    for rule, digest in rules:
        if rule.fits_vin(vin):
            return rule.vehicle or vin, digest
    if vin:
        return "no rule of the manifest fits the VIN in the log"
    if reader.found:
        return f"the log carries {len(set(reader.found.values()))} different VINs, and none of the engine"
    if any(not rule.pattern.startswith(VIN_MARK) for rule, _ in rules):  # it fits, but for the vehicle
        return (
            "the log carries no VIN: name its vehicle in the column vehicle of a manifest (--manifest FILE)"
        )
    return "no rule of the manifest fits, and the log carries no VIN"


def _replayed(
    job: FleetJob, path: Path, bundle: Bundle, vehicle: str, made_with: tuple[str, Settings]
) -> Outcome:
    """Replay the log and make its tables. Errors: CanestError."""
    key, settings = made_with
    jit.enable(settings.compiled)
    metadata = {"canest.key": key}
    recording, legs = Recording(job.log.name, settings, metadata), Legs()
    run = LogRun(path, bundle.unpack(), listeners=[recording], tick_listener=recording.take_ticks)
    with closing(run.reader):
        for estimates in run.estimates():
            legs.add(estimates, recording.taken_speeds())
    of_log = _of_log(run, job.log.name, bundle, key)
    rows = list(trip_rows(legs, recording, of_log))
    partition = f"{vehicle_names.folder_of(vehicle)}/date={_date(recording.first_us)}"
    file = result_of(job.log.name, key) + SUFFIX
    outcome = Outcome(job.log.name, key=key, trips=len(rows), written=f"trips/{partition}/{file}")
    lacks = [] if run.pipeline.samples else [of_log["reason"]]
    outcome.lacks = "; ".join(lacks + truncation_warnings(run.reader))
    if recording.samples is not None:
        outcome.samples = recording.samples.rows
        outcome.files[f"samples/{partition}/{file}"] = recording.samples.content()
    # last: a log whose trips are there is done
    outcome.files[outcome.written] = trips_file(rows, metadata)
    if settings.lake:
        lake = Storage.of(settings.lake)
        for name, content in outcome.files.items():
            lake.write(name, content)
        outcome.files.clear()
    return outcome


def _of_log(run: LogRun, name: str, bundle: Bundle, key: str) -> dict[str, Any]:
    """Return the columns that all rows of a log share."""
    intake = run.pipeline.intake
    notes = log_warnings(run.reader) + run.table_map.warnings()
    notes += stream_warnings(intake, run.pipeline.stuck_ticks)
    return {
        "log": name,
        "reason": "" if run.pipeline.updated else why_unestimated(run),
        "frames": run.reader.frames,
        "skipped_lines": run.reader.skipped_lines,
        "notes": "; ".join(notes),
        "estimator": run.config.estimator.name,
        "config": Path(bundle.name).name,
        "key": key,
    }


def _date(first_us: int | None) -> str:
    """Return the day, UTC, on which a log begins."""
    if first_us is None or not EPOCH_US < first_us < CALENDAR_END_US:
        return NO_DATE
    return datetime.fromtimestamp(first_us // 1_000_000, UTC).strftime("%Y-%m-%d")
