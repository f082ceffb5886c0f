"""What the rate of a speed or torque costs, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from canest.config.of_table import SLOW_S
from canest.config.sections import SLOWEST_ACCELEROMETER_S, SLOWEST_PERIOD_S
from canest.core.roles import LASTING
from canest.pipeline.build import behind_s
from canest.vehicle.role_sources import speed_in_use

if TYPE_CHECKING:
    from canest.config.schema import Config
    from canest.doctor.signal_report import RoleReport

#: a rate and a stated period that differ by this share contradict each other
_DIFFERS = 1.4


def slow_signal_hints(config: Config, reports: Iterable[RoleReport]) -> list[str]:
    """Return what to do about each slow signal of torque and speed, one sentence each."""
    hints = []
    speed = speed_in_use(config.signals, config.vehicle)
    for found in reports:
        rates_hz = [s.rate_hz for s in found.senders if s.rate_hz and s.valid]
        if not rates_hz:
            continue
        apart_s, stated_s = 1.0 / max(rates_hz), config.signals[found.role].period_s
        key = f"signals.{found.role}"
        if found.role == "longitudinal_accel" and apart_s > SLOWEST_ACCELEROMETER_S:
            hints.append(
                f"{key} comes once in {apart_s:.2g} s: such moments are no means; "
                f"with period_s it is not used; expected every {SLOWEST_ACCELEROMETER_S:g} s or oftener"
            )
        if (found.role != speed and found.need != "needed") or found.role in LASTING:
            continue
        if apart_s > SLOWEST_PERIOD_S:
            hints.append(
                f"{key} comes once in {apart_s:.2g} s: too seldom, since nobody knows what the vehicle does "
                f"in between; expected every {SLOWEST_PERIOD_S:g} s or oftener"
            )
        elif stated_s is None and apart_s > SLOW_S:
            hints.append(
                f"{key} comes once in {apart_s:.2g} s and is held in between, so its steps count as forces: "
                f"with period_s: {apart_s:.2g} its reports are joined, and estimates are that much later"
            )
        elif stated_s is not None and apart_s > _DIFFERS * stated_s:
            hints.append(
                f"{key} comes once in {apart_s:.2g} s, and period_s is {stated_s:g}: it is stale in between"
            )
    return hints


def delay_notes(config: Config) -> list[str]:
    """Return how late the estimates of a config with slow signals are, in one sentence; none for others."""
    late_s = behind_s(config)
    if not any(source.period_s for source in config.signals.values()):
        return []
    return [
        f"slow signals are joined: estimates use the vehicle as it was {late_s:.2g} s ago, and the grade is "
        "carried on to now"
    ]
