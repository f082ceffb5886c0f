"""The public functions of canest, for notebooks and programs; `import canest` offers them all.

Logs may be files (every format that `canest replay` reads), a `FrameBlock`, a `SimulatedDrive`, or
a table: pandas, polars or pyarrow, or a mapping of names to arrays. Configs may be a `Config`, a path, or the
name of a shipped one ("class8", ...). Packages are imported by the function that needs them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from canest.config.schema import Config
from canest.core.errors import BusError, CanestError, ConfigError, LogError, OutputError, UsageError
from canest.core.frames import FrameBlock
from canest.core.gates import Gate
from canest.core.samples import Status
from canest.interface.comparison import Comparison
from canest.interface.diagnosis import Diagnosis
from canest.interface.estimates import Estimates, Replay
from canest.interface.inputs import config_of, log_and_config, log_of, with_estimator
from canest.interface.signals import Signals
from canest.interface.simulated_drive import SimulatedDrive
from canest.interface.stream import Pipeline
from canest.interface.vehicle import Vehicle
from canest.vehicle.facts import Vehicle as VehicleFacts

#: how often the diagnosis goes over a log, in terms of what compiling saves
_DIAGNOSIS_PASSES = 40


def load_config(config: str | Path, overrides: Mapping[str, object] | None = None) -> Config:
    """Load a config by path or shipped name.

    Args:
        config: path of a YAML file, or a shipped name: "class8", "class8-j1587", "kenworth", "bmw-i3",
            "ztbus", "obd-car", "testcar", "vcan".
        overrides: dotted key -> value, as `--set` of the command line. None takes a signal away
            ("signals.altitude"), and is a value where docs/config.md has null.

    Returns:
        The config: validated, immutable.

    Errors: ConfigError with file, line and key of the first mistake.

    Example:
        >>> import canest
        >>> config = canest.load_config("class8", {"filter.cutoff_hz": 1.5})
        >>> config.filter.cutoff_hz
        1.5
    """
    return config_of(config, overrides)


def replay(
    log: str | Path | FrameBlock | SimulatedDrive,
    config: Config | str | Path,
    *,
    truth: Any = None,
    mass_kg: float | None = None,
    after_s: float = 60.0,
    estimator: str | None = None,
    channel: str | None = None,
    output: str | Path | None = None,
) -> Replay:
    """Estimate mass and grade from a log: the same numbers as `canest replay`.

    The log is streamed; what stays in memory is the result, 8 MB per hour of driving (twice that while its
    parts are joined). For more than a day at once, let `canest replay -o` write files instead.

    Args:
        log: a file, frames, or a simulated drive. A table, as of `read_signals`, is for `estimate`.
        config: of the vehicle.
        truth: file or table with t_s and grade or mass_kg or both; its errors go into the summary.
        mass_kg: the true mass, if constant, in kg.
        after_s: errors count from so many seconds after the first sample on.
        estimator: name of another one than the config's, with its default options (docs/estimators.md).
        channel: of a log, this interface only ("can0").
        output: also write the estimates, as `canest replay -o` does; without it no file is written.

    Returns:
        `Replay`: columns (n,) at 50 Hz, summary.

    Errors: LogError, ConfigError, OutputError; UsageError for an output that is an input or no format.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> result = canest.replay(drive, drive.config)
        >>> result.summary["status"]
        'valid'
    """
    from canest.interface.run import replayed  # with numba where it pays

    used = with_estimator(config_of(config), estimator)
    return replayed(log_of(log), used, truth, mass_kg, after_s, channel, output)


def estimate(
    table: Any,
    config: Config | VehicleFacts | str | Path,
    estimator: str | None = None,
    *,
    units: Mapping[str, str] | None = None,
    truth: Any = None,
    mass_kg: float | None = None,
    after_s: float = 60.0,
    output: str | Path | None = None,
) -> Replay:
    """Estimate mass and grade from a table of decoded signals.

    Rows may come at 1 to 1000 Hz, evenly or not, and 50 Hz samples are made of them: between rows a value
    holds; in tables of less than 8 Hz, columns named by roles go along lines. Where the config maps a
    column, the result is bit by bit that of `canest replay` of the same table in a .csv or .parquet file.
    Else columns are known by the names of roles, in the roles' units. The columns in use are copied once,
    as float64. An empty cell means "not available"; where it stands for the value before, fill it (ffill()).

    Args:
        table: pandas, polars or pyarrow table, `Signals`, or {name: (n,)}. Time is t_s (or the config's
            sampling.time_column): seconds, or dates, UTC if without a zone; of pandas also a DatetimeIndex.
        config: of the vehicle, or a `Vehicle` alone, for columns named by role ("engine_torque",
            "vehicle_speed", ...; docs/config.md lists them with their units).
        estimator: name of one; by default the config's, for a `Vehicle` "canest".
        units: role -> unit of its column where that is another, {"vehicle_speed": "km/h"}.
        truth, mass_kg, after_s, output: as for `replay`.

    Returns:
        `Replay`; its `config` is the one that was used.

    Errors: LogError for what is no table, has no time, or has rows out of order or 5 s apart; ConfigError
        where no torque or speed is among the columns, or a unit does not fit; else as `replay`.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> table = canest.read_signals(drive, drive.config).to_pandas()
        >>> canest.estimate(table, drive.config.vehicle, units={"vehicle_speed": "m/s"}).summary["status"]
        'valid'
    """
    from canest.interface.run import replayed  # with numba where it pays

    given = config if isinstance(config, VehicleFacts) else config_of(config)
    log, used = log_and_config(table, given, units)
    return replayed(log, with_estimator(used, estimator), truth, mass_kg, after_s, None, output, given)


def compare(
    log: Any,
    config: Config | VehicleFacts | str | Path,
    *,
    truth: Any = None,
    mass_kg: float | None = None,
    estimators: Sequence[str] | None = None,
    after_s: float = 60.0,
    channel: str | None = None,
) -> Comparison:
    """Run many estimators on the same samples of one log: what `canest compare` does.

    Args:
        log: a log, or a table as for `estimate` (of which a `Vehicle` is config enough).
        config: of the vehicle; its options belong to its own estimator.
        truth, mass_kg, after_s, channel: as for `replay`.
        estimators: names; all of them by default.

    Returns:
        `Comparison`: a row and a column of estimates for each.

    Errors: LogError, ConfigError.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> both = canest.compare(drive, drive.config, truth=drive.truth, estimators=["canest", "rlsmf"])
        >>> both.table["estimators"]["canest"]["mass_rms_pct"] < 5.0
        True
    """
    from canest.interface.run import compared  # with numba where it pays

    return compared(*log_and_config(log, config), truth, mass_kg, estimators, after_s, channel)


def diagnose(
    logs: Any,
    config: Config | VehicleFacts | str | Path,
    *,
    truth: Any = None,
    mass_kg: float | None = None,
    channel: str | None = None,
) -> Diagnosis:
    """Find what the vehicle model lacks in measured data: what `canest diagnose` does, without its files.

    Args:
        logs: one log or table, or a list of logs of one vehicle.
        config: of the vehicle.
        truth: one for each log (None where there is none), as for `replay`.
        mass_kg: the true mass of all, if known, in kg.
        channel: of the logs, this interface only.

    Returns:
        `Diagnosis`: the effects found, errors before and after, the revised config.

    A log that cannot be read beside others is left out; document["data"]["left_out"] names it.

    Errors: LogError where no log can be read, or all have too little driving; ConfigError.

    Example:
        >>> import canest
        >>> drive = canest.simulate("wheel-radius")  # worn tyres, which its config does not have
        >>> canest.diagnose(drive, drive.config, truth=drive.truth).finding
        'Wheel radius explains the residual; cornering drag may be there besides.'
    """
    from canest.interface.run import diagnosed  # with numba where it pays

    several = logs if isinstance(logs, list | tuple) else [logs]
    truths = truth if isinstance(truth, list | tuple) else [truth] * len(several)
    if not several:
        raise UsageError("no logs", where="logs", expected="one, or a list of one vehicle's")
    if len(truths) != len(several):
        found = f"{len(several)} and {len(truths)}"
        raise UsageError("logs and truths differ", found=found, expected="pairs")
    pairs = [log_and_config(log, config) for log in several]
    if any(used != pairs[0][1] for _, used in pairs):
        raise UsageError("tables of one diagnosis differ", expected="the same columns and rate in all")
    return diagnosed([log for log, _ in pairs], pairs[0][1], truths, mass_kg, channel, _DIAGNOSIS_PASSES)


def simulate(scenario: str | Path | Mapping[str, Any], seed: int | None = None) -> SimulatedDrive:
    """Make a drive with known truth: what `canest simulate` does, in memory.

    Args:
        scenario: a shipped name (`canest simulate --list`), a file, or its content.
        seed: of another drive of the same kind; the same seed gives the same bits.

    Returns:
        `SimulatedDrive`: frames, truth, config. Its `write` makes the files.

    Errors: ConfigError with line and key of a mistake.

    Example:
        >>> import canest
        >>> drive = canest.simulate("demo", seed=3)
        >>> float(drive.truth["mass_kg"][0])
        21000.0
    """
    from canest.interface.simulated_drive import simulated_drive_of
    from canest.simulation.run import simulate as run  # heavy

    return simulated_drive_of(run(dict(scenario) if isinstance(scenario, Mapping) else scenario, seed))


def demo_drive() -> SimulatedDrive:
    """Return the drive that ships with canest: three minutes of a 21 t truck, of config class8.

    Returns:
        `SimulatedDrive`: a recording. `simulate("demo")` drives anew, and its numbers follow the simulator.
        Only the frames that class8 wants are kept of it, and not what was undeclared.

    Example:
        >>> import canest
        >>> canest.demo_drive().name
        'demo'
    """
    from canest.interface.demo_drive import demo_drive as read  # with the simulator

    return read()


def read_signals(
    log: Any, config: Config | VehicleFacts | str | Path, *, channel: str | None = None
) -> Signals:
    """Decode every signal that a config maps, held at 50 Hz.

    Args:
        log: as for `compare`.
        config: which names the signals.
        channel: this interface only.

    Returns:
        `Signals`: t_s and one column per role, (n,).

    Errors: LogError, ConfigError.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> "engine_speed" in canest.read_signals(drive, drive.config).values
        True
    """
    from canest.interface.run import signals_of  # keeps this module light

    return signals_of(*log_and_config(log, config), channel)


__all__ = [
    "BusError", "CanestError", "Comparison", "Config", "ConfigError", "Diagnosis", "Estimates",
    "FrameBlock", "Gate", "LogError", "OutputError", "Pipeline", "Replay", "Signals", "SimulatedDrive",
    "Status", "UsageError", "Vehicle", "compare", "demo_drive", "diagnose", "estimate", "load_config",
    "read_signals", "replay", "simulate",
]  # fmt: skip
