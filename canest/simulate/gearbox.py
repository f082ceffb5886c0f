"""Which gear: the shift programme of an automated gearbox, while driving and to start from rest."""

from __future__ import annotations

from typing import Any

from canest.core.jit import kernel


@kernel
def gear_for(
    c: Any, full: Any, ratios: Any, etas: Any, gear: int, we: float, win: float, pedal: float,
    resistance: float, m: float, at: int, to_table: float,
) -> int:  # fmt: skip
    """Return the gear to be in, the present one where nothing speaks for another.

    c: `Constants`. full: full torque (N m) by engine speed, at: its row at the engine's speed, to_table: rows
    per rad/s. ratios: crank to wheels, etas: efficiency, per gear. we, win: speed of engine and gearbox input
    (rad/s). pedal: 0..1. resistance: N. m: kg.
    """
    ratio = ratios[gear]
    chosen = gear
    if we > c.upshift_low + (c.upshift_high - c.upshift_low) * pedal:
        for h in range(gear + 1, min(len(ratios), gear + 3)):
            wh = win * ratios[h] / ratio
            i = min(len(full) - 1, int(wh * to_table))
            spare = 0.9 * full[i] * ratios[h] * etas[h] / c.radius - resistance
            if wh > c.downshift * 1.08 and (spare > m * 0.04 or we > c.upshift_high * 1.1):
                chosen = h
    elif we < c.downshift * (1.0 + 0.12 * pedal) and gear > 0 and (pedal > 0.05 or we < c.downshift):
        chosen = gear - 1
        if gear > 1 and resistance > 0.9 * full[at] * ratios[chosen] * etas[chosen] / c.radius:
            chosen = gear - 2
        if win * ratios[chosen] / ratio > c.upshift_high * 1.05:
            chosen = gear
    return chosen


@kernel
def starting_gear(c: Any, full: Any, ratios: Any, etas: Any, v: float, resistance: float, m: float) -> int:
    """Return the highest of the lowest three gears that pulls away; a higher one while it still rolls.

    v: speed (m/s); the others as in `gear_for`.
    """
    gears = len(ratios)
    gear = 0
    for h in range(min(3, gears)):
        pull = 0.6 * full[min(len(full) - 1, 48)] * ratios[h] * etas[h] / c.radius
        if pull > resistance + m * 1.0 and h < gears - 1:
            gear = h
    while gear < gears - 1 and v / c.radius * ratios[gear] > c.downshift * 1.15:
        gear += 1
    return gear
