"""Numbers to text, a column at a time, the way back from `canest.logs.swar`.

A field is a uint8 matrix (n, width) of characters, zero where a row has none; `join` squeezes the zeros out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import BoolColumn, FloatColumn, IntColumn

Field = NDArray[np.uint8]

_BLANK = 0
_ZERO = 0x30
_MINUS = 0x2D
_GROUP = 10_000
#: beyond this a float64 in microseconds or tenths is no exact integer any more
EXACT = 2.0**53

#: "0000" to "9999" as four characters each
_FOUR_DIGITS = (
    (np.arange(_GROUP)[:, None] // (1000, 100, 10, 1) % 10 + _ZERO).astype(np.uint8).view("<u4")[:, 0]
)
_HEX_DIGITS = np.frombuffer(b"0123456789ABCDEF", np.uint8)
#: "00" to "FF" as two characters each
_HEX_PAIRS = np.stack([np.repeat(_HEX_DIGITS, 16), np.tile(_HEX_DIGITS, 16)], axis=1).copy().view("<u2")[:, 0]


def digits(values: IntColumn, width: int) -> Field:
    """Return the last ``width`` decimal digits of integers >= 0, with leading zeros."""
    groups = -(-width // 4)
    text = np.empty((len(values), groups), "<u4")
    for group in range(groups - 1, 0, -1):
        rest = values // _GROUP
        text[:, group] = _FOUR_DIGITS[values - rest * _GROUP]
        values = rest
    text[:, 0] = _FOUR_DIGITS[values % _GROUP]
    return text.view(np.uint8)[:, 4 * groups - width :]


def integer(values: IntColumn, width_min: int = 1) -> Field:
    """Return integers of either sign, leading zeros only up to ``width_min`` digits."""
    magnitude = np.abs(values)
    most = int(magnitude.max(initial=0))
    least = int(magnitude.min(initial=most))
    width = max(width_min, len(str(most)))
    text = digits(magnitude, width)
    for place in range(width - max(width_min, len(str(least)))):
        text[:, place][magnitude < 10 ** (width - 1 - place)] = _BLANK
    return np.hstack([sign(values), text])


def sign(values: IntColumn) -> Field:
    """Return what stands in front of integers; it is no column where none is negative."""
    negative = values < 0
    if not negative.any():
        return np.empty((len(values), 0), np.uint8)
    return np.where(negative, np.uint8(_MINUS), np.uint8(_BLANK))[:, None]


def fixed(values: FloatColumn, decimals: int) -> Field:
    """Return numbers with a fixed count of decimals; nothing where there is no (sane) number."""
    with np.errstate(over="ignore"):
        scaled = np.rint(values * 10.0**decimals)
    known = np.abs(scaled) < EXACT  # false for NaN
    whole = np.where(known, scaled, 0.0).astype(np.int64)
    magnitude = np.abs(whole)
    units = magnitude // 10**decimals
    fields = [sign(whole), integer(units)]
    if decimals:
        fields += [constant(b".", len(values)), digits(magnitude - units * 10**decimals, decimals)]
    text = np.hstack(fields)
    text[~known] = _BLANK
    return text


def seconds(t_us: IntColumn) -> Field:
    """Return microseconds as seconds: exact, three decimals where they suffice and else six."""
    magnitude = np.abs(t_us)
    whole = magnitude // 1_000_000
    micros = magnitude - whole * 1_000_000
    millis = micros // 1000
    suffice = millis * 1000 == micros
    if suffice.all():  # as those of ticks do
        decimals = digits(millis, 3)
    else:
        decimals = digits(micros, 6)
        decimals[:, 3:][suffice] = _BLANK
    return np.hstack([sign(t_us), integer(whole), constant(b".", len(t_us)), decimals])


def labels(codes: NDArray[np.uint8], names: dict[int, str]) -> Field:
    """Return the names of codes."""
    came = np.flatnonzero(np.bincount(codes)).tolist()
    width = max((len(names.get(code, "")) for code in came), default=0)
    table = np.zeros((256, width), np.uint8)
    for code in came:
        name = names.get(code, "").encode()
        table[code, : len(name)] = np.frombuffer(name, np.uint8)
    return table[codes]


def hexadecimal(values: NDArray[np.uint8]) -> Field:
    """Return bytes (n, m) as two upper-case digits each: (n, 2 m)."""
    return _HEX_PAIRS[values].view(np.uint8)


def constant(text: bytes, rows: int) -> Field:
    """Return the same text in every row."""
    return np.broadcast_to(np.frombuffer(text, np.uint8), (rows, len(text)))


def blank_where(field: Field, rows: BoolColumn) -> Field:
    """Return the field without its text in the given rows."""
    return np.where(rows[:, None], np.uint8(_BLANK), field)


def join(fields: list[Field]) -> bytes:
    """Return the rows one behind the other."""
    text = np.hstack(fields).ravel()
    return bytes(text[text != _BLANK])
