"""Compares signals that must agree with the config's vehicle facts: wheel radius, gears, reference torque."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.frames import FloatColumn, IntColumn

if TYPE_CHECKING:
    from canest.config import Config

RPM_TO_RADPS = np.pi / 30
#: slower than this (m/s), speeds are too coarse to compare
MIN_MPS = 5.0
#: pairs needed before a comparison counts
MIN_PAIRS = 100
#: speeds that differ by less are worn tyres and rounding
SPEED_TOLERANCE = 0.03
#: reference torques that differ by less are rounding
TORQUE_TOLERANCE = 0.01


class Plausibility:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._vehicle = config.vehicle
        self._pairs, self._product, self._square = 0, 0.0, 0.0
        self._gears: set[int] = set()
        self._reference_Nm: float | None = None

    def push(self, samples: dict[str, tuple[IntColumn, FloatColumn]]) -> None:
        """Take the samples of a block."""
        if "vehicle_speed" in samples and "output_shaft_speed" in samples:
            self._speeds(samples["vehicle_speed"], samples["output_shaft_speed"])
        if "gear" in samples:
            gear = samples["gear"][1]
            known = gear[np.isfinite(gear) & (gear > 0) & (gear < 100)]
            self._gears.update(np.unique(known).astype(int).tolist())
        if "reference_torque" in samples:
            values = samples["reference_torque"][1]
            values = values[np.isfinite(values)]
            if len(values):
                self._reference_Nm = float(values[-1])

    def _speeds(self, road: tuple[IntColumn, FloatColumn], shaft: tuple[IntColumn, FloatColumn]) -> None:
        stamps, radps = shaft[0], shaft[1] * (RPM_TO_RADPS / self._vehicle.final_drive)
        known = np.isfinite(radps)
        if not known.any():
            return
        inside = (road[0] >= stamps[known][0]) & (road[0] <= stamps[known][-1])
        speed = road[1][inside]
        wheel = np.interp(road[0][inside], stamps[known], radps[known])
        both = np.isfinite(speed) & (speed > MIN_MPS)
        self._pairs += int(np.count_nonzero(both))
        self._product += float(speed[both] @ wheel[both])
        self._square += float(wheel[both] @ wheel[both])

    @property
    def radius_m(self) -> float | None:
        """The rolling radius that makes shaft speed and vehicle speed agree, None before it is known."""
        return self._product / self._square if self._pairs >= MIN_PAIRS and self._square > 0 else None

    def hints(self) -> list[str]:
        """Return what does not fit, one sentence each."""
        v, hints = self._vehicle, []
        radius = self.radius_m
        if radius is not None and abs(radius / v.wheel_radius_m - 1) > SPEED_TOLERANCE:
            hints.append(
                f"vehicle speed and output shaft agree with wheel_radius_m {radius:.3f} "
                f"(at final_drive {v.final_drive:g}), the config says {v.wheel_radius_m:g}"
            )
        unknown = sorted(self._gears - set(v.gear_ratios))
        if v.gear_ratios and unknown:
            hints.append(
                f"gears {', '.join(map(str, unknown))} were driven, and gear_ratios has no such entry"
            )
        heard, declared = self._reference_Nm, v.reference_torque_Nm
        if heard is not None and declared is not None and abs(heard / declared - 1) > TORQUE_TOLERANCE:
            hints.append(
                f"the engine says its reference torque is {heard:g} N m (used when heard), "
                f"the config says {declared:g}"
            )
        return hints
