"""Text to numbers, eight characters per 64-bit word ("SIMD within a register"), no loop over characters.

Words are little-endian: the first character is the least significant byte. Every function also returns
a word that is zero where all characters were valid, so a bad character can never become a number.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint64]

_ONES = 0x0101_0101_0101_0101
ALL_BITS = (1 << 64) - 1
ZERO_CHARS = 0x30 * _ONES  #: the text "00000000"


def _u(value: int) -> np.uint64:
    return np.uint64(value)


def _all(byte: int) -> np.uint64:
    return np.uint64(byte * _ONES)


def hex_nibbles(text: Words) -> tuple[Words, Words]:
    """Return the value 0..15 of each hexadecimal character (either case) and the fault word.

    A letter has bit 6. Lower-case it and step it back by one ('a' -> 0x60), then strip the high half of both
    digits and letters: what is left must be 0..9 or 0..5, which adding 6 or 10 shows in bit 4.
    """
    letter = (text >> _u(6)) & _all(1)
    low = ((text | (letter << _u(5))) - letter) ^ (letter * _u(0x50)) ^ _all(0x30)
    fault = (low | (low + (letter << _u(2)) + _all(6))) & _all(0xF0)
    return low + letter * _u(10), fault


def hex_bytes(text: Words) -> tuple[NDArray[np.uint32], Words]:
    """Return the four bytes that eight hexadecimal characters spell, the first one least significant."""
    nibbles, fault = hex_nibbles(text)
    pairs = ((nibbles << _u(4)) | (nibbles >> _u(8))) & _u(0x00FF_00FF_00FF_00FF)
    pairs = (pairs | (pairs >> _u(8))) & _u(0x0000_FFFF_0000_FFFF)
    return (pairs | (pairs >> _u(16))).astype(np.uint32), fault


def decimal(text: Words) -> tuple[Words, Words]:
    """Return the number that eight decimal digits spell, and the fault word."""
    digits = text ^ _all(0x30)
    fault = (digits | (digits + _all(0x76))) & _all(0x80) | (digits & _all(0x70))
    value = ((digits & _all(0x0F)) * _u(10 * 256 + 1)) >> _u(8)
    value = ((value & _u(0x00FF_00FF_00FF_00FF)) * _u(100 * 65536 + 1)) >> _u(16)
    return ((value & _u(0x0000_FFFF_0000_FFFF)) * _u((10_000 << 32) + 1)) >> _u(32), fault
