"""A torque that stays the same while the vehicle changes its speed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from canest.vehicle.role_sources import speed_in_use, torque_role

if TYPE_CHECKING:
    from canest.config import Config
    from canest.doctor.signal_report import RoleReport

#: no driver keeps a torque exactly while the speed changes by this share of its largest, in so many samples
_SPEED_SHARE, _FEWEST = 0.2, 100


def constant_torque_hints(config: Config, reports: Iterable[RoleReport]) -> list[str]:
    """Return that the torque in use never changes though the speed in use does; nothing where it does."""
    by_role = {found.role: found for found in reports}
    torque = by_role.get(torque_role(config.signals, config.vehicle))
    speed = by_role.get(speed_in_use(config.signals, config.vehicle))
    if torque is None or speed is None or torque.low is None or speed.low is None or speed.high is None:
        return []
    changes = speed.high - speed.low > _SPEED_SHARE * max(abs(speed.low), abs(speed.high))
    if torque.low != torque.high or torque.values < _FEWEST or not changes:
        return []
    return [
        f"signals.{torque.role}: {torque.expected} is always {torque.low:g} {torque.unit} while "
        f"{speed.role} changes: is it the torque that drives the vehicle, and is its factor right?"
    ]
