"""One log of a fleet: what is asked of it, and what became of it. Both travel between processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from canest.fleet.bundle import Bundle
from canest.fleet.manifest import Rule
from canest.fleet.source import FoundLog
from canest.logs.budget import LogBudget

#: what a log may take of wall time: so much, and more by its size
TIMEOUT_S, TIMEOUT_S_PER_BYTE = 300.0, 60.0 / 25e6
MEMORY_MB = 1000.0


@dataclass(frozen=True, slots=True)
class Settings:
    """What holds for all logs of a run.

    samples_hz: rows per second of the samples, 0 for none. positions: keep where the vehicle was.
    vin_key: of the hash of VINs, None to keep them. memory_mb: that the process of a log may take.
    timeout_s: that a log may take, None by its size. version: of canest, with a digest of its code.
    lake: URL where workers write their results; '' where they hand them back. budget: what reading a log may
    cost. compiled: with numba's kernels, where a process has so many logs that loading them pays.
    """

    samples_hz: int = 1
    positions: bool = False
    vin_key: bytes | None = None
    memory_mb: float = MEMORY_MB
    timeout_s: float | None = None
    version: str = ""
    lake: str = ""
    budget: LogBudget = field(default_factory=LogBudget)
    compiled: bool = False


@dataclass(frozen=True, slots=True)
class FleetJob:
    """A log, and which rules may decide about it.

    rules: with the digest of each one's config. keys_in_lake: of results that need not be made again.
    results_in_lake: key and vehicle of all that the lake has of it.
    """

    log: FoundLog
    rules: tuple[tuple[Rule, str], ...]
    keys_in_lake: frozenset[str] = frozenset()
    results_in_lake: tuple[tuple[str, str], ...] = ()

    def timeout_s(self, settings: Settings) -> float:
        """Return how long it may take."""
        by_size = TIMEOUT_S + TIMEOUT_S_PER_BYTE * self.log.size
        return by_size if settings.timeout_s is None else settings.timeout_s


@dataclass(slots=True)
class Outcome:
    """What became of a log.

    error: why there is no result; '' where there is one. unmatched: why no vehicle or config fits.
    lacks: why the result is one of an empty log, of one without the needed signals, or of a part of a log.
    key: of the result; of what is there now, where a log cannot be read; '' where neither is known.
    present: the lake had it before. files: name below the lake -> content, trips last; empty where the worker
    wrote them itself. trips, samples: rows; None where no samples are asked for. final: trying again would
    not help.
    """

    name: str
    error: str = ""
    unmatched: str = ""
    lacks: str = ""
    key: str = ""
    present: bool = False
    files: dict[str, bytes] = field(default_factory=dict)
    written: str = ""  #: name of the file with its trips
    trips: int = 0
    samples: int | None = None
    final: bool = True
    unreachable: bool = False  #: the store did not answer


Bundles = Mapping[str, Bundle]  #: digest -> config with its databases
