"""Columns of one value, made once: live blocks are a few ticks long, and most facts never change."""

from __future__ import annotations

from functools import lru_cache
from typing import overload

import numpy as np

from canest.frames import BoolColumn, FloatColumn

#: longer columns are rare and large: made when needed, not kept
_KEPT_LENGTH = 64


@overload
def constant(value: bool, n: int) -> BoolColumn: ...
@overload
def constant(value: float, n: int) -> FloatColumn: ...
def constant(value: float, n: int) -> BoolColumn | FloatColumn:
    """Return a column (n,) of one value; shared between callers: read it, never write into it."""
    return _kept(value, n) if n <= _KEPT_LENGTH else _made(value, n)


def _made(value: float, n: int) -> BoolColumn | FloatColumn:
    return np.full(n, value, np.bool_ if isinstance(value, bool) else np.float64)


_kept = lru_cache(maxsize=4096, typed=True)(_made)
