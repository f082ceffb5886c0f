"""Single torque samples that cannot be: exactly zero, or another fixed number, between sound ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.doctor.stretches import Samples, known

if TYPE_CHECKING:
    from canest.config import Config

ROLES = (
    "engine_torque_pct", "engine_torque", "wheel_torque", "half_shaft_torque_left", "half_shaft_torque_right",
)  # fmt: skip
#: a torque does not change so much and back again within so short a time: % of full scale, s
_JUMP_PCT, _WITHIN_US = 10.0, 300_000
#: of torques without a known full scale, % of the range between these percentiles of what was read
_RANGE_PCT = (2, 98)
#: nor come back to the same, as a share of the jump
_SAME = 0.3
#: fewer samples of one number are chance; so are those that are not so many times as often as other numbers
_FEWEST, _TIMES = 5, 5
#: numbers that are named, and that are kept
_SHOWN, _KEPT = 2, 1000
#: jumps are kept by their size, in half octaves: the range that they are compared with grows
_PER_OCTAVE = 2


class TorqueSampleCheck:
    """Counts samples that differ from both neighbours by the number they read. Streams; memory is bounded."""

    def __init__(self, config: Config) -> None:
        self._roles = [role for role in ROLES if role in config.signals]
        self._full_Nm = config.vehicle.reference_torque_Nm
        self._before: dict[str, tuple[IntColumn, FloatColumn]] = {}
        self._count = dict.fromkeys(self._roles, 0)
        self._most = dict.fromkeys(self._roles, -np.inf)
        self._range = dict.fromkeys(self._roles, (np.inf, -np.inf))
        #: role -> number and size of its jump -> how often
        self._isolated: dict[str, dict[tuple[float, int], int]] = {role: {} for role in self._roles}

    def push(self, samples: Samples) -> None:
        """Take the samples of a block."""
        for role in self._roles:
            if role in samples:
                self._push(role, *known(samples[role]))

    def _push(self, role: str, t_us: IntColumn, values: FloatColumn) -> None:
        if not len(values):
            return
        self._count[role] += len(values)
        self._most[role] = max(self._most[role], float(values.max()))
        low, high = np.percentile(values, _RANGE_PCT).tolist()
        self._range[role] = min(low, self._range[role][0]), max(high, self._range[role][1])
        if role in self._before:
            t_us, values = (
                np.concatenate(pair) for pair in zip(self._before[role], (t_us, values), strict=True)
            )
        self._before[role] = t_us[-2:], values[-2:]
        if len(values) < 3:
            return
        up, down = values[1:-1] - values[:-2], values[1:-1] - values[2:]
        size = np.minimum(np.abs(up), np.abs(down))
        alone = (size > self._least_jump(role)) & (np.abs(up - down) < _SAME * np.abs(up))
        alone &= (t_us[2:] - t_us[:-2] <= _WITHIN_US) & (up * down > 0)
        sizes = np.floor(_PER_OCTAVE * np.log2(size[alone])).astype(int)
        found = self._isolated[role]
        for key in zip(values[1:-1][alone].tolist(), sizes.tolist(), strict=True):
            found[key] = found.get(key, 0) + 1
        if len(found) > _KEPT:  # what comes often is there again
            self._isolated[role] = {key: count for key, count in found.items() if count > 1}

    def _least_jump(self, role: str) -> float:
        """Return which jump counts, in the role's unit; where it follows the range, that may still grow."""
        if role == "engine_torque_pct":
            return _JUMP_PCT
        low, high = self._range[role]
        return 0.01 * _JUMP_PCT * (self._full_Nm or high - low)

    def _fixed(self, role: str) -> list[tuple[float, int]]:
        """Return the numbers that stand out among those of isolated samples, and how often each came."""
        least = np.floor(_PER_OCTAVE * np.log2(max(self._least_jump(role), 1e-9)))
        counts: dict[float, int] = {}
        for (number, size), count in self._isolated[role].items():
            if size >= least:
                counts[number] = counts.get(number, 0) + count
        ordered = sorted(counts.items(), key=lambda item: -item[1])
        for shown in range(_SHOWN, 0, -1):
            rest = ordered[shown][1] if len(ordered) > shown else 0
            if len(ordered) >= shown and ordered[shown - 1][1] >= max(_FEWEST, _TIMES * rest):
                return ordered[:shown]
        return []

    def hints(self) -> list[str]:
        """Return which torques read a fixed number now and then, one sentence each."""
        found = []
        for role in self._roles:
            for number, count in self._fixed(role):
                extreme = number >= self._most[role] and number != 0
                what = "exactly zero" if number == 0 else f"exactly {number:g}"
                what += ", the largest value of all," if extreme else ""
                share = 100 * count / self._count[role]
                found.append(
                    f"{role} reads {what} in {count:,} single samples ({share:.2g} %) whose neighbours do "
                    "not: no torque of the vehicle, but a gap that the sender fills"
                )
        return found
