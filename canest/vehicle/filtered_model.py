"""From held signals to the input of estimators: model, filter, gates, in that order."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from canest.core.columns import constant, shifted
from canest.core.frames import BoolColumn, FloatColumn
from canest.core.gates import Gate
from canest.core.samples import STEP_S, ModelBlock
from canest.grid.grid import GridBlock
from canest.vehicle.brake_hold import BrakeHold
from canest.vehicle.butterworth import Filter
from canest.vehicle.driveline_losses import loss_factor
from canest.vehicle.gating import Excitation, Gating
from canest.vehicle.lever_check import LeverCheck
from canest.vehicle.model import LongitudinalModel, RawModel
from canest.vehicle.range_rate_check import MAX_SPEED_MPS, MOTION_JUMP, STANDSTILL_MPS
from canest.vehicle.spec import ModelSpec
from canest.vehicle.stuck_sensor import StuckSensor
from canest.vehicle.working_columns import ModelColumns


class _LastUsable:
    """A column whose unusable samples repeat the last usable one, so that a filter never meets a NaN."""

    def __init__(self) -> None:
        self._last = 0.0
        self._was_usable = False

    def fill(self, x: FloatColumn, usable: BoolColumn) -> tuple[FloatColumn, BoolColumn]:
        """Return the filled column and where a filter must start anew (first usable sample)."""
        if self._was_usable and np.count_nonzero(usable) == len(usable):
            self._last = float(x[-1])
            return x, constant(False, len(x))
        before = shifted(usable, self._was_usable)
        at = np.maximum.accumulate(np.where(usable, np.arange(len(x)), -1))
        filled = np.where(at >= 0, x[at], self._last)
        self._last, self._was_usable = float(filled[-1]), bool(usable[-1])
        return filled, usable & ~before


class FilteredModel:
    """Carries the filters, the gates and the last filtered speed; block in, `ModelBlock` out."""

    def __init__(self, spec: ModelSpec, *, excitation_gate: bool = False) -> None:
        self.model = LongitudinalModel(spec)
        self._gating = Gating(spec, self.model)
        self._lever = LeverCheck(spec, self.model)
        self.stuck_sensor = StuckSensor(spec)
        self._brakes = BrakeHold(spec)
        wanted = spec.gates.low_excitation.enabled
        use = excitation_gate if wanted is None else wanted
        self._excitation = Excitation(spec) if use else None
        names = ("speed", "crank", "extra", "aero", "mu", "accelerometer", "undriven")
        self._filters = {n: Filter(spec.filter.order, spec.filter.cutoff_hz) for n in names}
        self._last_usable = {n: _LastUsable() for n in names}
        self._last_filtered_mps = np.nan
        self._was_open = False
        #: the model's working columns of the last block (for reports and the diagnosis)
        self.last_columns: ModelColumns

    @property
    def stale_ticks(self) -> Counter[str]:
        """Return, by role, the ticks on which it closed the gate `stale`."""
        return self._gating.stale_ticks

    @np.errstate(all="ignore")  # signals may be any float: what is no sane number closes a gate
    def process(self, grid: GridBlock) -> ModelBlock:
        """Turn a block of ticks into model samples."""
        grid = self._brakes.fill(self.stuck_sensor.mask_stuck(grid))
        raw = self.model.process(grid)
        self.last_columns = c = raw.columns
        moving = np.abs(raw.speed_mps) <= MAX_SPEED_MPS  # known, whatever becomes of the torque
        speed, started = self._filtered("speed", raw.speed_mps, moving, grid)
        crank_force, _ = self._filtered("crank", raw.crank_force_N, raw.usable, grid)
        extra, _ = self._filtered("extra", c.extra_N, raw.usable, grid)
        aero, _ = self._filtered("aero", raw.aero_N, raw.usable, grid)
        before = shifted(speed, self._last_filtered_mps)
        accel = np.where(started | np.isnan(before), 0.0, speed - before) / STEP_S
        self._last_filtered_mps = float(speed[-1])
        # the losses are those of the filtered torque and acceleration: noise has no direction of power
        geared_force = crank_force - np.where(raw.usable, raw.crank_mass_kg, 0.0) * accel
        losses = loss_factor(geared_force, raw.efficiency)
        force = losses * geared_force - raw.wheel_mass_kg * accel - aero + extra
        gate = self._gating.close(grid, raw, accel)
        lever_std = self._lever.std(grid, raw, gate, accel)
        if self._excitation is not None:
            low = self._excitation.low(force, gate == 0)
            gate = np.where((gate == 0) & low, np.uint8(Gate.LOW_EXCITATION), gate)
        is_open = gate == 0
        was_open = shifted(is_open, self._was_open and grid.continues)
        self._was_open = bool(is_open[-1])
        nothing = constant(math.nan, len(grid))
        # backwards an accelerometer has the other sign than the speed, which has none
        uncertain = np.isfinite(c.signal(MOTION_JUMP, np.nan)) | (c.gear < 0) | self._gating.separated
        rotating, coasting = raw.rotating_mass_kg, nothing
        if np.count_nonzero(self._gating.coasting):
            rotating = np.where(self._gating.coasting, raw.wheel_mass_kg, rotating)
            coasting = np.where(self._gating.coasting, c.extra_N - raw.aero_N, math.nan)
        accelerometer = self._sensor("accelerometer", c.signals.get("longitudinal_accel"), grid)
        return ModelBlock(
            t_us=grid.t_us,
            speed_mps=speed,
            accel_mps2=accel,
            force_N=force,
            mu=self._rolling(c, grid),
            traction_N=losses * crank_force,
            aero_N=aero,
            force_per_torque_1pm=losses * raw.lever_1pm,
            rotating_mass_kg=rotating,
            coasting_N=coasting,
            undriven_mps=self._sensor("undriven", c.signals.get("undriven_speed"), grid),
            accelerometer_mps2=accelerometer,
            slope=np.tan(c.signals["pitch"]) if "pitch" in c.signals else nothing,
            altitude_m=c.signals.get("altitude", nothing),
            yaw_rate_radps=c.signals.get("yaw_rate", nothing),
            raw_speed_mps=raw.speed_mps,
            raw_force_N=raw.force_N,
            raw_torque_Nm=c.wheel_torque_Nm if self.model.at_wheels else c.torque_Nm,
            gear=c.gear,
            gate=gate,
            restart=is_open & ~was_open,
            stopped=self._stopped(raw),
            ax_ok=np.isfinite(accelerometer) & np.isfinite(raw.speed_mps) & ~uncertain,
            lever_std=lever_std,
        )

    def _stopped(self, raw: RawModel) -> BoolColumn:
        """Return where the vehicle stands, or may: the engine's is the only speed, and it turns by itself."""
        stands: BoolColumn = np.abs(raw.speed_mps) < STANDSTILL_MPS
        return stands | (
            raw.speed_is_engine & np.isnan(raw.speed_mps) & np.isfinite(raw.columns.engine_radps)
        )

    def _rolling(self, c: ModelColumns, grid: GridBlock) -> FloatColumn:
        """Return the rolling resistance coefficient, filtered where an effect lets it change."""
        if not self.model.effects:
            return c.mu
        mu = np.where(np.isfinite(c.mu), c.mu, self.model.vehicle.rolling_resistance)
        return self._filtered("mu", mu, constant(True, len(mu)), grid)[0]

    def _filtered(
        self, name: str, x: FloatColumn, usable: BoolColumn, grid: GridBlock
    ) -> tuple[FloatColumn, BoolColumn]:
        filled, start = self._last_usable[name].fill(x, usable)
        if not grid.continues:
            start = start.copy()
            start[0] = True
        return self._filters[name].apply(filled, start), start

    def _sensor(self, name: str, signal: FloatColumn | None, grid: GridBlock) -> FloatColumn:
        """Return a further signal filtered, NaN where it is not known."""
        if signal is None:
            return constant(math.nan, len(grid))
        known = np.abs(signal) <= MAX_SPEED_MPS  # also far beyond any acceleration in m/s2
        filtered, _ = self._filtered(name, signal, known, grid)
        return np.where(known, filtered, np.nan)
