"""What the model had in each sample, as further columns of est.csv (`--columns`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from canest.core.errors import UsageError
from canest.core.frames import FloatColumn
from canest.core.nearest_name import expected_name
from canest.core.samples import STEP_S, EstimateBlock, ModelBlock
from canest.vehicle.residual import residual_N

Compute = Callable[["ExtraColumns", ModelBlock, EstimateBlock], FloatColumn]


@dataclass(frozen=True, slots=True)
class Column:
    """One column: decimals in a text file, what it means, and how to get it (n,)."""

    decimals: int
    meaning: str
    compute: Compute


class ExtraColumns:
    """A pipeline's listener that keeps columns until they are written.

    names: of `COLUMNS`, in the order of the file. Errors: UsageError for a name that there is not.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = checked(names)
        self._held: dict[str, list[FloatColumn]] = {name: [] for name in self.names}
        self._distance_m = 0.0

    @property
    def decimals(self) -> dict[str, int]:
        """Return how many decimals each column has in a text file."""
        return {name: COLUMNS[name].decimals for name in self.names}

    def __call__(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples and their estimates."""
        for name, held in self._held.items():
            held.append(np.asarray(COLUMNS[name].compute(self, samples, estimates), np.float64))

    def take(self) -> dict[str, FloatColumn]:
        """Return the columns of all samples since the last call, each (n,)."""
        taken = {name: np.concatenate(held) if held else np.empty(0) for name, held in self._held.items()}
        self._held = {name: [] for name in self.names}
        return taken

    def distance_m(self, samples: ModelBlock) -> FloatColumn:
        """Return the way driven so far; it stands still where the speed is not known."""
        steps = np.where(np.isfinite(samples.raw_speed_mps), samples.raw_speed_mps, 0.0) * STEP_S
        way = self._distance_m + np.cumsum(np.abs(steps))
        if len(way):
            self._distance_m = float(way[-1])
        return way


def checked(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names without repetitions. Errors: UsageError for a name that there is not."""
    for name in names:
        if name not in COLUMNS:
            expected = expected_name(name, COLUMNS, "a column", "--columns list")
            raise UsageError("no such column", where="--columns", found=name, expected=expected)
    return tuple(dict.fromkeys(names))


def _of_model(name: str) -> Compute:
    return lambda _, samples, __: getattr(samples, name)


def engaged(gear: FloatColumn) -> FloatColumn:
    """Return the gears of samples (n,), NaN where none is engaged or known."""
    return np.where(gear == 0, np.nan, gear)


def _residual(_: ExtraColumns, samples: ModelBlock, estimates: EstimateBlock) -> FloatColumn:
    residual = residual_N(estimates.mass_kg, samples.accel_mps2, estimates.grade, samples.mu, samples.force_N)
    return np.where(np.isfinite(samples.raw_force_N), residual, np.nan)


#: by name in the file, which carries the unit
COLUMNS: dict[str, Column] = {
    "speed_mps": Column(3, "speed over ground", _of_model("raw_speed_mps")),
    "distance_m": Column(2, "driven since the start of the log", lambda c, s, _: c.distance_m(s)),
    "accel_mps2": Column(4, "acceleration along the road, filtered", _of_model("accel_mps2")),
    "torque_Nm": Column(1, "net torque at the crank, or at the wheels", _of_model("raw_torque_Nm")),
    "gear": Column(0, "the gear that the model uses", lambda _, s, __: engaged(s.gear)),
    "traction_N": Column(1, "force from the engine's torque, filtered", _of_model("traction_N")),
    "force_N": Column(1, "known forces but gravity and rolling resistance, filtered", _of_model("force_N")),
    "aero_N": Column(1, "aerodynamic drag, filtered", _of_model("aero_N")),
    "residual_N": Column(1, "what the model with this estimate leaves unexplained", _residual),
    "altitude_m": Column(2, "altitude as sent", _of_model("altitude_m")),
    "slope": Column(6, "measured grade as sent", _of_model("slope")),
    "accelerometer_mps2": Column(4, "longitudinal accelerometer, filtered", _of_model("accelerometer_mps2")),
    "yaw_rate_radps": Column(5, "yaw rate", _of_model("yaw_rate_radps")),
    "stopped": Column(0, "1 while the vehicle stands", _of_model("stopped")),
}
