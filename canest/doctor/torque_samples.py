"""Single torque samples that cannot be: exactly zero, or another fixed number, between sound ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.doctor.stretches import Samples

if TYPE_CHECKING:
    from canest.config import Config

ROLES = (
    "engine_torque_pct", "engine_torque", "wheel_torque", "half_shaft_torque_left", "half_shaft_torque_right",
)  # fmt: skip
#: a torque does not change so much and back again within so short a time: % of full scale, s
_JUMP_PCT, _WITHIN_US = 10.0, 300_000
#: nor come back to the same, as a share of the jump
_SAME = 0.3
#: fewer samples of one number are chance; numbers that are kept
_FEWEST, _KEPT = 5, 64


class TorqueSampleCheck:
    """Counts samples that differ from both neighbours by the number they read. Streams; memory is bounded."""

    def __init__(self, config: Config) -> None:
        self._roles = [role for role in ROLES if role in config.signals]
        self._full = config.vehicle.reference_torque_Nm or 200.0
        self._before: dict[str, tuple[IntColumn, FloatColumn]] = {}
        self._count = dict.fromkeys(self._roles, 0)
        self._most = dict.fromkeys(self._roles, -np.inf)
        self._isolated: dict[str, dict[float, int]] = {role: {} for role in self._roles}

    def push(self, samples: Samples) -> None:
        """Take the samples of a block."""
        for role in self._roles:
            if role in samples:
                self._push(role, *samples[role])

    def _push(self, role: str, t_us: IntColumn, values: FloatColumn) -> None:
        known = np.isfinite(values)
        t_us, values = t_us[known], values[known]
        self._count[role] += len(values)
        self._most[role] = max(self._most[role], float(values.max(initial=-np.inf)))
        if role in self._before:
            t_us, values = (
                np.concatenate(pair) for pair in zip(self._before[role], (t_us, values), strict=True)
            )
        self._before[role] = t_us[-2:], values[-2:]
        if len(values) < 3:
            return
        up, down = values[1:-1] - values[:-2], values[1:-1] - values[2:]
        jump = _JUMP_PCT if role == "engine_torque_pct" else 0.01 * _JUMP_PCT * self._full
        alone = (np.minimum(np.abs(up), np.abs(down)) > jump) & (np.abs(up - down) < _SAME * np.abs(up))
        alone &= (t_us[2:] - t_us[:-2] <= _WITHIN_US) & (up * down > 0)
        numbers, counts = np.unique(values[1:-1][alone], return_counts=True)
        found = self._isolated[role]
        for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
            if number in found or len(found) < _KEPT:
                found[number] = found.get(number, 0) + count

    def hints(self) -> list[str]:
        """Return which torques read a fixed number now and then, one sentence each."""
        found = []
        for role in self._roles:
            for number, count in sorted(self._isolated[role].items(), key=lambda item: -item[1])[:2]:
                if count < _FEWEST:
                    continue
                extreme = number >= self._most[role] and number != 0
                what = "exactly zero" if number == 0 else f"exactly {number:g}"
                what += ", the largest value of all," if extreme else ""
                share = 100 * count / self._count[role]
                found.append(
                    f"{role} reads {what} in {count:,} single samples ({share:.2g} %) whose neighbours do "
                    "not: no torque of the vehicle, but a gap that the sender fills"
                )
        return found
