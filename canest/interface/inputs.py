"""What a caller may give: configs by object, path or name; logs as files, frames, drives or tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from canest.config.load import load_config
from canest.config.of_table import SLOW_S, config_of_table
from canest.config.schema import Config
from canest.config.sections import EstimatorSection
from canest.core.errors import ConfigError, LogError, UsageError
from canest.core.frames import FloatColumn, FrameBlock
from canest.estimators.registry import require_known
from canest.interface.signals import Signals
from canest.interface.simulated_drive import SimulatedDrive
from canest.logs.cells import seconds_of
from canest.logs.memory import FrameLog, MemoryLog
from canest.logs.table_in_memory import TableLog
from canest.vehicle import facts

#: share of rows earlier than the one before, up to which they count as in order
_MOST_BACKWARD = 0.1

LogFile = str | Path | MemoryLog


def config_of(
    given: Config | facts.Vehicle | str | Path, overrides: Mapping[str, object] | None = None
) -> Config:
    """Return a config, loaded where it is a path or a name. Errors: ConfigError."""
    if isinstance(given, Config):
        return given
    if isinstance(given, facts.Vehicle):
        raise ConfigError(
            "a vehicle alone does not define where signals are",
            where="config",
            expected="a config, or a table for canest.estimate",
        )
    if overrides is not None and not isinstance(overrides, Mapping):
        expected = "a mapping: dotted key -> value"
        raise UsageError("no overrides", found=type(overrides).__name__, expected=expected)
    if not isinstance(given, str | Path):
        raise UsageError("no config", found=type(given).__name__, expected="a config, its path or a name")
    return load_config(given, [f"{key}={_yaml(value)}" for key, value in (overrides or {}).items()])


def with_estimator(config: Config, name: str | None) -> Config:
    """Return the config with another estimator, which has its default options. Errors: ConfigError."""
    if name is None or name == config.estimator.name:
        return config
    if not isinstance(name, str):
        raise UsageError(
            "no name", where="estimator", found=getattr(name, "__name__", name),
            expected="the name of an estimator; docs/extending.md gives a class of your own one",
        )  # fmt: skip
    require_known(name, where="estimator")
    section = EstimatorSection.model_validate({**config.estimator.model_dump(), "name": name, "options": {}})
    return config.model_copy(update={"estimator": section})


def log_of(given: Any, what: str = "log") -> LogFile:
    """Return what a reader opens: a path, frames, or a table. Errors: LogError."""
    if isinstance(given, str | Path | MemoryLog):
        return given
    if isinstance(given, FrameBlock):
        return FrameLog(given)
    if isinstance(given, SimulatedDrive):
        return FrameLog(given.frames, given.name)
    if isinstance(given, Signals):
        return TableLog({"t_s": given.t_s, **given.values})
    if isinstance(given, list | tuple | set):
        expected = f"one {what}: a path, a FrameBlock (of FrameBlock.from_messages), or a table"
        raise LogError(f"no {what}", found=type(given).__name__, expected=expected)
    return TableLog(given)


def log_and_config(
    given: Any, config: Config | facts.Vehicle | str | Path, units: Mapping[str, str] | None = None
) -> tuple[LogFile, Config]:
    """Return a log and the config for it: of a table's columns, the one that they ask for.

    Errors: LogError, ConfigError.
    """
    log = log_of(given)
    if not isinstance(log, TableLog):
        return log, config_of(config)
    known = config if isinstance(config, facts.Vehicle) else config_of(config)
    time_column = known.sampling.time_column if isinstance(known, Config) else "t_s"
    return log, config_of_table(known, log.names, _step_s(log, time_column), units)


def _step_s(log: TableLog, time_column: str) -> float:
    """Return the usual time from row to row, 0 where it cannot be had.

    Errors: LogError for rows that are not in the order of time, or that float32 does not tell apart.
    """
    if not log.holds_time(time_column):
        return 0.0  # reading it raises the error
    cells = log.column(time_column, time_column)
    times = np.array([seconds_of(cell) for cell in cells], float) if isinstance(cells, list) else cells
    times = times[np.isfinite(times)]
    steps = np.diff(times)
    _refuse_float32(times, steps, f"{log.name}: column {time_column}")
    backward = int((steps < 0).sum())
    if backward > _MOST_BACKWARD * len(steps):  # a clock is set back now and then, no more
        raise LogError(
            "the rows are not in the order of time",
            where=f"{log.name}: column {time_column}",
            found=f"{backward:,} of {len(times):,} that are earlier than the row before",
            expected="a table sorted by time (in pandas: sort_values or sort_index)",
        )
    steps = steps[steps > 0]
    return round(float(np.median(steps)), 6) if len(steps) else 0.0


def _refuse_float32(times: FloatColumn, steps: FloatColumn, where: str) -> None:
    """Refuse times that float32 has rounded so far that rows have the same. Errors: LogError."""
    if not len(steps):
        return
    with np.errstate(over="ignore"):  # infinite, and so no number of float32
        rounded = times.astype(np.float32)
    apart_s = float(np.spacing(np.abs(rounded).max()))
    if apart_s > SLOW_S and np.array_equal(rounded, times) and np.median(np.abs(steps)) < apart_s:
        raise LogError(
            f"the times are rounded to float32, whose numbers are {apart_s:g} s apart there",
            where=where,
            found=f"{len(np.unique(times)):,} times in {len(times):,} rows",
            expected="float64 or dates (datetime64), from before they became float32",
        )


def require_number(name: str, value: object, least: float, unit: str = "", most: float = math.inf) -> None:
    """Refuse what is no finite number of at least and at most so much. Errors: UsageError."""
    if not (isinstance(value, Real) and math.isfinite(value) and least <= float(value) <= most):
        to = f"to {most:g} {unit}".rstrip() if math.isfinite(most) else f"{unit}or more"
        expected = f"{least:g} {to}" if math.isfinite(least) else "a number"
        raise UsageError("no such number", where=name, found=value, expected=expected)


def _yaml(value: object) -> str:
    value = value.item() if isinstance(value, np.generic) else value
    try:
        return yaml.safe_dump(value, default_flow_style=True, sort_keys=False)
    except yaml.YAMLError:
        raise UsageError(
            "no value for a config", found=type(value).__name__, expected="what YAML holds"
        ) from None
