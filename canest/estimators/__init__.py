"""Estimators of mass and grade, and the plain recursions behind them for a regression of your own.

`RLS`, `VectorRLS`, `RLSMF`, `BatchLS`, `TLS`, `GTLS`, `RTLS` and `RGTLS` have ``update(y, phi)``, ``.theta``
and ``.P``; so has `EKF`, for f and h of your own. The estimators that a config names are in `registry`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from canest.estimators.plain.kalman import EKF
    from canest.estimators.plain.least_squares import RLS, RLSMF, BatchLS, VectorRLS
    from canest.estimators.plain.total_least_squares import GTLS, RGTLS, RTLS, TLS

__all__ = ["EKF", "GTLS", "RGTLS", "RLS", "RLSMF", "RTLS", "TLS", "BatchLS", "VectorRLS"]

_LEAST_SQUARES, _TOTAL = "plain.least_squares", "plain.total_least_squares"
#: imported when first used: this package is imported with every command
_MODULES = {
    "EKF": "plain.kalman",
    "RLS": _LEAST_SQUARES,
    "RLSMF": _LEAST_SQUARES,
    "BatchLS": _LEAST_SQUARES,
    "VectorRLS": _LEAST_SQUARES,
    "TLS": _TOTAL,
    "GTLS": _TOTAL,
    "RTLS": _TOTAL,
    "RGTLS": _TOTAL,
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
