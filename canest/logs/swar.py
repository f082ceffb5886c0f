"""Text to numbers, eight characters per 64-bit word ("SIMD within a register"), no loop over characters.

Words are little-endian: the first character is the least significant byte. Every function also returns
a word that is zero where all characters were valid, so a bad character can never become a number.

Each is a kernel: numpy runs ``hex_bytes.interpreted`` over a column of words (n,), numba compiles the same
lines for one word at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.jit import kernel

Words = NDArray[np.uint64]

ALL_BITS = (1 << 64) - 1
ZERO_CHARS = 0x3030_3030_3030_3030  #: the text "00000000"

# uint64 with uint64 stays uint64 in numba; with a plain integer it would become a float
U1, U2, U4, U5, U6, U8, U16, U32 = (np.uint64(n) for n in (1, 2, 4, 5, 6, 8, 16, 32))
ZEROS = np.uint64(ZERO_CHARS)
_ONES = np.uint64(0x0101_0101_0101_0101)
_SIXES = np.uint64(0x0606_0606_0606_0606)
_LOW_NIBBLES = np.uint64(0x0F0F_0F0F_0F0F_0F0F)
_HIGH_NIBBLES = np.uint64(0xF0F0_F0F0_F0F0_F0F0)
_HIGH_BITS = np.uint64(0x8080_8080_8080_8080)
_ABOVE_NINE = np.uint64(0x7676_7676_7676_7676)  #: carries into the high bit from 10 on
_NOT_DIGIT = np.uint64(0x7070_7070_7070_7070)
_BYTE_OF_2 = np.uint64(0x00FF_00FF_00FF_00FF)
_BYTES_OF_4 = np.uint64(0x0000_FFFF_0000_FFFF)
_CASE_AND_STEP = np.uint64(0x50)  #: of a letter, bits 6 and 4: 0x60 becomes 0x30
_TEN = np.uint64(10)
_TENS = np.uint64(10 * 256 + 1)
_HUNDREDS = np.uint64(100 * 65536 + 1)
_TEN_THOUSANDS = np.uint64((10_000 << 32) + 1)


@kernel
def hex_bytes(text):  # type: ignore[no-untyped-def] # numba gives the types
    """Return the four bytes that eight hexadecimal characters (either case) spell, and the fault word.

    text: uint64. The bytes are the lower half of a uint64, the first one least significant; the upper half
    is void.
    A letter has bit 6. Lower-case it and step it back by one (``a`` becomes 0x60), then strip the high half
    of both digits and letters: what is left must be 0..9 or 0..5, which adding 6 or 10 shows in bit 4.
    """
    letter = (text >> U6) & _ONES
    low = ((text | (letter << U5)) - letter) ^ (letter * _CASE_AND_STEP) ^ ZEROS
    fault = (low | (low + (letter << U2) + _SIXES)) & _HIGH_NIBBLES
    nibbles = low + letter * _TEN
    pairs = ((nibbles << U4) | (nibbles >> U8)) & _BYTE_OF_2
    pairs = (pairs | (pairs >> U8)) & _BYTES_OF_4
    return pairs | (pairs >> U16), fault


@kernel
def decimal(text):  # type: ignore[no-untyped-def]
    """Return the number that eight decimal digits spell (uint64), and the fault word."""
    digits = text ^ ZEROS
    fault = ((digits | (digits + _ABOVE_NINE)) & _HIGH_BITS) | (digits & _NOT_DIGIT)
    value = ((digits & _LOW_NIBBLES) * _TENS) >> U8
    value = ((value & _BYTE_OF_2) * _HUNDREDS) >> U16
    return ((value & _BYTES_OF_4) * _TEN_THOUSANDS) >> U32, fault
