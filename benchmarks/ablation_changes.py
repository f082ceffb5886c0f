"""What leaving a mechanism out changes certainly, and on which kind of drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats
from tables import Run
from variants import DEFAULT, FIGURES, NOTICED_POINTS, NOTICED_RMS, by_variant

#: the mean over all drives counts as a kind too
EVERY = "all drives"
#: chance of one false change among all that a mechanism is judged by
CHANCE = 0.05
#: fewer drives show nothing certain; and so many changes of a mechanism are listed, each way
FEWEST, LISTED = 3, 3
#: figures that are better where they are larger
LARGER = ("in2", "grade_in2", "valid")
#: what they are called in a list
SHORT = {
    "rms_120": "mass RMS", "in2": "mass in 2 std", "grade_rms": "grade RMS", "grade_in2": "grade in 2 std",
    "valid": "valid", "valid_wrong": "valid but wrong",
}  # fmt: skip


class Change(NamedTuple):
    """A mean over the drives of one kind, before and after, and the chance of so large a difference."""

    drive: str
    accelerometer: bool
    figure: str
    before: float
    after: float
    p: float

    @property
    def is_better(self) -> bool:
        return (self.after > self.before) == (self.figure in LARGER)

    @property
    def is_large(self) -> bool:
        """Return whether the change is worth a word."""
        least = NOTICED_RMS * self.before if "rms" in self.figure else NOTICED_POINTS
        return abs(self.after - self.before) > least

    def __str__(self) -> str:
        sensor = " with" if self.accelerometer else ""
        digits = 2 if "rms" in self.figure else 1
        return (
            f"{self.drive}{sensor}: {SHORT[self.figure]} {self.before:.{digits}f} → {self.after:.{digits}f}"
        )


def certain_changes(runs: Sequence[Run], name: str) -> list[Change]:
    """Return what is certainly another without a mechanism, the most certain first.

    By a t-test of the differences on the drives of one kind, at `CHANCE` divided by the number of tests.
    """
    mine = [run for run in runs if run["variant"] in (DEFAULT, name)]
    kinds = dict.fromkeys((drive, run["accelerometer"]) for run in mine for drive in (EVERY, run["drive"]))
    tests = len(kinds) * len(FIGURES)
    found = []
    for kind in kinds:
        both = by_variant(
            [run for run in mine if kind[0] in (EVERY, run["drive"]) and kind[1] == run["accelerometer"]]
        )
        for figure in FIGURES:
            before, after = (np.array([run[figure] for run in both[v]], float) for v in (DEFAULT, name))
            known = np.isfinite(before) & np.isfinite(after)
            off = (after - before)[known]
            if len(off) < FEWEST or not np.ptp(off):
                continue
            p = float(stats.ttest_1samp(off, 0.0).pvalue)
            change = Change(*kind, figure, float(before[known].mean()), float(after[known].mean()), p)
            if p < CHANCE / tests and change.is_large:
                found.append(change)
    return sorted(found, key=lambda change: change.p)


def pays_on(runs: Sequence[Run], names: Sequence[str]) -> list[str]:
    """Return the lines of a table: on which drives what is worse without each mechanism, and what is better.

    After it those mechanisms without which nothing is certainly another.
    """
    lines, idle = ["| without | worse | better |", "|---|---|---|"], []
    for name in names:
        changes = certain_changes(runs, name)
        worse = [str(change) for change in changes if not change.is_better]
        better = [str(change) for change in changes if change.is_better]
        if not changes:
            idle.append(f"- {name}")
            continue
        cells = ("; ".join(some[:LISTED]) + _more(len(some)) for some in (worse, better))
        lines.append("| " + " | ".join((name, *cells)) + " |")
    return [*lines, "", "Without these nothing is certainly another:", "", *(idle or ["- none"])]


def _more(count: int) -> str:
    return f"; {count - LISTED} more" if count > LISTED else ""
