"""Compares signals that must agree with the config's vehicle facts: wheel radius, gears, reference torque."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.core.roles import RADPS_PER_RPM, UNITS
from canest.doctor.gear_table import GearFit

if TYPE_CHECKING:
    from canest.config import Config

Samples = dict[str, tuple[IntColumn, FloatColumn]]

#: slower than this (m/s), speeds are too coarse to compare
MIN_MPS = 5.0
#: pairs needed before a comparison counts, and how many of them a gear remembers
MIN_PAIRS, MOST_PAIRS = 100, 3000
#: speeds that differ by less are worn tyres and rounding
SPEED_TOLERANCE = 0.03
#: a gear has one ratio; a clutch or converter that slips has many, whose middle half spreads further
RATIO_SPREAD = 0.05
#: reference torques that differ by less are rounding
TORQUE_TOLERANCE = 0.01
#: signals are compared over stretches of at least this, however small the blocks they come in
STRETCH_US = 5_000_000
#: or over so many samples: stamps may stand still, or be those of many senders
MOST_WAITING = 50_000
#: what may turn out to be in another unit or at another radius, the commonest first
ROAD_SPEEDS = ("vehicle_speed", "undriven_speed", "gps_speed")
#: gears that are named
_SHOWN = 4


class Plausibility:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._vehicle = config.vehicle
        # the ratio that counts is that of the bus, where it has one
        self._by_gear = "gear_ratio" not in config.signals
        self._waiting: dict[str, list[tuple[IntColumn, FloatColumn]]] = {}
        self._waiting_samples = 0
        self._since_us: int | None = None
        self._pairs = dict.fromkeys(ROAD_SPEEDS, 0)
        self._product = dict.fromkeys(ROAD_SPEEDS, 0.0)
        self._square = dict.fromkeys(ROAD_SPEEDS, 0.0)
        self._gears: set[int] = set()
        self._turns: dict[int, FloatColumn] = {}
        self._turns_of = "output_shaft_speed"
        #: nothing on the bus tells the gear
        gearless = config.signals.keys().isdisjoint(("gear", "gear_ratio"))
        self._fit = GearFit(config.vehicle.gear_ratios) if gearless else None
        self._reference_Nm: float | None = None
        self._uses_reference = "reference_torque" in config.signals

    def push(self, samples: Samples) -> None:
        """Take the samples of a block."""
        latest_us = None
        for role in ("engine_speed", "output_shaft_speed", "gear", *ROAD_SPEEDS):
            if role in samples and len(samples[role][0]):
                self._waiting.setdefault(role, []).append(samples[role])
                self._waiting_samples += len(samples[role][0])
                latest_us = max(latest_us or 0, int(samples[role][0][-1]))
        if "reference_torque" in samples:
            values = samples["reference_torque"][1]
            values = values[np.isfinite(values)]
            if len(values):
                self._reference_Nm = float(values[-1])
        if latest_us is None:
            return
        if self._since_us is None:
            self._since_us = latest_us
        if abs(latest_us - self._since_us) >= STRETCH_US or self._waiting_samples > MOST_WAITING:
            self._compare()

    def _compare(self) -> None:
        """Compare what has come since the last time."""
        self._since_us, self._waiting_samples = None, 0
        stretch = {
            role: (np.concatenate([t for t, _ in parts]), np.concatenate([v for _, v in parts]))
            for role, parts in self._waiting.items()
        }
        self._waiting.clear()
        if "output_shaft_speed" in stretch:
            stamps, rpm = stretch["output_shaft_speed"]
            wheel_radps = rpm * (RADPS_PER_RPM / self._vehicle.final_drive)
            for role in ROAD_SPEEDS:
                if role in stretch:
                    self._speeds(role, stretch[role], (stamps, wheel_radps))
        if "gear" in stretch:
            gear = stretch["gear"][1]
            known = gear[np.isfinite(gear) & (gear > 0) & (gear < 100)]
            self._gears.update(np.unique(known).astype(int).tolist())
            if self._by_gear:
                self._ratios(stretch)
        if self._fit is not None and "engine_speed" in stretch:
            stamps, engine_rpm = stretch["engine_speed"]
            shaft_rpm, least_rpm = self._shaft(stamps, stretch)
            self._fit.push(engine_rpm, shaft_rpm, shaft_rpm > least_rpm)

    def _speeds(
        self, role: str, road: tuple[IntColumn, FloatColumn], wheel: tuple[IntColumn, FloatColumn]
    ) -> None:
        radps = _at(road[0], wheel)
        both = np.isfinite(road[1]) & np.isfinite(radps) & (road[1] > MIN_MPS)
        self._pairs[role] += int(np.count_nonzero(both))
        self._product[role] += float(road[1][both] @ radps[both])
        self._square[role] += float(radps[both] @ radps[both])

    def _ratios(self, stretch: Samples) -> None:
        """Note how often the engine turns per turn of the output shaft while a gear stays in."""
        v = self._vehicle
        if "engine_speed" not in stretch:
            return
        stamps, gear = stretch["gear"]
        shaft_rpm, least_rpm = self._shaft(stamps, stretch)
        engine_rpm = _at(stamps, stretch["engine_speed"])
        stays = np.zeros(len(gear), np.bool_)
        stays[1:-1] = (gear[1:-1] == gear[:-2]) & (gear[1:-1] == gear[2:])
        stays &= np.isfinite(engine_rpm) & (shaft_rpm > least_rpm)
        for number in v.gear_ratios:
            rows = stays & (gear == number)
            if rows.any():
                before = self._turns.get(number, np.empty(0))
                turns = np.concatenate((before, engine_rpm[rows] / shaft_rpm[rows]))
                self._turns[number] = turns[:MOST_PAIRS]

    def _shaft(self, stamps: IntColumn, stretch: Samples) -> tuple[FloatColumn, float]:
        """Return the output shaft's speed (rpm, n), or the road's for it, and the least that counts."""
        rpm_per_mps = 1.0 / self._vehicle.mps_per_shaft_rpm
        roles = ("output_shaft_speed", *ROAD_SPEEDS)
        turning = next((role for role in roles if role in stretch), None)
        if turning is None:
            return np.full(len(stamps), np.nan), 0.0
        self._turns_of = turning
        shaft_rpm = _at(stamps, stretch[turning])
        if turning != "output_shaft_speed":
            shaft_rpm = shaft_rpm * rpm_per_mps
        return shaft_rpm, MIN_MPS * rpm_per_mps

    def hints(self) -> list[str]:
        """Return what does not fit, one sentence each."""
        self._compare()
        v = self._vehicle
        hints = self._speed_hints() + self._ratio_hints() + self._table_hints()
        unknown = sorted(self._gears - set(v.gear_ratios))
        if v.gear_ratios and unknown:
            hints.append(
                f"gears {', '.join(map(str, unknown))} were driven, and gear_ratios has no such entry"
            )
        heard, declared = self._reference_Nm, v.reference_torque_Nm
        if heard is not None and declared is not None and abs(heard / declared - 1) > TORQUE_TOLERANCE:
            use = "used when heard" if self._uses_reference else "not used: signals maps no reference_torque"
            hints.append(
                f"the engine says its reference torque is {heard:g} N m ({use}), the config says {declared:g}"
            )
        return hints

    def _speed_hints(self) -> list[str]:
        v, hints, radius_told = self._vehicle, [], False
        for role in ROAD_SPEEDS:
            if self._pairs[role] < MIN_PAIRS or not self._square[role]:
                continue
            radius_m = self._product[role] / self._square[role]
            times = radius_m / v.wheel_radius_m
            if abs(times - 1) <= SPEED_TOLERANCE:
                continue
            if mistaken := _mistaken_unit(times):
                hints.append(
                    f"{role} is {times:.3g} times what the output shaft says, as it is when {mistaken}: "
                    f"look at the unit of signals.{role}"
                )
            elif not radius_told:
                radius_told = True
                hints.append(
                    f"{role.replace('_', ' ')} and output shaft agree with wheel_radius_m {radius_m:.3f} "
                    f"(at final_drive {v.final_drive:g}), the config says {v.wheel_radius_m:g}"
                )
        return hints

    def _ratio_hints(self) -> list[str]:
        """Return which gears of the table do not turn as they should."""
        v, found = self._vehicle, {}
        for number, turns in sorted(self._turns.items()):
            low, middle, high = np.percentile(turns, (25, 50, 75))
            if len(turns) >= MIN_PAIRS and high - low < RATIO_SPREAD * middle:
                found[number] = float(middle)
        times = {number: ratio / v.gear_ratios[number] for number, ratio in found.items()}
        wrong = [number for number, factor in times.items() if abs(factor - 1) > SPEED_TOLERANCE]
        if not wrong:
            return []
        against = self._turns_of.replace("_speed", "").replace("_", " ")
        if self._turns_of in ROAD_SPEEDS:
            against += " speed"
            least, most = min(times.values()), max(times.values())
            if len(times) > 1 and most - least < SPEED_TOLERANCE * most:  # one mistake for all gears
                radius_m = v.wheel_radius_m * 2 / (least + most)
                return [
                    f"engine and {against} agree with wheel_radius_m {radius_m:.3f} (at final_drive "
                    f"{v.final_drive:g} and gear_ratios as they are), the config says {v.wheel_radius_m:g}"
                ]
        shown = [f"{found[n]:.3g} in gear {n} (gear_ratios: {v.gear_ratios[n]:g})" for n in wrong[:_SHOWN]]
        more = f" and {len(wrong) - _SHOWN} gears more" if len(wrong) > _SHOWN else ""
        listed = ", ".join(shown) + more
        return [f"engine and {against} turn in the ratio {listed}: is the table another gearbox's?"]

    def _table_hints(self) -> list[str]:
        """Return what is wrong with a table of which nothing tells the gear."""
        times, commonest = self._fit.mistake() if self._fit is not None else (None, [])
        if not commonest:
            return []
        v, against = self._vehicle, self._turns_of.replace("_", " ")
        listed = ", ".join(f"{ratio:.3g}" for ratio in commonest)
        told = f"engine and {against} turn mostly in the ratio {listed}, and gear_ratios has nothing near"
        if times is None:
            return [f"{told}: is the table another gearbox's, or final_drive another axle's?"]
        if self._turns_of in ROAD_SPEEDS:
            radius_m = v.wheel_radius_m / times
            return [
                f"{told}; it would fit with wheel_radius_m {radius_m:.3f} instead of {v.wheel_radius_m:g}, "
                f"or final_drive {v.final_drive * times:.3g} instead of {v.final_drive:g}"
            ]
        return [f"{told}; it would fit if all were {times:.3g} times as large"]


def _at(stamps: IntColumn, samples: tuple[IntColumn, FloatColumn]) -> FloatColumn:
    """Return a signal at other stamps (n,), NaN before its first sample and after its last."""
    known = np.isfinite(samples[1])
    if not known.any():
        return np.full(len(stamps), np.nan)
    return np.asarray(
        np.interp(stamps, samples[0][known], samples[1][known], left=np.nan, right=np.nan), np.float64
    )


def _mistaken_unit(times: float) -> str:
    """Return which unit of speed, taken for which other, makes it so many times too large, '' for none."""
    for true, (factor, _) in UNITS["m/s"].items():
        for taken, (other, _) in UNITS["m/s"].items():
            if factor != other and abs(times * factor / other - 1) <= SPEED_TOLERANCE:
                return f"{true} is taken for {taken}"
    return ""
