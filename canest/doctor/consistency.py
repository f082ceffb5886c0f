"""Compares signals that must agree with the config's vehicle facts: wheel radius, gears, reference torque."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from canest.core.columns import finite
from canest.core.frames import FloatColumn, IntColumn
from canest.core.roles import RADPS_PER_RPM
from canest.doctor.engine_and_road import (
    MIN_MPS,
    ROAD_SPEEDS,
    at_radius,
    one_mistake,
    signals_first,
    unit_hint,
    words,
)
from canest.doctor.gear_table import GearFit, slipping_gears, stepless, table_line
from canest.doctor.proportion import MIN_PAIRS, Proportion
from canest.doctor.reported_ratio import ReportedRatio
from canest.doctor.speed_units import UNIT_FACTORS, mistaken_unit
from canest.doctor.stretches import Samples, at
from canest.vehicle.lever_check import SPEED_TOLERANCE
from canest.vehicle.role_sources import AT_WHEELS

if TYPE_CHECKING:
    from canest.config import Config

#: pairs that are kept for a gear
MOST_PAIRS = 3000
#: pairs that a gear of a proposed table needs
FEW_PAIRS = 20
#: a gear has one ratio; a clutch or converter that slips has many, whose middle half spreads further
RATIO_SPREAD = 0.05
#: reference torques that differ by less are rounding
TORQUE_TOLERANCE = 0.01
_ENGINE = "engine_speed"
#: gears that are named
_SHOWN = 4


class ConsistencyCheck:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._vehicle = config.vehicle
        self._reported = ReportedRatio()
        self._radius_m = {role: Proportion() for role in ROAD_SPEEDS}
        self._gears: set[int] = set()
        self._turns: dict[int, FloatColumn] = {}
        self._turns_of = "output_shaft_speed"
        self._without_gear = GearFit(config.vehicle.gear_ratios)
        self._reference_Nm: float | None = None
        self._uses_reference = "reference_torque" in config.signals
        #: torque at the wheels needs no ratio, and a config without gears has given none
        self._needs_ratio = bool(config.vehicle.gear_ratios) or not config.signals.keys() & {*AT_WHEELS}

    def push(self, stretch: Samples) -> None:
        """Take the samples of a stretch."""
        if "reference_torque" in stretch:
            values = finite(stretch["reference_torque"][1])
            if len(values):
                self._reference_Nm = float(values[-1])
        if "output_shaft_speed" in stretch:
            stamps, rpm = stretch["output_shaft_speed"]
            wheel_radps = rpm * (RADPS_PER_RPM / self._vehicle.final_drive)
            for role in ROAD_SPEEDS:
                if role in stretch:
                    self._speeds(role, stretch[role], (stamps, wheel_radps))
        if "gear_ratio" in stretch and _ENGINE in stretch:
            stamps, ratio = stretch["gear_ratio"]
            self._reported.push(ratio, at(stamps, stretch[_ENGINE]), *self._shaft(stamps, stretch))
        if "gear" in stretch:
            gear = stretch["gear"][1]
            known = gear[np.isfinite(gear) & (gear > 0) & (gear < 100)]
            self._gears.update(np.unique(known).astype(int).tolist())
            if self._by_gear:
                self._ratios(stretch)
        if self._fit is not None and _ENGINE in stretch:
            stamps, engine_rpm = stretch[_ENGINE]
            shaft_rpm, least_rpm = self._shaft(stamps, stretch)
            self._fit.push(stamps, engine_rpm, shaft_rpm, shaft_rpm > least_rpm)

    @property
    def _by_gear(self) -> bool:
        """Whether the table counts: the ratio that does is that of the bus, where it has one."""
        return not self._reported.has_values

    @property
    def _fit(self) -> GearFit | None:
        """What tells the gear where no signal has had one."""
        return None if self._gears or self._reported.has_values else self._without_gear

    def _speeds(
        self, role: str, road: tuple[IntColumn, FloatColumn], wheel: tuple[IntColumn, FloatColumn]
    ) -> None:
        self._radius_m[role].add(road[1], at(road[0], wheel), road[1] > MIN_MPS)

    def _ratios(self, stretch: Samples) -> None:
        """Note how often the engine turns per turn of the output shaft while a gear stays in."""
        if _ENGINE not in stretch:
            return
        stamps, gear = stretch["gear"]
        shaft_rpm, least_rpm = self._shaft(stamps, stretch)
        engine_rpm = at(stamps, stretch[_ENGINE])
        stays = np.zeros(len(gear), np.bool_)
        stays[1:-1] = (gear[1:-1] == gear[:-2]) & (gear[1:-1] == gear[2:])
        stays &= np.isfinite(engine_rpm) & (shaft_rpm > least_rpm)
        for number in sorted(self._gears):
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
        shaft_rpm = at(stamps, stretch[turning])
        if turning != "output_shaft_speed":
            shaft_rpm = shaft_rpm * rpm_per_mps
        return shaft_rpm, MIN_MPS * rpm_per_mps

    def hints(self) -> list[str]:
        """Return what does not fit, one sentence each."""
        v = self._vehicle
        hints = self._speed_hints() + self._ratio_hints() + self._table_hints()
        hints += one_mistake(v, self._turns_of, self._reported.times(), "gear_ratio")
        hints += self._unknown_gears() + self._one_gear_hints()
        received, declared = self._reference_Nm, v.reference_torque_Nm
        if received is not None and declared is not None and abs(received / declared - 1) > TORQUE_TOLERANCE:
            use = (
                "used when received" if self._uses_reference else "not used: signals maps no reference_torque"
            )
            hints.append(
                f"the engine reports a reference torque of {received:g} N m ({use}), "
                f"the config has {declared:g}"
            )
        return hints

    def _measured(self, pairs: int = MIN_PAIRS) -> dict[int, float]:
        """Return gear -> how often the engine turns per turn of the output shaft, where that is one ratio."""
        found = {}
        for number, turns in sorted(self._turns.items()):
            low, middle, high = np.percentile(turns, (25, 50, 75))
            if len(turns) >= pairs and high - low < RATIO_SPREAD * middle:
                found[number] = float(middle)
        return found

    def _unknown_gears(self) -> list[str]:
        """Return which gears were driven that the table lacks, and the table as measured."""
        v, measured = self._vehicle, self._measured(FEW_PAIRS)
        unknown = sorted(self._gears - set(v.gear_ratios))
        if v.gear_ratios and unknown:
            more = {number: measured[number] for number in unknown if number in measured}
            line = f"; measured: {table_line({**v.gear_ratios, **more})}" if more else ""
            were = f"gears {', '.join(map(str, unknown))} were driven"
            return [f"{were}, and gear_ratios has no such entry{line}"]
        missing = self.missing_table()
        return [missing] if missing else []

    def missing_table(self) -> str:
        """Return that the config has no gear table though there are gears, and the one as measured; else ''.

        A vehicle without a table counts as one of a single gear.
        """
        if self._vehicle.gear_ratios or not self._by_gear or not self._needs_ratio:
            return ""
        measured = self._measured(FEW_PAIRS) if self._fit is None else self._fit.measured()
        if len(measured) < 2:
            return ""
        counted = "" if self._fit is None else ", numbered from the largest that stayed in for a second"
        if stepless(measured.values()):
            return self._stepless_text(measured.values())
        where = f"{words(self._turns_of)} turn in {len(measured)} ratios"
        return (
            f"vehicle.gear_ratios is missing, and engine and {where}"
            f"{at_radius(self._vehicle, self._turns_of)}: {table_line(measured)}{counted}"
        )

    def _stepless_text(self, ratios: Collection[float]) -> str:
        return (
            f"engine and {words(self._turns_of)} turn in ratios without steps, {min(ratios):.3g} to "
            f"{max(ratios):.3g}{at_radius(self._vehicle, self._turns_of)}, as by a CVT: map its ratio "
            "(signals.gear_ratio) or a torque at the wheels"
        )

    def _one_gear_hints(self) -> list[str]:
        """Return that a vehicle of one gear turns as it does when a speed is taken in another unit."""
        v = self._vehicle
        if not (v.has_one_gear and self._by_gear and self._needs_ratio):
            return []
        if v.gear_ratios and self._fit is None:
            return []
        measured = self._measured() if self._fit is None else self._fit.measured()
        if v.gear_ratios and stepless(measured.values()):
            return [self._stepless_text(measured.values())]
        if len(measured) != 1:
            return []
        (turns,), declared = measured.values(), next(iter(v.gear_ratios.values()), 1.0)
        return one_mistake(v, self._turns_of, turns / declared, "vehicle.gear_ratios")

    def _speed_hints(self) -> list[str]:
        v, hints, radius_shown = self._vehicle, [], False
        for role, compared in self._radius_m.items():
            radius_m = compared.times
            if radius_m is None:
                continue
            times = radius_m / v.wheel_radius_m
            if abs(times - 1) <= SPEED_TOLERANCE:
                continue
            if mistaken := mistaken_unit(times):
                hints.append(
                    f"{role} is {times:.3g} times what the output shaft gives, as it is when {mistaken}: "
                    f"look at the unit of signals.{role}"
                )
            elif not radius_shown:
                radius_shown = True
                hints.append(
                    f"{signals_first(times, role, 'output_shaft_speed')}"
                    f"{role.replace('_', ' ')} and output shaft agree with wheel_radius_m {radius_m:.3f} "
                    f"(at final_drive {v.final_drive:g}), the config has {v.wheel_radius_m:g}; or with "
                    f"final_drive {v.final_drive / times:.3g} (at wheel_radius_m {v.wheel_radius_m:g})"
                )
        return hints

    def _ratio_hints(self) -> list[str]:
        """Return which gears of the table do not turn as they should."""
        if not self._by_gear:
            return []
        v = self._vehicle
        found = {n: ratio for n, ratio in self._measured().items() if n in v.gear_ratios}
        times = {number: ratio / v.gear_ratios[number] for number, ratio in found.items()}
        wrong = [number for number, factor in times.items() if abs(factor - 1) > SPEED_TOLERANCE]
        if not wrong:
            return []
        against = words(self._turns_of)
        least, most = min(times.values()), max(times.values())
        one = most - least < SPEED_TOLERANCE * most  # one mistake for all gears
        if one and (hint := unit_hint(self._turns_of, (least + most) / 2)):
            return [hint]
        if one and len(times) > 1:
            return one_mistake(v, self._turns_of, (least + most) / 2, "vehicle.gear_ratios")
        shown = [f"{found[n]:.3g} in gear {n} (gear_ratios: {v.gear_ratios[n]:g})" for n in wrong[:_SHOWN]]
        more = f" and {len(wrong) - _SHOWN} gears more" if len(wrong) > _SHOWN else ""
        listed = f"engine and {against} turn in the ratio {', '.join(shown)}{more}"
        if slipping_gears(times):
            return [
                f"{listed}, and the higher gears fit: a torque converter that slips in low gears does that. "
                "Leave gear_ratios as they are; signals.lockup_engaged tells when it does"
            ]
        measured = f"Measured{at_radius(self._vehicle, self._turns_of)}: {table_line(self._measured())}"
        first = signals_first(least, _ENGINE, self._turns_of) if one else ""
        return [f"{first}{listed}: is the table another gearbox's? {measured}"]

    def _table_hints(self) -> list[str]:
        """Return what is wrong with a gear table where no signal carries the gear."""
        if self._fit is None:
            return []
        times, commonest = self._fit.mistake()
        if not commonest:
            return []
        units = self._fit.fitting(1.0 / factor for factor in UNIT_FACTORS)
        if times is None and units:  # beyond what a wrong radius or axle makes
            times = units[0]
        if times is not None and (hint := unit_hint(self._turns_of, times)):
            return [hint]
        v, against = self._vehicle, self._turns_of.replace("_", " ")
        listed = ", ".join(f"{ratio:.3g}" for ratio in commonest)
        found = f"engine and {against} turn mostly in the ratio {listed}, and gear_ratios has nothing near"
        if times is None:
            return [f"{found}: is the table another gearbox's, or final_drive another axle's?"]
        if self._turns_of in ROAD_SPEEDS:
            radius_m = v.wheel_radius_m / times
            mistaken = "".join(f", or if {mistaken_unit(1.0 / each)}" for each in units)
            mistaken += f" (unit of signals.{self._turns_of})" if units else ""
            return [
                f"{found}; it would fit with wheel_radius_m {radius_m:.3f} instead of {v.wheel_radius_m:g}, "
                f"or final_drive {v.final_drive * times:.3g} instead of {v.final_drive:g}{mistaken}"
            ]
        return [f"{found}; it would fit if all were {times:.3g} times as large"]
