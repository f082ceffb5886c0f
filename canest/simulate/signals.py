"""What the controllers of the vehicle believe, at any time: the records seen through sensors and filters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.simulate.constants import COLUMNS, GRAVITY, LAUNCH, NEUTRAL, RAMP_IN, RAMP_OUT, RECORD_S, STANDING
from canest.simulate.effects import Hidden
from canest.simulate.roads import START_ELEVATION_M
from canest.simulate.scenario import Scenario

RPM = 60 / (2 * math.pi)
CCVS_DELAY_S = 0.03  #: a controller derives road speed from the shaft
BIAS_MPS2 = 0.12  #: half-width of a drawn accelerometer bias
ALTITUDE_TAU_S = 40.0  #: satellite altitude wanders this slowly


class Signals:
    """A drive's records (5 ms rows of `constants.COLUMNS`) and the sensors that look at them."""

    def __init__(
        self, records: FloatColumn, scenario: Scenario, hidden: Hidden, rng: np.random.Generator
    ) -> None:
        table = records.reshape(-1, len(COLUMNS))
        self.table: dict[str, FloatColumn] = {name: table[:, k] for k, name in enumerate(COLUMNS)}
        # a row is the state after its 5 ms
        self.t_s: FloatColumn = np.arange(1, len(table) + 1, dtype=np.float64) * RECORD_S
        self.rng = rng
        self.vehicle = scenario.vehicle
        self.sensors = scenario.sensors
        self.torque_delay_s = scenario.sensors.torque_delay_s + hidden.delay_s
        self.undriven_factor = hidden.undriven_factor
        bias = scenario.sensors.accelerometer_bias_mps2
        self.bias = float(rng.uniform(-BIAS_MPS2, BIAS_MPS2)) if bias is None else bias
        slope = self.table["grade"] / np.sqrt(1 + self.table["grade"] ** 2)
        steps = np.diff(self.table["distance_m"], prepend=0.0)
        self.table["elevation_m"] = START_ELEVATION_M + np.cumsum(slope * steps)

    def at(self, name: str, t: FloatColumn) -> FloatColumn:
        """Return a column at times t, linear between records."""
        return np.asarray(np.interp(t, self.t_s, self.table[name]), np.float64)

    def held(self, name: str, t: FloatColumn) -> FloatColumn:
        """Return a column at times t, the last record's value."""
        index = np.searchsorted(self.t_s, t, "right") - 1
        return self.table[name][np.clip(index, 0, len(self.t_s) - 1)]

    def noise(self, n: int, std: float) -> FloatColumn:
        """Return n white noise values."""
        return self.rng.normal(0.0, std, n) if std else np.zeros(n)

    def phase_in(self, t: FloatColumn, *phases: int) -> NDArray[np.bool_]:
        """Return where the driveline is in one of the phases."""
        return np.isin(self.held("phase", t), phases)

    def shifting(self, t: FloatColumn) -> NDArray[np.bool_]:
        """Return where a shift is in process."""
        return self.phase_in(t, RAMP_OUT, NEUTRAL, RAMP_IN)

    def disengaged(self, t: FloatColumn) -> NDArray[np.bool_]:
        """Return where the driveline does not transmit rigidly."""
        return self.phase_in(t, NEUTRAL, LAUNCH, STANDING)

    def indicated_pct(self, t: FloatColumn) -> FloatColumn:
        """Reported indicated torque: late, as the engine believes it, in % of the reference."""
        return self.at("indicated_Nm", t - self.torque_delay_s) / self.vehicle.reference_torque_Nm * 100

    def friction_pct(self, t: FloatColumn) -> FloatColumn:
        """Engine friction at the present speed in % of the reference."""
        krpm = self.at("engine_radps", t) * RPM / 1000
        return self.vehicle.friction_pct + self.vehicle.friction_pct_per_krpm * krpm

    def engine_rpm(self, t: FloatColumn) -> FloatColumn:
        """Engine speed; the crank is toothed finely."""
        return np.maximum(0.0, self.at("engine_radps", t) * RPM + self.noise(len(t), 0.5))

    def output_rpm(self, t: FloatColumn) -> FloatColumn:
        """Transmission output shaft speed."""
        rpm = self.at("wheel_radps", t) * RPM * self.vehicle.final_drive
        return np.where(rpm < 1.0, 0.0, rpm + self.noise(len(t), self.sensors.shaft_noise_rpm))

    def input_rpm(self, t: FloatColumn) -> FloatColumn:
        """Transmission input shaft speed; the engine's while the clutch is open."""
        ratios = np.asarray(self.vehicle.gear_ratios)[self.held("gear", t).astype(int)]
        geared = self.at("wheel_radps", t) * RPM * self.vehicle.final_drive * ratios
        return np.where(self.disengaged(t), self.at("engine_radps", t) * RPM, geared)

    def road_speed_kmh(self, t: FloatColumn) -> FloatColumn:
        """Road speed from the driven wheels with the declared radius."""
        return self.at("wheel_radps", t - CCVS_DELAY_S) * self.vehicle.wheel_radius_m * 3.6

    def axle_speed_kmh(self, t: FloatColumn) -> FloatColumn:
        """Speed of an undriven axle: it does not slip."""
        kmh = self.at("speed_mps", t) * 3.6 / self.undriven_factor
        return np.where(
            kmh < 0.05, 0.0, np.maximum(0, kmh + self.noise(len(t), self.sensors.wheel_noise_kmh))
        )

    def accelerometer(self, t: FloatColumn) -> FloatColumn:
        """Body-fixed longitudinal accelerometer: motion, gravity along the road, pitch, bias and noise."""
        grade = self.at("grade", t)
        slope = grade / np.sqrt(1 + grade * grade)
        raw = self.at("accel_mps2", t) + GRAVITY * (slope + self.at("pitch_rad", t))
        return raw + self.bias + self.noise(len(t), self.sensors.accelerometer_noise_mps2)

    def yaw_rate(self, t: FloatColumn) -> FloatColumn:
        """Yaw rate in rad/s, left positive."""
        turning = self.at("speed_mps", t) * self.at("curvature_1pm", t)
        return turning + self.noise(len(t), self.sensors.yaw_noise_radps)

    def lateral_accel(self, t: FloatColumn) -> FloatColumn:
        """Lateral acceleration in m/s2, left positive."""
        return self.at("speed_mps", t) ** 2 * self.at("curvature_1pm", t) + self.noise(len(t), 0.02)

    def steering_rad(self, t: FloatColumn) -> FloatColumn:
        """Steering wheel angle in rad, left positive."""
        return np.arctan(self.vehicle.wheelbase_m * self.at("curvature_1pm", t)) * self.vehicle.steering_ratio

    def altitude_m(self, t: FloatColumn) -> FloatColumn:
        """Altitude of satellite navigation: wandering slowly about the truth."""
        step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
        keep = math.exp(-step / ALTITUDE_TAU_S)
        wander, value = np.empty(len(t)), self.rng.normal(0.0, self.sensors.altitude_noise_m)
        for k, kick in enumerate(
            self.noise(len(t), self.sensors.altitude_noise_m * math.sqrt(1 - keep * keep))
        ):
            wander[k] = value
            value = keep * value + kick
        return self.at("elevation_m", t) + wander + self.noise(len(t), 0.2 * self.sensors.altitude_noise_m)
