"""Frames from columns: bit fields into payloads, periods into stamps, losses and jitter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import EXTENDED, FloatColumn, FrameBlock, IntColumn
from canest.simulate.scenario import Bus

ALL_ONES = np.uint64(0xFFFF_FFFF_FFFF_FFFF)


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

    can_id: int  #: 29-bit when above 0x7FF
    period_s: float
    phase_s: float
    content: Content


def send(messages: list[Cyclic], duration_s: float, bus: Bus, rng: np.random.Generator) -> FrameBlock:
    """Put cyclic messages on the bus, each frame a little late, some lost; sorted by stamp."""
    blocks = []
    for message in messages:
        due = np.arange(message.phase_s, duration_s, message.period_s)
        late = np.minimum(rng.exponential(bus.jitter_s, len(due)) if bus.jitter_s else 0.0, 0.0025)
        t_us = bus.start_s * 1_000_000 + np.rint((due + late) * 1e6).astype(np.int64)
        kept = rng.random(len(due)) >= bus.loss
        flagged = message.can_id | (EXTENDED if message.can_id > 0x7FF else 0)
        blocks.append(
            FrameBlock(
                t_us,
                np.full(len(due), flagged, np.uint32),
                np.full(len(due), 8, np.uint8),
                message.content(due),
            )[kept]
        )
    frames = FrameBlock.concatenate(blocks)
    return frames[np.argsort(frames.t_us, kind="stable")]


def constant(text: str) -> Content:
    """Return content that never changes, given as hex."""
    value = np.uint64(int.from_bytes(bytes.fromhex(text), "little"))
    return lambda due: np.full(len(due), value, np.uint64)
