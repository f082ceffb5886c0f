"""Do engine and road turn by the gear table, where no signal carries the gear?"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.doctor.engine_and_road import MOST_TIMES
from canest.doctor.stretches import at
from canest.vehicle.lever_check import SPEED_TOLERANCE

#: ratios are counted in bins of 1 %, from and to
_LEAST, _MOST, _BIN = 0.2, 40.0, 0.01
#: a gear that is in changes its ratio by less from sample to sample; a clutch that slips by more
_STEADY = 0.004
#: and is where it was so long ago (us), but for noise; a shift passes many ratios in that time
_STAYS_US, _STAYS = 1_000_000, 0.02
#: a table entry accounts for ratios so near to it, bins on either side
_NEAR_BINS = 2
#: fewer steady samples prove nothing
_FEWEST = 400
#: a table that fits accounts for most of them; one that does not for hardly more than chance
_FITS, _FAILS = 0.6, 0.35
#: of a table that is proposed: at most so many gears, each with at least this share of the steady samples
_MOST_GEARS, _LEAST_SHARE = 20, 0.01
#: gears of cars and trucks are 14 % apart at least; and with fewer than so many steps nobody can tell
_CLOSEST, _FEWEST_STEPS = 0.12, 3
#: a torque converter that turns steadily slips by no more
MOST_SLIP = 0.1


class GearFit:
    """Counts how often the engine turns per turn of the output shaft, or of what the road makes of it."""

    def __init__(self, gear_ratios: Mapping[int, float]) -> None:
        self._table = np.log(np.array(sorted(gear_ratios.values()), np.float64))
        bins = int(np.log(_MOST / _LEAST) / _BIN)
        self._edges = np.log(_LEAST) + _BIN * np.arange(bins + 1)
        self._counts, self._sums = np.zeros(bins), np.zeros(bins)

    def push(
        self, t_us: IntColumn, engine_rpm: FloatColumn, shaft_rpm: FloatColumn, moving: BoolColumn
    ) -> None:
        """Take simultaneous speeds (n,). moving: where they are fast enough to compare."""
        sound = moving & (engine_rpm > 0.0)
        ratio = np.log(np.where(sound, engine_rpm, 1.0)) - np.log(np.where(sound, shaft_rpm, 1.0))
        before = at(t_us - _STAYS_US, (t_us, np.where(sound, ratio, np.nan)))
        stays = sound & (np.abs(ratio - before) < _STAYS)
        steady = stays[1:] & sound[:-1] & (np.abs(np.diff(ratio)) < _STEADY)
        found = ratio[1:][steady]
        self._counts += np.histogram(found, self._edges)[0]
        self._sums += np.histogram(found, self._edges, weights=found)[0]

    def _share(self, times: float) -> float:
        """Return which share of the steady samples a table so many times larger accounts for."""
        at = np.searchsorted(self._edges, self._table + np.log(times)) - 1
        near = (at[:, None] + np.arange(-_NEAR_BINS, _NEAR_BINS + 1)).ravel()
        near = np.unique(near[(near >= 0) & (near < len(self._counts))])
        return float(self._counts[near].sum() / self._counts.sum())

    def mistake(self) -> tuple[float | None, list[float]]:
        """Return by how many times the table is too small, and the commonest ratios; (None, []) if it fits.

        The factor is None where no factor helps. Of several that do, the nearest to 1: tables are nearly
        geometric, so that a gear up or down helps as well.
        """
        if len(self._table) < 2 or self._counts.sum() < _FEWEST or self._share(1.0) > _FAILS:
            return None, []
        tried = np.exp(np.arange(-np.log(MOST_TIMES), np.log(MOST_TIMES), 0.5 * _BIN))
        shares = np.array([self._share(times) for times in tried])
        helps = tried[shares > max(_FITS, 0.9 * shares.max())]
        if not len(helps):
            return None, self._commonest()
        nearest = helps[np.abs(np.log(helps)).argmin()]
        group = helps[np.abs(np.log(helps / nearest)) < 2 * _NEAR_BINS * _BIN]
        return float(np.exp(np.log(group).mean())), self._commonest()

    def fitting(self, times: Iterable[float]) -> list[float]:
        """Return the factors with which the table accounts for most steady samples, about as well as any."""
        shares = {each: self._share(each) for each in times}
        least = max(_FITS, 0.95 * max(shares.values()))
        return [each for each, share in shares.items() if share > least]

    def measured(self) -> dict[int, float]:
        """Return the ratios that were driven by number, from the largest on; {} where too little was seen."""
        if self._counts.sum() < _FEWEST:
            return {}
        ratios = sorted(self._commonest(most=_MOST_GEARS, least=_LEAST_SHARE), reverse=True)
        return dict(enumerate(ratios, 1))

    def _commonest(self, most: int = 3, least: float = 0.05) -> list[float]:
        counts, found = self._counts.copy(), []
        for _ in range(most):
            peak = int(counts.argmax())
            if counts[peak] < least * self._counts.sum():
                break
            near = slice(max(0, peak - _NEAR_BINS), peak + _NEAR_BINS + 1)
            found.append(float(np.exp(self._sums[near].sum() / self._counts[near].sum())))
            counts[max(0, peak - 5) : peak + 6] = 0.0
        return found


def stepless(ratios: Collection[float]) -> bool:
    """Return whether what was measured as gears is a ratio without steps: no gearbox has them so close."""
    steps = np.diff(np.log(sorted(ratios)))
    return len(steps) >= _FEWEST_STEPS and bool(np.median(steps) < _CLOSEST)


def slipping_gears(times: Mapping[int, float]) -> list[int]:
    """Return the lowest gears where those alone turn the engine a little too fast: a torque converter slips.

    times: gear -> measured ratio by the table's.
    """
    slip = [number for number, factor in times.items() if factor > 1 + SPEED_TOLERANCE]
    rest = [number for number in times if number not in slip]
    others_fit = all(abs(times[number] - 1) <= SPEED_TOLERANCE for number in rest)
    lowest = bool(slip) and bool(rest) and max(slip) < min(rest)
    return slip if lowest and others_fit and max(times.values()) <= 1 + MOST_SLIP else []


def table_line(ratios: Mapping[int, float]) -> str:
    """Return a gear table as it stands in a config."""
    return "gear_ratios: {" + ", ".join(f"{n}: {ratio:.4g}" for n, ratio in sorted(ratios.items())) + "}"
