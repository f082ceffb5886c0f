"""The eight bytes of `CanestEstimate` (`dbc/canest.dbc`): our own packing, tested equal to cantools'.

Layout, bit 0 least significant of the little-endian payload::

     0..15  EstimatedMass      2 kg            48..49  EstimateStatus
    16..23  EstimatedMassStd   0.4 % of mass   50..55  EstimateGate
    24..39  EstimatedGrade     0.01 %, -320 %  56..59  MessageCounter
    40..47  EstimatedGradeStd  0.04 %          60..63  MessageChecksum

The checksum is the sum, modulo 16, of the other 15 nibbles of the payload (the counter included) and of the
eight nibbles of the 29-bit identifier, so that a frame under another address or group does not pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from canest.core.frames import ID_MASK
from canest.core.samples import STATUS_LABELS, Status

MASS_STEP_KG = 2.0
MASS_STD_STEP = 0.004
GRADE_STEP = 0.0001
GRADE_OFFSET = -3.2
GRADE_STD_STEP = 0.0004
NOT_AVAILABLE_STATUS = 3
NOT_AVAILABLE_GATE = 63
#: every status in words, by its code
STATUS_NAMES = (*STATUS_LABELS.values(), "not available")

_LARGEST_16, _LARGEST_8 = 0xFAFF, 0xFA  #: J1939-71: from 0xFB.. on bytes mean error or not available
_NOT_AVAILABLE_16, _NOT_AVAILABLE_8 = 0xFFFF, 0xFF


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimate as it goes onto the bus; NaN where there is no number. Grade is tan(beta)."""

    mass_kg: float = math.nan
    mass_std_kg: float = math.nan
    grade: float = math.nan
    grade_std: float = math.nan
    status: int = NOT_AVAILABLE_STATUS
    gate: int = NOT_AVAILABLE_GATE


@dataclass(frozen=True, slots=True)
class Received:
    """A decoded broadcast. intact: the checksum is right."""

    estimate: Estimate
    counter: int
    intact: bool


def encode(estimate: Estimate, counter: int, can_id: int) -> bytes:
    """Return the payload. A mass or grade beyond the range, or NaN, is sent as not available.

    A standard deviation beyond its range is sent as the largest there is: "at least".
    """
    mass = _raw(estimate.mass_kg / MASS_STEP_KG, _LARGEST_16, _NOT_AVAILABLE_16)
    mass_std = _NOT_AVAILABLE_8
    if mass != _NOT_AVAILABLE_16 and estimate.mass_kg > 0:
        mass_std = _raw(
            min(estimate.mass_std_kg / estimate.mass_kg / MASS_STD_STEP, _LARGEST_8),
            _LARGEST_8,
            _NOT_AVAILABLE_8,
        )
    grade = _raw((estimate.grade - GRADE_OFFSET) / GRADE_STEP, _LARGEST_16, _NOT_AVAILABLE_16)
    grade_std = _NOT_AVAILABLE_8
    if grade != _NOT_AVAILABLE_16:
        grade_std = _raw(min(estimate.grade_std / GRADE_STD_STEP, _LARGEST_8), _LARGEST_8, _NOT_AVAILABLE_8)
    word = mass | mass_std << 16 | grade << 24 | grade_std << 40
    status = estimate.status
    if status == Status.VALID and mass == _NOT_AVAILABLE_16:
        status = Status.CONVERGING  # a valid mass that no frame holds is none for who receives it
    word |= (status & 3) << 48 | (estimate.gate & 63) << 50 | (counter & 15) << 56
    return (word | checksum(word, can_id) << 60).to_bytes(8, "little")


def decode(payload: bytes, can_id: int) -> Received | None:
    """Return the content of a frame; None when it has not eight bytes."""
    if len(payload) != 8:
        return None
    word = int.from_bytes(payload, "little")
    mass, mass_std = word & 0xFFFF, word >> 16 & 0xFF
    grade, grade_std = word >> 24 & 0xFFFF, word >> 40 & 0xFF
    mass_kg = mass * MASS_STEP_KG if mass <= _LARGEST_16 else math.nan
    estimate = Estimate(
        mass_kg=mass_kg,
        mass_std_kg=mass_std * MASS_STD_STEP * mass_kg if mass_std <= _LARGEST_8 else math.nan,
        grade=grade * GRADE_STEP + GRADE_OFFSET if grade <= _LARGEST_16 else math.nan,
        grade_std=grade_std * GRADE_STD_STEP if grade_std <= _LARGEST_8 else math.nan,
        status=word >> 48 & 3,
        gate=word >> 50 & 63,
    )
    return Received(estimate, word >> 56 & 15, word >> 60 == checksum(word, can_id))


def checksum(word: int, can_id: int) -> int:
    """Return the checksum of a payload (its own nibble, the top one, is ignored) under an identifier."""
    return (_nibbles(word & (1 << 60) - 1) + _nibbles(can_id & ID_MASK)) & 15


def _nibbles(value: int) -> int:
    return sum(map(_NIBBLES.__getitem__, value.to_bytes(8, "little")))


_NIBBLES = [(byte & 15) + (byte >> 4) for byte in range(256)]


def _raw(steps: float, largest: int, none: int) -> int:
    """Round to whole steps; ``none`` when out of range or not a number."""
    if not 0 <= steps <= largest:
        return none
    return round(steps)
