"""The driver's feet, every 5 ms: how far accelerator and brake are pressed for what the plan wants."""

from __future__ import annotations

from typing import Any

from canest.core.jit import kernel
from canest.simulate.constants import GRAVITY


@kernel
def accelerate(
    c: Any, m: float, v: float, wanted: float, foot: float, resisted: float, per_force: float, least: float,
    friction: float, highest: float, pedal: float, lifted: bool, pushed: bool,
) -> Any:  # fmt: skip
    """Return the pedal (0..1), the force (N) to slow down with that the engine's drag lacks, lifted, pushed.

    c: `Constants`. m: mass (kg). v: speed, wanted: by the plan (m/s). foot: the plan's throttle, negative:
    none. resisted: resistance that the driver expects (N). per_force: crank torque (N m) per newton at the
    wheels. least: lowest force the engine can give (N). friction, highest: of the engine at its speed (N m).
    pedal, lifted, pushed: as they were 5 ms ago; the last two say that a pulse is cut short or prolonged.
    """
    short = 0.0
    if foot >= 0.0:
        # beyond the upper speed the rest of the pulse is dropped, below the lower one it is prolonged
        if v > wanted:
            lifted = True
        elif foot == 0.0:
            lifted = False
        if v < c.pulse_min:
            pushed = True
        elif v > c.pulse_min + 2.0:
            pushed = False
        want = 1.0 if pushed else 0.0 if lifted else foot
    else:
        accel = c.firmness * (wanted - v)
        accel = min(accel, c.accel_limit)
        accel = max(accel, -2.5)
        force = resisted + m * accel
        want = (force * per_force + friction + c.regeneration) / (highest + c.regeneration + 1.0)
        short = least - force
        if wanted < 0.05 and v < 2.0:
            want = 0.0
    want = min(1.0, max(0.0, want))
    pedal += min(0.02, max(-0.025, want - pedal))  # a foot needs a quarter of a second
    return pedal, short, lifted, pushed


@kernel
def slow_down(
    c: Any, m: float, v: float, wanted: float, foot: float, short: float, brake: float, braking: bool
) -> Any:
    """Return the brake (0..1; 1 is 0.6 g) and whether the driver is braking.

    short: force (N) still missing; brake, braking: as they were 5 ms ago; the others as in `accelerate`.
    A driver who does not brake never changes either.
    """
    if c.brakes > 0.0:
        braking = short > 0.0 if braking else short > m * 0.2 and wanted - v < -0.8
        holding = foot < 0.0 and wanted < 0.05 and v < 0.6
        want = 0.0
        if holding:
            braking = True
            want = 0.25
        elif braking:
            want = min(1.0, short / (m * GRAVITY * 0.6))
        brake += (want - brake) * 0.005 / 0.12
        if not braking and brake < 0.002:
            brake = 0.0
    return brake, braking
