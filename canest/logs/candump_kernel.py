"""`Layout.parse` compiled by numba: every line is read where it stands, none is copied.

The arithmetic is the same source for both (`canest.logs.swar`). Only the way to the characters is written
twice: numpy needs a column of words per field (`canest.logs.candump_layout`), which costs a copy of every
field, and a loop over lines needs none. It is never interpreted; tests hold the two equal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import ERROR, ID_MASK, REMOTE, BoolColumn, FrameBlock, IntColumn
from canest.core.jit import kernel
from canest.logs.candump_layout import Layout
from canest.logs.candump_line import STANDARD_ID_MAX
from canest.logs.swar import ALL_BITS, U1, U2, U8, U16, U32, ZEROS, decimal, hex_bytes

# as in `canest.logs.swar`: uint64 with uint64 stays uint64
_PAIR = np.uint64(0xFFFF)
_ALL = np.uint64(ALL_BITS)
_SECOND_BYTES = np.uint64(0x00FF_00FF)
_LOW_HALF = np.uint64(0xFFFF_FFFF)
_MILLION = np.uint64(1_000_000)
_ERROR, _REMOTE = np.uint64(ERROR), np.uint64(REMOTE)
_NO_IDENTIFIER = np.uint64(0xFFFF_FFFF ^ (ID_MASK | ERROR))
_STANDARD_MAX = np.uint64(STANDARD_ID_MAX)
_FRACTION_SHIFT = np.uint64(8 * (8 - 6))


class Offsets(NamedTuple):
    """Where the parts of a line stand, as `Layout` has it; uint64 where a position is added to."""

    seconds_at: np.uint64
    seconds_shift: np.uint64  #: bits by which fewer than eight digits move to the end of a word
    seconds_base: np.uint64
    fraction_at: np.uint64
    id_at: np.uint64
    id_digits: int
    remote: bool
    length: int
    data_at: np.uint64
    data_step: int


@kernel
def _filled(word, shift):  # type: ignore[no-untyped-def] # numba gives the types
    """Return the first characters of a word behind as many zeros as ``shift`` bits hold."""
    return (word << shift) | (ZEROS & ((U1 << shift) - U1))


@kernel
def _stamp(words, line, at):  # type: ignore[no-untyped-def]
    """Return the microseconds of the line that begins at ``line``, and the fault word."""
    seconds, fault = decimal(_filled(words[line + at.seconds_at], at.seconds_shift))
    micros, more = decimal(_filled(words[line + at.fraction_at], _FRACTION_SHIFT))
    return (seconds + at.seconds_base) * _MILLION + micros, fault | more


@kernel
def _identifier(words, line, at):  # type: ignore[no-untyped-def]
    """Return the identifier with its flags, and the fault word."""
    low, fault = hex_bytes(_filled(words[line + at.id_at], np.uint64(8 * (8 - at.id_digits))))
    low = ((low & _SECOND_BYTES) << U8) | ((low >> U8) & _SECOND_BYTES)
    low = ((low << U16) | (low >> U16)) & _LOW_HALF
    if at.id_digits == 3:
        if low > _STANDARD_MAX:
            fault |= U1
    else:
        fault |= low & _NO_IDENTIFIER
        low |= (~low & _ERROR) << U2
    if at.remote:
        low |= _REMOTE
    return low, fault


@kernel
def _payload(words, line, at):  # type: ignore[no-untyped-def]
    """Return the first eight payload bytes as a word, and the fault word of all of them."""
    payload, fault = np.uint64(0), np.uint64(0)
    for first in range(0, at.length, 4):
        begin = line + at.data_at + np.uint64(first * at.data_step)
        count = min(4, at.length - first)
        text = np.uint64(0)
        if at.data_step == 2:
            text = words[begin]
        else:
            for index in range(count):
                text |= (words[begin + np.uint64(3 * index)] & _PAIR) << np.uint64(16 * index)
        if count < 4:
            keep = (U1 << np.uint64(16 * count)) - U1
            text = (text & keep) | (ZEROS & (_ALL ^ keep))
        four, bad = hex_bytes(text)
        fault |= bad
        if first == 0:
            payload = four & _LOW_HALF
        elif first == 4:
            payload |= four << U32
    return payload, fault


@kernel
def parse_rows(words, starts, fixed, at, t_us, can_id, data, fits):  # type: ignore[no-untyped-def]
    """Parse the lines at ``starts``; ``words[i]`` is the eight characters from i on.

    fixed: uint64 (m, 3), offset, mask, value. at: `Offsets`. Fills t_us, can_id, data, and fits where the
    layout holds.
    """
    for row in range(len(starts)):
        line = starts[row]
        fault = np.uint64(0)
        for part in range(fixed.shape[0]):
            fault |= (words[line + fixed[part, 0]] ^ fixed[part, 2]) & fixed[part, 1]
        stamp, bad_stamp = _stamp(words, line, at)
        identifier, bad_identifier = _identifier(words, line, at)
        payload, bad_payload = _payload(words, line, at)
        t_us[row] = np.int64(stamp)
        can_id[row] = identifier
        data[row] = payload
        fits[row] = (fault | bad_stamp | bad_identifier | bad_payload) == np.uint64(0)


def parse(layout: Layout, text: NDArray[np.uint8], starts: IntColumn) -> tuple[FrameBlock, BoolColumn]:
    """Do what `Layout.parse` does with the lines at ``starts`` of ``text``, 8 characters beyond the last."""
    rows = len(starts)
    t_us, can_id, data = np.empty(rows, np.int64), np.empty(rows, np.uint32), np.empty(rows, np.uint64)
    fits = np.empty(rows, np.bool_)
    offsets = Offsets(
        seconds_at=np.uint64(layout.seconds_at),
        seconds_shift=np.uint64(8 * (8 - layout.seconds_digits)),
        seconds_base=np.uint64(layout.seconds_base),
        fraction_at=np.uint64(layout.fraction_at),
        id_at=np.uint64(layout.id_at),
        id_digits=layout.id_digits,
        remote=layout.remote,
        length=0 if layout.remote else layout.length,
        data_at=np.uint64(max(layout.data_at, 0)),  # a remote frame has none
        data_step=layout.data_step,
    )
    parse_rows.compiled(
        np.ndarray(len(text) - 7, "<u8", text, strides=(1,)),
        starts.view(np.uint64),
        np.array(layout.fixed, np.uint64).reshape(-1, 3),
        offsets,
        t_us,
        can_id,
        data,
        fits,
    )
    return FrameBlock(t_us, can_id, np.full(rows, layout.length, np.uint8), data), fits
