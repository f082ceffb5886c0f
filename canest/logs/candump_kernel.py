"""`Layout.parse` for numba: the same words, one line after the other instead of one word after the other.

Not run interpreted: numpy's way (`canest.logs.candump_layout`) is the reference, and tests hold the two equal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import BoolColumn, FrameBlock, IntColumn
from canest.core.jit import kernel
from canest.logs.candump_layout import Layout
from canest.logs.swar import ALL_BITS, ZERO_CHARS

# numba keeps the type of a global: uint64 with uint64 stays uint64, with a plain integer it would not
_1 = np.uint64(1)
_2 = np.uint64(2)
_4 = np.uint64(4)
_5 = np.uint64(5)
_6 = np.uint64(6)
_8 = np.uint64(8)
_16 = np.uint64(16)
_32 = np.uint64(32)
_PAIR = np.uint64(0xFFFF)
_ONES = np.uint64(0x0101_0101_0101_0101)
_LOW_NIBBLES = np.uint64(0x0F0F_0F0F_0F0F_0F0F)
_HIGH_NIBBLES = np.uint64(0xF0F0_F0F0_F0F0_F0F0)
_SIXES = np.uint64(0x0606_0606_0606_0606)
_HIGH_BITS = np.uint64(0x8080_8080_8080_8080)
_NINES_UP = np.uint64(0x7676_7676_7676_7676)
_NOT_DIGIT = np.uint64(0x7070_7070_7070_7070)
_EVERY_2ND = np.uint64(0x00FF_00FF_00FF_00FF)
_EVERY_4TH = np.uint64(0x0000_FFFF_0000_FFFF)
_LOW_HALF = np.uint64(0xFFFF_FFFF)
_ZEROS = np.uint64(ZERO_CHARS)
_ALL = np.uint64(ALL_BITS)
_TEN = np.uint64(10)
_X50 = np.uint64(0x50)
_TENS = np.uint64(10 * 256 + 1)
_HUNDREDS = np.uint64(100 * 65536 + 1)
_TEN_THOUSANDS = np.uint64((10_000 << 32) + 1)
_MILLION = np.uint64(1_000_000)
_ERROR = np.uint64(0x2000_0000)
_REMOTE = np.uint64(0x4000_0000)
_NO_IDENTIFIER = np.uint64(0xC000_0000)
_STANDARD_MAX = np.uint64(0x7FF)


@kernel
def parse_rows(  # type: ignore[no-untyped-def] # numba gives the types
    words, starts, fixed, seconds_at, seconds_digits, seconds_base, fraction_at, id_at, id_digits, remote,
    length, data_at, data_step, t_us, can_id, data, fits,
):  # fmt: skip
    """Parse the lines at ``starts``; ``words[i]`` is the eight characters from i on.

    fixed: uint64 (m, 3), offset, mask, value. Fills t_us, can_id, data, and fits where the layout holds.
    The rest as in `canest.logs.candump_layout.Layout`.
    """
    seconds_shift = np.uint64(8 * (8 - seconds_digits))
    fraction_shift = np.uint64(8 * (8 - 6))
    id_shift = np.uint64(8 * (8 - id_digits))
    seconds_fill = _ZEROS & ((_1 << seconds_shift) - _1)
    fraction_fill = _ZEROS & ((_1 << fraction_shift) - _1)
    id_fill = _ZEROS & ((_1 << id_shift) - _1)
    base = np.uint64(seconds_base)
    for row in range(len(starts)):
        at = starts[row]
        fault = np.uint64(0)
        for part in range(fixed.shape[0]):
            fault |= (words[at + fixed[part, 0]] ^ fixed[part, 2]) & fixed[part, 1]

        digits = ((words[at + seconds_at] << seconds_shift) | seconds_fill) ^ _ZEROS
        fault |= ((digits | (digits + _NINES_UP)) & _HIGH_BITS) | (digits & _NOT_DIGIT)
        value = ((digits & _LOW_NIBBLES) * _TENS) >> _8
        value = ((value & _EVERY_2ND) * _HUNDREDS) >> _16
        seconds = ((value & _EVERY_4TH) * _TEN_THOUSANDS) >> _32
        digits = ((words[at + fraction_at] << fraction_shift) | fraction_fill) ^ _ZEROS
        fault |= ((digits | (digits + _NINES_UP)) & _HIGH_BITS) | (digits & _NOT_DIGIT)
        value = ((digits & _LOW_NIBBLES) * _TENS) >> _8
        value = ((value & _EVERY_2ND) * _HUNDREDS) >> _16
        value = ((value & _EVERY_4TH) * _TEN_THOUSANDS) >> _32
        t_us[row] = np.int64((seconds + base) * _MILLION + value)

        text = (words[at + id_at] << id_shift) | id_fill
        letter = (text >> _6) & _ONES
        low = ((text | (letter << _5)) - letter) ^ (letter * _X50) ^ _ZEROS
        fault |= (low | (low + (letter << _2) + _SIXES)) & _HIGH_NIBBLES
        low += letter * _TEN
        low = ((low << _4) | (low >> _8)) & _EVERY_2ND
        low = (low | (low >> _8)) & _EVERY_4TH
        low = (low | (low >> _16)) & _LOW_HALF
        low = ((low & _EVERY_2ND) << _8) | ((low >> _8) & _EVERY_2ND)
        low = ((low << _16) | (low >> _16)) & _LOW_HALF
        if id_digits == 3:
            if low > _STANDARD_MAX:
                fault |= _1
        else:
            fault |= low & _NO_IDENTIFIER
            low |= (~low & _ERROR) << _2
        if remote:
            low |= _REMOTE
        can_id[row] = low

        payload = np.uint64(0)
        for first in range(0, length, 4):
            begin = at + data_at + np.uint64(first * data_step)
            count = min(4, length - first)
            if data_step == 2:
                text = words[begin]
            else:
                text = np.uint64(0)
                for index in range(count):
                    text |= (words[begin + np.uint64(3 * index)] & _PAIR) << np.uint64(16 * index)
            if count < 4:
                keep = (_1 << np.uint64(16 * count)) - _1
                text = (text & keep) | (_ZEROS & (_ALL ^ keep))
            letter = (text >> _6) & _ONES
            low = ((text | (letter << _5)) - letter) ^ (letter * _X50) ^ _ZEROS
            fault |= (low | (low + (letter << _2) + _SIXES)) & _HIGH_NIBBLES
            low += letter * _TEN
            low = ((low << _4) | (low >> _8)) & _EVERY_2ND
            low = (low | (low >> _8)) & _EVERY_4TH
            low = (low | (low >> _16)) & _LOW_HALF
            if first == 0:
                payload = low
            elif first == 4:
                payload |= low << _32
        data[row] = payload
        fits[row] = fault == np.uint64(0)


def parse(layout: Layout, text: NDArray[np.uint8], starts: IntColumn) -> tuple[FrameBlock, BoolColumn]:
    """Do what `Layout.parse` does with the lines at ``starts`` of ``text``, 8 characters beyond the last."""
    rows = len(starts)
    t_us, can_id, data = np.empty(rows, np.int64), np.empty(rows, np.uint32), np.empty(rows, np.uint64)
    fits = np.empty(rows, np.bool_)
    parse_rows.compiled(
        np.ndarray(len(text) - 7, "<u8", text, strides=(1,)),
        starts.view(np.uint64),
        np.array(layout.fixed, np.uint64).reshape(-1, 3),
        np.uint64(layout.seconds_at),
        layout.seconds_digits,
        layout.seconds_base,
        np.uint64(layout.fraction_at),
        np.uint64(layout.id_at),
        layout.id_digits,
        layout.remote,
        0 if layout.remote else layout.length,
        np.uint64(max(layout.data_at, 0)),  # a remote frame has none
        layout.data_step,
        t_us,
        can_id,
        data,
        fits,
    )
    return FrameBlock(t_us, can_id, np.full(rows, layout.length, np.uint8), data), fits
