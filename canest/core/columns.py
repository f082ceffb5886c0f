"""Columns that many stages need: of one value, shifted by one sample, or given by another package."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import PluginError
from canest.core.frames import BoolColumn, FloatColumn, IntColumn

T = TypeVar("T", bound=np.generic)

#: live blocks are a few ticks long: their constants are made once. Those of a log's block are kept for the
#: stages of this block, and those of a long table are too large to keep.
_KEPT_LENGTH, _RECENT_LENGTH, _RECENT = 64, 1 << 15, 16


@overload
def constant(value: bool, n: int) -> BoolColumn: ...
@overload
def constant(value: float, n: int) -> FloatColumn: ...
def constant(value: float, n: int) -> BoolColumn | FloatColumn:
    """Return a column (n,) of one value; shared between callers: read it, never write into it."""
    if n <= _KEPT_LENGTH:
        return _kept(value, n)
    return _recent(value, n) if n <= _RECENT_LENGTH else _made(value, n)


def _made(value: float, n: int) -> BoolColumn | FloatColumn:
    return np.full(n, value, np.bool_ if isinstance(value, bool) else np.float64)


_kept = lru_cache(maxsize=4096, typed=True)(_made)
_recent = lru_cache(maxsize=_RECENT, typed=True)(_made)


def stretches(t_us: IntColumn, most_us: int) -> list[slice]:
    """Return the parts of a column of stamps (n,), in order, that span this long at most.

    A stamp before the first one of all begins no part: clocks that were set back are for others.
    """
    if len(t_us) < 2 or t_us.max() - t_us[0] < most_us:
        return [slice(None)]
    begun = np.maximum.accumulate((t_us - t_us[0]) // most_us)
    edges = [0, *(np.flatnonzero(np.diff(begun)) + 1).tolist(), len(t_us)]
    return [slice(first, end) for first, end in pairwise(edges)]


def shifted(column: NDArray[T], first: float) -> NDArray[T]:
    """Return each sample's predecessor (n,); ``first`` is the first one's, kept from the last block."""
    before = np.empty_like(column)
    before[0], before[1:] = first, column[:-1]
    return before


def finite(values: FloatColumn) -> FloatColumn:
    """Return the finite numbers of a column (n,), in nearly every block the column itself."""
    if len(values) and math.isfinite(values.min()) and math.isfinite(values.max()):
        return values
    return values[np.isfinite(values)]


def column_of(found: object, like: NDArray[Any], what: str, where: str, per: str) -> NDArray[Any]:
    """Return what the code of another package gives as a column, shape and type of another one.

    what, where, per: what is wrong if it is none, whose it is, and of what it has one number each.
    Errors: PluginError.
    """
    try:
        column = np.asarray(found, like.dtype)
    except (TypeError, ValueError):
        column = np.empty(0, like.dtype)
    if column.shape != like.shape:
        shape, expected = f"shape {column.shape}", f"one number for each of {len(like)} {per}"
        raise PluginError(what, where=where, found=shape, expected=expected)
    return column
