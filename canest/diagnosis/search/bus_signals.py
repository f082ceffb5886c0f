"""Every signal on the bus that the model does not use, ranked by how much of the remainder it explains.

The answer is often there: a fan speed, a power take-off, a steering angle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from canest.config.schema import Config
from canest.config.sections import Source
from canest.core.errors import ConfigError
from canest.core.frames import ERROR, EXTENDED, REMOTE, FloatColumn, IntColumn, MonotonicClock
from canest.core.table_block import TableBlock
from canest.decode.database import is_j1939
from canest.decode.decoder import Decoder
from canest.decode.groups import MAX_GROUPS, Want, build_groups, exact_id
from canest.decode.j1939 import pgn_of, source_of
from canest.diagnosis.data.drive import Run
from canest.diagnosis.data.least_squares import Matrix, held_out
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.set_search import Search
from canest.logs.format_detection import open_log
from canest.logs.memory import MemoryLog
from canest.pipeline.table_map import open_for

if TYPE_CHECKING:
    from cantools.database.can import Database, Message

#: a signal must have spoken this often, and on this share of the windows
MIN_SAMPLES, MIN_COVERAGE = 20, 0.8
_STALE_S = 10.0
#: a signal of which the model's own quantities leave less than this share repeats them
REPEATED_SHARE = 0.2
#: the null and the global address: a config can name neither as a source
_NOBODY = {0xFE, 0xFF}


@dataclass(frozen=True)
class Ranked:
    """One unused signal: where it is, and the share of the held-out remainder that it explains.

    repeats: it says what the model knows anyway, another speed or torque, and is the cause of nothing.
    """

    name: str
    source: Source
    explained: float
    switches: bool
    repeats: bool


def rank_bus_signals(config: Config, problem: Problem, search: Search) -> list[Ranked]:
    """Decode whatever the DBCs know, rank it against the remainder; best first, at most twenty."""
    used = {(s.message, s.signal, s.source) for s in config.signals.values()} | {
        (None, s.column, None) for s in config.signals.values() if s.column
    }
    per_drive = [signals_of(part.drive.path, config, part.drive.channel) for part in problem.parts]
    names = set.intersection(*(set(found) for found in per_drive)) if per_drive else set()
    residual = problem.whiten(search.residual_N)
    base = search.local_matrix()
    left = held_out(residual, base, problem.chunk)
    known = _known_columns(problem)
    total = float((left**2).sum())
    ranked, tried = [], 0
    for name in sorted(names):
        source = per_drive[0][name][0]
        if (source.message, source.signal or source.column, source.source) in used:
            continue
        column = held_on_windows(problem, [found[name][1:] for found in per_drive])
        if column is None:
            continue
        tried += 1
        explained = 0.0
        for shaped in _shapes(problem, column):
            matrix = np.column_stack([base, problem.whiten(shaped)])
            share = 1.0 - float((held_out(residual, matrix, problem.chunk) ** 2).sum()) / total
            explained = max(explained, share)
        if explained > 0.01:
            ranked.append(Ranked(name, source, explained, _switches(column), _repeats(known, column)))
    # of so many signals that have nothing to do with it, the best one explains about this much by chance
    chance = 2.0 * np.log(max(tried, 1)) / problem.rows
    return sorted((r for r in ranked if r.explained > chance), key=lambda r: -r.explained)[:20]


def _shapes(problem: Problem, column: FloatColumn) -> list[FloatColumn]:
    """Return the ways a signal may act: as a force, and as a torque at the crank."""
    lever = np.concatenate(
        [p.windows.mean(np.nan_to_num(p.run.samples.force_per_torque_1pm)) for p in problem.parts]
    )
    scaled = (column - column.mean()) / (column.std() or 1.0)
    return [scaled * 100.0, scaled * lever * 10.0]


def _known_columns(problem: Problem) -> Matrix:
    """Return what the model knows of each window (n, k): speeds, accelerations, torque, gear and force."""

    def column(of: Callable[[Run], FloatColumn]) -> FloatColumn:
        return np.concatenate([p.windows.mean(np.nan_to_num(of(p.run))) for p in problem.parts])

    quantities: list[Callable[[Run], FloatColumn]] = [
        lambda run: run.samples.speed_mps,
        lambda run: run.samples.accel_mps2,
        lambda run: run.torque_Nm,
        lambda run: run.gear,
        lambda run: run.samples.force_per_torque_1pm,
        lambda run: run.samples.speed_mps * run.samples.force_per_torque_1pm,
        lambda run: run.samples.traction_N,
    ]
    return np.column_stack([np.ones(problem.rows), *map(column, quantities)])


def _repeats(known: Matrix, column: FloatColumn) -> bool:
    """Return whether a signal is a sum of what the model knows, but for a little."""
    sizes = np.abs(known).max(axis=0)
    taken, *_ = np.linalg.lstsq(known / np.where(sizes > 0, sizes, 1.0), column, rcond=1e-8)
    left = column - known / np.where(sizes > 0, sizes, 1.0) @ taken
    return bool(left.var() < REPEATED_SHARE * column.var())


def _switches(column: FloatColumn) -> bool:
    """Return whether a signal is both off and on for a while."""
    low, high = np.percentile(column, [2, 98])
    share = float((column > 0.5 * (low + high)).mean()) if high > low else 0.0
    middle = float(((column > low + 0.25 * (high - low)) & (column < high - 0.25 * (high - low))).mean())
    return 0.03 < share < 0.97 and middle < 0.3


def held_on_windows(problem: Problem, drives: list[tuple[IntColumn, FloatColumn]]) -> FloatColumn | None:
    """Hold samples onto each window's middle; None for a signal that is constant or too rare."""
    columns = []
    for part, (t_us, value) in zip(problem.parts, drives, strict=True):
        good = np.isfinite(value)
        t_us, value = MonotonicClock()(t_us)[good], value[good]
        if len(t_us) < MIN_SAMPLES:
            return None
        # the samples show what was a while ago
        first_us = part.run.samples.t_us[0] - round(part.run.behind_s * 1e6)
        centre_us = first_us + (part.windows.t_s * 1e6).astype(np.int64)
        at = np.searchsorted(t_us, centre_us, side="right") - 1
        held = np.where(at >= 0, value[at], value[0])
        fresh = (at >= 0) & (centre_us - t_us[np.maximum(at, 0)] < _STALE_S * 1e6)
        if fresh.mean() < MIN_COVERAGE:
            return None
        columns.append(held)
    column = np.concatenate(columns)
    return column if np.ptp(column) > 0 else None


def signals_of(
    path: Path | MemoryLog, config: Config, channel: str | None = None
) -> dict[str, tuple[Source, IntColumn, FloatColumn]]:
    """Return every decodable signal of a log: name -> (source, stamps, values)."""
    seen: set[int] = set()
    with open_for(config, path, channel) as reader:
        if reader.kind == "table":
            return _columns(path, config)
        for block in reader:
            if not isinstance(block, TableBlock):
                seen.update(np.unique(block.can_id).tolist())
    databases = config.databases
    batches: list[_Batch] = []
    sources: dict[str, Source] = {}
    for message in (message for database in databases for message in database.messages):
        senders = _senders(message, seen)
        if not senders:
            continue
        signals = [s.name for s in message.signals if _decodable(message.name, s.name, databases)]
        batch = _batch_for(message, batches)
        for address, signal in product(senders, signals):
            sender = "" if address is None else f" from {address:#04x}"
            name = f"{message.name}.{signal}{sender}"
            batch.wants[name] = Want(name, message.name, signal, address)
            sources[name] = Source(message=message.name, signal=signal, source=address)
    decoders = [Decoder(batch.wants, databases) for batch in batches]
    pieces: dict[str, list[tuple[IntColumn, FloatColumn]]] = {}
    for block in open_for(config, path, channel):
        if not isinstance(block, TableBlock):
            for decoder in decoders:
                for name, piece in decoder.push(block).samples.items():
                    pieces.setdefault(name, []).append(piece)
    return {
        name: (sources[name], np.concatenate([p[0] for p in ps]), np.concatenate([p[1] for p in ps]))
        for name, ps in pieces.items()
    }


class _Batch:
    """Signals for one decoder. messages: which one stands for each group or identifier."""

    def __init__(self) -> None:
        self.wants: dict[str, Want] = {}
        self.messages: dict[int, str] = {}


def _batch_for(message: Message, batches: list[_Batch]) -> _Batch:
    """Return a batch with room for a message: two of one parameter group may differ in length."""
    key = pgn_of(message.frame_id) if is_j1939(message) else exact_id(message)
    for batch in batches:
        room = key in batch.messages or len(batch.messages) < MAX_GROUPS
        if room and batch.messages.setdefault(key, message.name) == message.name:
            return batch
    batches.append(_Batch())
    batches[-1].messages[key] = message.name
    return batches[-1]


def _decodable(message: str, signal: str, databases: Sequence[Database]) -> bool:
    """Return whether a decoder can decode a signal that nobody asked for: a DBC may hold others."""
    try:
        build_groups({signal: Want(signal, message, signal, None)}, databases)
    except ConfigError:
        return False
    return True


def _senders(message: Message, seen: set[int]) -> list[int] | list[None]:
    """Return the addresses that send a message; None for one that is matched by its whole identifier."""
    if not is_j1939(message):
        return [None] if exact_id(message) in seen else []
    pgn = pgn_of(message.frame_id)
    data = (i for i in seen if i & EXTENDED and not i & (REMOTE | ERROR) and pgn_of(i) == pgn)
    return sorted({source_of(i) for i in data} - _NOBODY)


def _columns(path: Path | MemoryLog, config: Config) -> dict[str, tuple[Source, IntColumn, FloatColumn]]:
    blocks = [b for b in open_log(path, time_column=config.sampling.time_column) if isinstance(b, TableBlock)]
    if not blocks:
        return {}
    t_us = np.concatenate([b.t_us for b in blocks])
    return {
        name: (Source(column=name), t_us, np.concatenate([b.columns[name] for b in blocks]))
        for name in blocks[0].columns
        if name != config.sampling.time_column
    }
