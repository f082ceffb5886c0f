"""What estimators of other packages are held to: see `canest.estimators.base.Estimator`.

Those of canest are held to it by its tests, and cost nothing here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core.columns import column_of
from canest.core.errors import PluginError
from canest.core.plugins import OWN, is_of_canest, named_failures
from canest.core.samples import EstimateBlock, ModelBlock, Status, VehicleFacts
from canest.estimators.base import Estimator
from canest.estimators.doubted_lever import widened

#: a mass may lie beyond a bound by this share, which is rounding
_ROUNDING = 1e-9


def make(
    kind: type[Estimator], name: str, facts: VehicleFacts, options: Mapping[str, Any] | None
) -> Estimator:
    """Return a new estimator.

    Errors: ConfigError for its options, PluginError for one of another package that cannot be made.
    """
    if kind.__module__.startswith(OWN):
        return kind(name, facts, options)
    where = _called(name, kind)
    with named_failures(where):
        estimator = kind(name, facts, options)
    if not {"name", "facts", "options"} <= vars(estimator).keys():
        raise PluginError(
            "its __init__ is wrong", where=where, expected="super().__init__(name, facts, options) in it"
        )
    return estimator


def _called(name: str, kind: type[Estimator]) -> str:
    return f"estimator {name} ({kind.__module__})"


def updated(estimator: Estimator, block: ModelBlock) -> EstimateBlock:
    """Return an estimator's estimates of the next samples.

    Errors: PluginError for one of another package that fails, or returns what are no estimates.
    """
    return widened(_estimates(estimator, block), block.lever_std, estimator.valid_std)


def _estimates(estimator: Estimator, block: ModelBlock) -> EstimateBlock:
    if is_of_canest(estimator):
        return estimator.update(block)
    name = _called(estimator.name, type(estimator))
    with named_failures(name):
        found = estimator.update(_read_only(block))
    return _checked(found, len(block), estimator.facts, name)


def _read_only(block: ModelBlock) -> ModelBlock:
    """Return the same samples, into which nobody can write: other estimators get them, too."""
    columns = [getattr(block, field.name) for field in fields(block)]
    views: list[Any] = [column.view() if column is not None else None for column in columns]
    for view in views:
        if view is not None:
            view.flags.writeable = False
    return ModelBlock(*views)


def _checked(found: object, count: int, facts: VehicleFacts, name: str) -> EstimateBlock:
    if not isinstance(found, EstimateBlock):
        raise PluginError(
            "returns no estimates", where=name, found=type(found).__name__, expected="an EstimateBlock"
        )
    columns: dict[str, NDArray[np.float64]] = {}
    wanted = np.empty(count)
    for field in fields(found):
        column = column_of(getattr(found, field.name), wanted, f"its {field.name} is wrong", name, "samples")
        columns[field.name] = column
    least, most = facts.mass_min_kg * (1 - _ROUNDING), facts.mass_max_kg * (1 + _ROUNDING)
    for column_name, low, high in (
        ("mass_kg", least, most), ("mass_std_kg", 0.0, np.inf), ("grade", -np.inf, np.inf),
        ("grade_std", 0.0, np.inf), ("status", 0.0, float(max(Status))),
    ):  # fmt: skip
        column = columns[column_name]
        wrong = column[np.isinf(column) | (column < low) | (column > high)]
        if len(wrong) or (column_name == "status" and np.isnan(column).any()):
            raise PluginError(
                f"its {column_name} is impossible", where=name,
                found=f"{wrong[0] if len(wrong) else np.nan:g}",
                expected=f"{low:g} to {high:g}, and NaN for no number",
            )  # fmt: skip
    status = columns.pop("status").astype(np.uint8)
    if np.isnan(columns["mass_kg"] + columns["mass_std_kg"])[status == Status.VALID].any():
        raise PluginError(
            "its status is wrong", where=name, found="VALID without a mass",
            expected="VALID where mass_kg and mass_std_kg are numbers",
        )  # fmt: skip
    return EstimateBlock(**columns, status=status)
