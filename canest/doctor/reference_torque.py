"""A reference torque that nothing in the log confirms, and what to compare with the engine's type plate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.errors import ConfigError
from canest.core.roles import RADPS_PER_RPM
from canest.decode.database import is_j1939
from canest.doctor.stretches import Samples, known
from canest.pipeline.signal_map import signal_of
from canest.vehicle.role_sources import torque_role

if TYPE_CHECKING:
    from canest.config import Config

_TORQUE, _SPEED = "engine_torque_pct", "engine_speed"
#: the largest torque is one that was held for a second: no single wild sample
_HELD_US = 1_000_000
#: seconds that are kept until all of their samples have come
_WAITING = 3


class ReferenceTorqueCheck:
    """Keeps the largest torque and power. Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._vehicle = config.vehicle
        self._roles = (_TORQUE, _SPEED) if _is_unconfirmed(config) else ()
        #: second -> role -> its least value in it, of the seconds that more may come of
        self._least: dict[int, dict[str, float]] = {}
        self._torque_pct = self._power_pct_rpm = 0.0

    def push(self, samples: Samples) -> None:
        """Take the samples of a block."""
        for role in self._roles:
            if role in samples:
                t_us, values = known(samples[role])
                seconds, group = np.unique(t_us // _HELD_US, return_inverse=True)
                least = np.full(len(seconds), np.inf)
                np.minimum.at(least, group, values)
                for second, value in zip(seconds.tolist(), least.tolist(), strict=True):
                    of_second = self._least.setdefault(second, {})
                    of_second[role] = min(value, of_second.get(role, np.inf))
        for second in sorted(self._least)[:-_WAITING]:
            self._note(self._least.pop(second))

    def _note(self, least: dict[str, float]) -> None:
        net_pct = least.get(_TORQUE, 0.0) - self._vehicle.friction_torque_pct
        self._torque_pct = max(self._torque_pct, net_pct)
        self._power_pct_rpm = max(self._power_pct_rpm, net_pct * least.get(_SPEED, 0.0))

    def notes(self) -> list[str]:
        """Return that nothing confirms the number, at most one sentence."""
        while self._least:
            self._note(self._least.popitem()[1])
        stated_Nm = self._vehicle.reference_torque_Nm
        if not self._torque_pct or stated_Nm is None:
            return []
        power_kW = 1e-5 * stated_Nm * self._power_pct_rpm * RADPS_PER_RPM
        most = f"{0.01 * stated_Nm * self._torque_pct:,.0f} N m"
        most += f" and {power_kW:,.0f} kW" if power_kW else ""
        return [
            f"nothing here confirms vehicle.reference_torque_Nm = {stated_Nm:,g}, and masses are as wrong as "
            f"it is: with it the engine gave up to {most} (at full load, what its type plate has)"
        ]


def _is_unconfirmed(config: Config) -> bool:
    """Return whether percents of a number of the config count. A J1939 bus sends it, as a rule (SPN 544)."""
    try:
        used = torque_role(config.signals, config.vehicle)
    except ConfigError:  # is said where the model is built
        return False
    if used != _TORQUE or "reference_torque" in config.signals:
        return False
    sent = signal_of(config, _TORQUE)
    return sent is None or not is_j1939(sent[0])
