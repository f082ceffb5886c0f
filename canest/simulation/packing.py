"""Frames from columns: bit fields into payloads, periods into stamps, losses and jitter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import EXTENDED, FloatColumn, FrameBlock, IntColumn
from canest.simulation.scenario import Bus

ALL_ONES = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
HIGHEST_STANDARD_ID = 0x7FF  #: a higher identifier has 29 bits (ISO 11898-1)
PAYLOAD_BYTES = 8
LATEST_S = 0.0025  #: no frame waits longer for the bus (chosen)


@dataclass(frozen=True, slots=True)
class Field:
    """A little-endian bit field with raw values (n,): integers that fit (masked if not)."""

    start: int
    bits: int
    raw: IntColumn


def scaled(start: int, bits: int, value: FloatColumn, factor: float, offset: float, top: int) -> Field:
    """Return a field of values rounded to its resolution, clamped to raw 0..top; NaN is all ones."""
    missing = np.isnan(value)
    raw = np.clip(np.rint((np.where(missing, offset, value) - offset) / factor), 0, top).astype(np.int64)
    return Field(start, bits, np.where(missing, (1 << bits) - 1, raw))


def signed(start: int, bits: int, value: FloatColumn, factor: float) -> Field:
    """Return a two's complement field with physical values rounded to its resolution."""
    limit = 1 << (bits - 1)
    return Field(start, bits, np.clip(np.rint(value / factor), -limit, limit - 1).astype(np.int64))


@dataclass(frozen=True, slots=True)
class Scale:
    """Where a number lies in a payload, and its resolution: physical = raw * factor + offset, raw 0..top."""

    start: int
    bits: int
    factor: float
    offset: float
    top: int

    def field(self, value: FloatColumn) -> Field:
        """Return the field of physical values (n,)."""
        return scaled(self.start, self.bits, value, self.factor, self.offset, self.top)


def flag(start: int, bits: int, on: NDArray[np.bool_]) -> Field:
    """Return a field that is 1 where ``on``, else 0."""
    return Field(start, bits, on.astype(np.int64))


def payload(fields: list[Field], n: int, filler: np.uint64 = ALL_ONES) -> NDArray[np.uint64]:
    """Return n payloads with the fields set, the rest as in `filler`."""
    data = np.full(n, filler, np.uint64)
    for field in fields:
        mask = np.uint64(((1 << field.bits) - 1) << field.start)
        value = (field.raw.astype(np.uint64) << np.uint64(field.start)) & mask
        data = (data & ~mask) | value
    return data


#: payloads (n,) for n scheduled times in seconds from the start
Content = Callable[[FloatColumn], NDArray[np.uint64]]


@dataclass(frozen=True, slots=True)
class Cyclic:
    """A frame sent every `period_s` from `phase_s` on."""

    can_id: int  #: 29-bit when above `HIGHEST_STANDARD_ID`
    period_s: float
    phase_s: float
    content: Content


def send(messages: list[Cyclic], duration_s: float, bus: Bus, rng: np.random.Generator) -> FrameBlock:
    """Put cyclic messages on the bus, each frame a little late, some lost; sorted by stamp."""
    frames = FrameBlock.concatenate([_sent(message, duration_s, bus, rng) for message in messages])
    return frames[np.argsort(frames.t_us, kind="stable")]


def _sent(message: Cyclic, duration_s: float, bus: Bus, rng: np.random.Generator) -> FrameBlock:
    due = np.arange(message.phase_s, duration_s, message.period_s)
    late = np.minimum(rng.exponential(bus.jitter_s, len(due)) if bus.jitter_s else 0.0, LATEST_S)
    t_us = bus.start_s * 1_000_000 + np.rint((due + late) * 1e6).astype(np.int64)
    kept = rng.random(len(due)) >= bus.loss
    flagged = message.can_id | (EXTENDED if message.can_id > HIGHEST_STANDARD_ID else 0)
    can_id = np.full(len(due), flagged, np.uint32)
    length = np.full(len(due), PAYLOAD_BYTES, np.uint8)
    return FrameBlock(t_us, can_id, length, message.content(due))[kept]


def constant(text: str) -> Content:
    """Return content that never changes, given as hex."""
    value = np.uint64(int.from_bytes(bytes.fromhex(text), "little"))
    return lambda due: np.full(len(due), value, np.uint64)


def random_payloads(rng: np.random.Generator, high: int, *, endpoint: bool) -> Content:
    """Return content that is drawn anew for each frame, from 0 to ``high``."""
    return lambda due: rng.integers(0, high, len(due), np.uint64, endpoint=endpoint)
