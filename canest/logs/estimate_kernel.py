"""`estimate_writer.estimates_csv` compiled by numba: every row is written where it stands.

numpy needs a column of characters per field (`canest.logs.text_fields`), and squeezes out what a row has not.
It is never interpreted; tests hold the two equal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn, IntColumn
from canest.core.jit import kernel
from canest.logs.text_fields import EXACT

_POINT, _COMMA, _LINE, _MINUS = b".,\n-"
_ZERO, _TEN = np.uint64(48), np.uint64(10)  # uint64 with uint64 stays uint64
#: characters of a number at most, with sign, point and comma
_NUMBER = 22


@kernel
def put_whole(out, at, value, least):  # type: ignore[no-untyped-def] # numba gives the types
    """Write a whole number >= 0 with at least so many digits; return where the next character stands."""
    left = np.uint64(value)  # whose division by a constant is a product
    bound, digits = _TEN, 1
    while left >= bound:
        bound *= _TEN
        digits += 1
    end = at + max(digits, least)
    for place in range(end - 1, at - 1, -1):
        rest = left // _TEN
        out[place] = _ZERO + (left - _TEN * rest)
        left = rest
    return end


@kernel
def put_seconds(out, at, t_us):  # type: ignore[no-untyped-def]
    """Write microseconds as seconds: three decimals where they suffice, and else six."""
    if t_us < 0:
        out[at] = _MINUS
        at, t_us = at + 1, -t_us
    whole = t_us // 1_000_000
    micros = t_us - 1_000_000 * whole
    at = put_whole(out, at, whole, 1)
    out[at] = _POINT
    if micros % 1000 == 0:
        return put_whole(out, at + 1, micros // 1000, 3)
    return put_whole(out, at + 1, micros, 6)


@kernel
def put_number(out, at, value, decimals, factor):  # type: ignore[no-untyped-def]
    """Write a comma, and a number with so many decimals; nothing where there is no (sane) number."""
    out[at] = _COMMA
    at += 1
    scaled = np.rint(value * factor)
    if not abs(scaled) < EXACT:
        return at
    if scaled < 0.0:
        out[at] = _MINUS
        at += 1
    magnitude, by = np.int64(abs(scaled)), np.int64(factor)
    units = magnitude // by
    at = put_whole(out, at, units, 1)
    if decimals > 0:
        out[at] = _POINT
        at = put_whole(out, at + 1, magnitude - units * by, decimals)
    return at


@kernel
def put_names(out, at, codes, row, names):  # type: ignore[no-untyped-def]
    """Write a comma and a name for each code of a row; return where the next character stands."""
    for k in range(len(codes)):
        out[at] = _COMMA
        at += 1
        code, place = codes[k, row], 0
        while names[k, code, place] != 0:
            out[at] = names[k, code, place]
            at, place = at + 1, place + 1
    return at


@kernel
def put_rows(t_us, numbers, decimals, first, codes, names, out):  # type: ignore[no-untyped-def]
    """Write rows: stamp, the first numbers, the names of the codes, the other numbers. Returns the length.

    numbers: (k, n). decimals: (k,). codes: uint8 (m, n). names: uint8 (m, 256, width), each ends with zero.
    """
    factors = 10.0**decimals
    at = 0
    for row in range(len(t_us)):
        at = put_seconds(out, at, t_us[row])
        for k in range(first):
            at = put_number(out, at, numbers[k, row], decimals[k], factors[k])
        at = put_names(out, at, codes, row, names)
        for k in range(first, len(numbers)):
            at = put_number(out, at, numbers[k, row], decimals[k], factors[k])
        out[at] = _LINE
        at += 1
    return at


def rows_csv(
    t_us: IntColumn,
    numbers: Sequence[tuple[FloatColumn, int]],
    labels: Sequence[tuple[NDArray[np.uint8], dict[int, str]]],
    more: Sequence[tuple[FloatColumn, int]],
) -> bytes:
    """Return rows of text: stamp, numbers with their decimals, names of codes, more numbers."""
    width = 1 + max(len(name) for _, names in labels for name in names.values())
    tables = np.zeros((len(labels), 256, width), np.uint8)
    for table, (_, names) in zip(tables, labels, strict=True):
        for code, name in names.items():
            table[code, : len(name)] = np.frombuffer(name.encode(), np.uint8)
    columns = [*numbers, *more]
    out = np.empty(len(t_us) * (_NUMBER * (1 + len(columns)) + len(labels) * width + 1), np.uint8)
    end = put_rows.compiled(
        t_us, np.array([values for values, _ in columns]), np.array([places for _, places in columns]),
        len(numbers), np.array([codes for codes, _ in labels]), tables, out,
    )  # fmt: skip
    return out[:end].tobytes()
