"""Containers for scalar kernels: lists when interpreted, arrays when compiled (see `canest.core.jit`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from canest.core import jit
from canest.core.frames import FloatColumn

Container = Any  #: list[float] interpreted, float64 array compiled


def pack(*columns: FloatColumn) -> list[Container]:
    """Return the columns (any shape, flattened row by row) as the containers kernels index fastest."""
    if jit.enabled():
        return [np.ascontiguousarray(c, np.float64).ravel() for c in columns]
    return [c.ravel().tolist() for c in columns]


def outputs(n: int, count: int) -> list[Container]:
    """Return ``count`` containers of length ``n`` for a kernel to fill."""
    if jit.enabled():
        return [np.empty(n) for _ in range(count)]
    return [[0.0] * n for _ in range(count)]


def unpack(container: Container) -> FloatColumn:
    """Return what a kernel filled as a float64 column."""
    return np.asarray(container, np.float64)


def state_in(state: list[float]) -> Container:
    """Return a kernel's working copy of a carried state."""
    return np.array(state) if jit.enabled() else list(state)


def state_out(state: Container) -> list[float]:
    """Return the state to carry after the kernel changed its working copy."""
    return [float(x) for x in state]
