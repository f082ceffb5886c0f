"""Which samples the estimator may learn from, and why not from the others."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from canest.core import jit
from canest.core.columns import constant, shifted
from canest.core.frames import BoolColumn, FloatColumn
from canest.core.gates import Gate
from canest.core.roles import PEDAL
from canest.core.samples import GRAVITY_MPS2, RATE_HZ, STEP_US
from canest.grid.grid import GridBlock
from canest.vehicle.coasting import OPEN_DRIVELINE_GATES, Coasting
from canest.vehicle.driveline_state import ROAD_SPEED_LATE_S, driveline_open
from canest.vehicle.model import LongitudinalModel, RawModel
from canest.vehicle.range_rate_check import JUMP, MAX_ACCEL_MPS2, SPEED_SLACK_MPS
from canest.vehicle.spec import ModelSpec
from canest.vehicle.unreported_brake import UnreportedBrake

#: two speeds of one vehicle may differ by slip and tyre size, besides `SPEED_SLACK_MPS`
SPEED_MISMATCH_SHARE = 0.15
#: an accelerator below this may be released: some rest a step or two of SPN 91 above zero, %
RELEASED_PCT = 1.0
_NEVER = -(1 << 62)
#: the gates that a cause closes; excitation has a rule of its own
_CAUSES: list[Gate] = [g for g in Gate if g not in (Gate.OPEN, Gate.LOW_EXCITATION, Gate.RECOVERY)]


class Gating:
    """Closes the gates and opens them again after each one's recovery dwell; carries the dwell."""

    def __init__(self, spec: ModelSpec, model: LongitudinalModel) -> None:
        self._gates, self._model = spec.gates, model
        watched = (role for role in spec.roles if role in spec.required)
        self._needed = dict.fromkeys((*model.required_roles(), *watched))
        self._gearing = [role for role in ("gear_ratio", "gear") if role in spec.roles]
        self._aging = {*model.speed_roles, *self._needed, *self._gearing}
        self._pedal_only = spec.gates.brake.assume_when_pedal_released
        self._unreported = UnreportedBrake(spec) if UnreportedBrake.possible(spec) else None
        sections = {g: getattr(spec.gates, g.label) for g in _CAUSES}
        self._dwell_ticks: dict[Gate, int] = {
            g: round(s.recovery_s * RATE_HZ) for g, s in sections.items() if s.enabled
        }
        self._settle_ticks = round(spec.gates.stale.recovery_s * RATE_HZ)
        self._recovery_until_tick = self._separated_until_tick = _NEVER
        self._last_ratio = np.nan
        #: where the driveline does not link engine and wheels, in the last block (see `_separated`)
        self.separated: BoolColumn = constant(False, 0)
        #: role -> ticks on which the gate `stale` was closed by it; of speeds, where none was fresh, all
        self.stale_ticks: Counter[str] = Counter()
        self._coasting = Coasting(spec, at_wheels=model.at_wheels)
        #: where the vehicle coasts with its driveline open, in the last block (see `Coasting`)
        self.coasting: BoolColumn = constant(False, 0)

    def close(self, grid: GridBlock, raw: RawModel, accel_mps2: FloatColumn) -> NDArray[np.uint8]:
        """Return the gate code of every tick (uint8, 0 is open), the excitation gate aside."""
        code = np.zeros(len(grid), np.uint8)
        tick = grid.t_us // STEP_US
        # after a gap the filters have just started: nothing to learn until they have settled
        until = np.full(
            len(grid), self._recovery_until_tick if grid.continues else tick[0] + self._settle_ticks, np.int64
        )
        causes = self._causes(grid, raw, accel_mps2)
        self.separated = self._separated(grid, raw, causes, tick)
        # until when anything but an open driveline acts, whether or not its gate may close
        acting = np.full(len(grid), _NEVER, np.int64)
        # backwards: the cause that comes first is written last
        for gate, closed in reversed(causes):
            if not np.count_nonzero(closed):
                continue
            dwell = self._dwell_ticks.get(gate)
            ends = np.where(closed, tick + (dwell or 1), _NEVER)
            if gate not in OPEN_DRIVELINE_GATES:
                acting = np.maximum(acting, ends)
            if dwell is not None:
                code = np.where(closed, np.uint8(gate), code)
                until = np.maximum(until, ends)
        self.coasting = self._coasting.of(grid, raw, tick, acting)
        if len(until) > 1:
            until = np.maximum.accumulate(until)
        self._recovery_until_tick = int(until[-1])
        return np.where((code == 0) & (tick < until), np.uint8(Gate.RECOVERY), code)

    def _separated(
        self, grid: GridBlock, raw: RawModel, causes: list[tuple[Gate, BoolColumn]], tick: NDArray[np.int64]
    ) -> BoolColumn:
        """Return where a shift or a clutch, or what they leave swinging, parts the engine from the wheels.

        Only asked for where the speed is the engine's, through the gear: then it is no speed of the vehicle.
        """
        if not np.count_nonzero(raw.speed_is_engine):
            return constant(False, len(grid))
        until = np.full(len(grid), self._separated_until_tick if grid.continues else _NEVER, np.int64)
        for gate, closed in causes:
            if gate in (Gate.SHIFT, Gate.DRIVELINE):
                ends = tick + 1 + self._dwell_ticks.get(gate, 0)
                until = np.maximum(until, np.where(closed & raw.speed_is_engine, ends, _NEVER))
        until = np.maximum.accumulate(until)
        self._separated_until_tick = int(until[-1])
        separated: BoolColumn = raw.speed_is_engine & (tick < until)
        return separated

    def _causes(
        self, grid: GridBlock, raw: RawModel, accel_mps2: FloatColumn
    ) -> list[tuple[Gate, BoolColumn]]:
        """Return each gate whose signals are there with where it is closed, in order of precedence."""
        gates = self._gates
        stale = self._stale(grid, raw)
        causes = [(Gate.STALE, stale), (Gate.INVALID, ~raw.usable)]
        has = grid.values
        if "gear" in has:
            causes.append((Gate.REVERSE, has["gear"] < 0))
        speed = np.where(raw.usable, raw.speed_mps, 0.0)
        causes.append((Gate.LOW_SPEED, speed < gates.low_speed.min_mps))
        causes.append((Gate.BRAKE, self._braking(raw, has)))
        causes.append((Gate.SHIFT, self._shifting(grid, raw, has)))
        causes.append((Gate.DRIVELINE, self._disengaged(raw, has, accel_mps2)))
        if self._unreported is not None:
            pressed = _pressed(has, len(grid))
            causes.append((Gate.POSSIBLE_BRAKE, self._unreported.may_act(raw, accel_mps2, pressed)))
        if "pto_state" in has:
            causes.append((Gate.PTO, has["pto_state"] > 0))
        if "yaw_rate" in has or "lateral_accel" in has:
            causes.append((Gate.TURNING, _lateral_mps2(speed, has) > gates.turning.lateral_mps2))
        causes.append((Gate.IMPLAUSIBLE, self._implausible(raw, has, accel_mps2)))
        # last: an estimator may use the reported force of a retarder where no other gate is closed
        if "retarder_torque_pct" in has:
            closed = np.abs(has["retarder_torque_pct"]) > gates.retarder.torque_pct
            causes.append((Gate.RETARDER, closed))
        return causes

    def _stale(self, grid: GridBlock, raw: RawModel) -> BoolColumn:
        never = constant(False, len(grid))
        if all(grid.stale[role] is never for role in self._aging):  # as a rule, in short blocks
            return never
        stale = constant(True, len(grid))
        for role in self._model.speed_roles:
            stale = stale & grid.stale[role]
        self._count_stale(self._model.speed_roles, stale)
        for role in self._needed:
            self._count_stale((role,), grid.stale[role])
            stale = stale | grid.stale[role]
        for role in self._gearing:
            ungeared = grid.stale[role] & ~raw.geared
            self._count_stale((role,), ungeared)
            stale = stale | ungeared
        return stale

    def _count_stale(self, roles: Iterable[str], stale: BoolColumn) -> None:
        if count := int(np.count_nonzero(stale)):
            self.stale_ticks.update(dict.fromkeys(roles, count))

    def _braking(self, raw: RawModel, has: dict[str, FloatColumn]) -> BoolColumn:
        c = raw.columns
        closed = constant(False, len(c))
        for role in ("brake_switch", "parking_brake", "abs_active"):
            if role in has:
                closed = closed | c.on(role)
        if "brake_pedal" in has:
            closed = closed | c.on("brake_pedal", self._gates.brake.pedal_pct)
        if self._pedal_only and PEDAL in has:
            closed = closed | ~_pressed(has, len(c))
        return closed

    def _shifting(self, grid: GridBlock, raw: RawModel, has: dict[str, FloatColumn]) -> BoolColumn:
        """Return where a shift is in process, or the ratio is not the one of the tick before."""
        ratio = raw.columns.ratio
        before = shifted(ratio, self._last_ratio)
        self._last_ratio = float(ratio[-1])
        closed = np.isfinite(before) & (np.abs(ratio - before) > 0.03 * before)
        closed = closed & (not self._model.at_wheels)
        if "shift_in_process" in has:
            closed = closed | raw.columns.on("shift_in_process")
        return closed

    def _disengaged(self, raw: RawModel, has: dict[str, FloatColumn], accel_mps2: FloatColumn) -> BoolColumn:
        c, gates = raw.columns, self._gates.driveline
        if self._model.at_wheels:  # what is measured there has passed the driveline, whatever it does
            return constant(False, len(c))
        closed = ~raw.geared | driveline_open(c, gates.clutch_slip_pct)
        if "engine_speed" in has:  # also where it was the speed, until the road speed contradicted it
            per_mps = c.ratio / c.radius_m
            wheel = raw.speed_mps * per_mps
            allowed = gates.ratio_mismatch * np.abs(wheel) + 5.0
            if np.count_nonzero(raw.speed_is_late):
                allowed = allowed + raw.speed_is_late * ROAD_SPEED_LATE_S * np.abs(accel_mps2) * per_mps
            wrong = np.abs(c.engine_radps - wheel) > allowed
            closed = closed | (wrong & np.isfinite(c.engine_radps) & np.isfinite(wheel) & (c.ratio > 0))
        return closed

    def _implausible(self, raw: RawModel, has: dict[str, FloatColumn], accel_mps2: FloatColumn) -> BoolColumn:
        closed = np.abs(accel_mps2) > MAX_ACCEL_MPS2
        if JUMP in has:
            closed = closed | np.isfinite(has[JUMP])
        others = [has["undriven_speed"]] if "undriven_speed" in has else []
        if "vehicle_speed" in has:
            others.append(self._model.speed_of("vehicle_speed", raw.columns))
        if others:
            allowed = SPEED_MISMATCH_SHARE * np.abs(raw.speed_mps) + SPEED_SLACK_MPS
            for other in others:
                closed = closed | (np.abs(other - raw.speed_mps) > allowed)
        return closed


@jit.kernel
def _excitation_kernel(force, open_, n, decay, least, state, low):  # type: ignore[no-untyped-def]
    """Mark samples where the force hardly varies: exponentially windowed mean and variance."""
    mean, variance, weight = state[0], state[1], state[2]
    for i in range(n):
        if open_[i]:
            weight = decay * weight + 1.0
            step = (force[i] - mean) / weight
            variance = decay * variance + (force[i] - mean) * (force[i] - mean - step)
            mean = mean + step
        low[i] = variance < least * least * weight
    state[0], state[1], state[2] = mean, variance, weight


class Excitation:
    """The low_excitation gate, against covariance wind-up (2005 paper, section 4.1)."""

    def __init__(self, spec: ModelSpec) -> None:
        section = spec.gates.low_excitation
        weight_N = GRAVITY_MPS2 * (spec.vehicle.mass_min_kg * spec.vehicle.mass_max_kg) ** 0.5
        self._decay = 1.0 - 1.0 / (section.window_s * RATE_HZ)
        self._least_N = section.force_share * weight_N
        self._state = [0.0, 0.0, 0.0]

    def low(self, force_N: FloatColumn, open_: BoolColumn) -> BoolColumn:
        """Return where the open samples of the last window vary too little (n,)."""
        n = len(force_N)
        compiled = jit.enabled()
        state = np.array(self._state) if compiled else self._state
        low = np.zeros(n, np.bool_) if compiled else [False] * n
        force = force_N if compiled else force_N.tolist()
        flags = open_ if compiled else open_.tolist()
        _excitation_kernel(force, flags, n, self._decay, self._least_N, state, low)
        self._state = [float(s) for s in state]
        return np.asarray(low, np.bool_)


def _pressed(has: dict[str, FloatColumn], n: int) -> BoolColumn:
    """Return where the accelerator is known to be pressed (n,)."""
    pressed: BoolColumn = has[PEDAL] >= RELEASED_PCT if PEDAL in has else constant(False, n)
    return pressed


def _lateral_mps2(speed_mps: FloatColumn, has: dict[str, FloatColumn]) -> FloatColumn:
    """Return the lateral acceleration (n,): of the yaw rate, else as measured (with body roll and bank)."""
    measured = np.abs(has["lateral_accel"]) if "lateral_accel" in has else constant(math.nan, len(speed_mps))
    if "yaw_rate" not in has:
        return measured
    turned = np.abs(speed_mps * has["yaw_rate"])
    return np.where(np.isnan(turned), measured, turned)
