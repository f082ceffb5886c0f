"""Does a signal keep within the minimum and maximum that its DBC declares?"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from canest.core.columns import finite
from canest.core.frames import FloatColumn
from canest.core.roles import TWO_STATE
from canest.doctor.stretches import Samples
from canest.pipeline.signal_map import factor_and_offset, signal_of, unit_of

if TYPE_CHECKING:
    from canest.config import Config

Numbers = TypeVar("Numbers", float, FloatColumn)

#: what lies beyond by less than this share of the range is rounding
_ROUNDING = 1e-3
#: fewer samples, or a smaller share of all, are outliers
_FEWEST, _SHARE = 20, 0.01


class _Declared(NamedTuple):
    """What a DBC declares, in its own unit, and how that becomes the role's."""

    name: str
    unit: str
    low: float
    high: float
    factor: float
    offset: float

    def own(self, values: Numbers) -> Numbers:
        """Return values of the role in the unit of the DBC."""
        return (values - self.offset) / self.factor


class DeclaredRangeCheck:
    """Counts the samples beyond what the DBC declares. Streams; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._declared = dict(_declared(config))
        self._count = dict.fromkeys(self._declared, 0)
        self._beyond = dict.fromkeys(self._declared, 0)
        self._range = dict.fromkeys(self._declared, (np.inf, -np.inf))

    def push(self, samples: Samples) -> None:
        """Take the samples of a block."""
        for role, declared in self._declared.items():
            if role in samples:
                self._push(role, declared, samples[role][1])

    def _push(self, role: str, declared: _Declared, values: FloatColumn) -> None:
        values = finite(values)
        if not len(values):
            return
        low, high = sorted(map(declared.own, (float(values.min()), float(values.max()))))
        slack = _ROUNDING * (declared.high - declared.low)
        least, most = declared.low - slack, declared.high + slack
        if low < least or high > most:  # as a rule there is nothing to count
            own = declared.own(values)
            self._beyond[role] += int(np.count_nonzero((own < least) | (own > most)))
        self._count[role] += len(values)
        before = self._range[role]
        self._range[role] = min(low, before[0]), max(high, before[1])

    def hints(self) -> list[str]:
        """Return which signals leave their declared range, one sentence each."""
        found = []
        for role, declared in self._declared.items():
            beyond, count = self._beyond[role], self._count[role]
            if beyond < max(_FEWEST, _SHARE * count):
                continue
            low, high = self._range[role]
            unit = f" {declared.unit}" if declared.unit else ""
            found.append(
                f"signals.{role}: {beyond:,} of {count:,} samples of {declared.name} lie beyond the "
                f"[{declared.low:g}|{declared.high:g}]{unit} that the DBC declares ({low:.4g} .. {high:.4g} "
                "came): are byte order, start bit and factor those of the sender?"
            )
        return found


def _declared(config: Config) -> list[tuple[str, _Declared]]:
    """Return the roles whose signals have a range that means something."""
    found = []
    for role, source in config.signals.items():
        if (known := signal_of(config, role)) is None or source.map or source.validity == "ascii":
            continue
        _, signal = known
        low, high = signal.minimum, signal.maximum
        if role in TWO_STATE or signal.choices or low is None or high is None or not low < high:
            continue
        unit = unit_of(source, signal)
        factor, offset = factor_and_offset(role, source, unit)
        if factor:
            name = f"{source.message}.{source.signal}"
            found.append((role, _Declared(name, signal.unit or "", float(low), float(high), factor, offset)))
    return found
