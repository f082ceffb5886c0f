"""Tables of the benchmarks that judge estimators: pooled figures, for the terminal and for the docs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

#: figure -> heading on a page
HEADINGS = {
    "mass_rms": "mass RMS, %",
    "mass_max": "worst, %",
    "rms_120": "mass RMS from 120 s, %",
    "bias": "mean error from 120 s, %",
    "settled_max": "worst once settled, %",
    "std": "median std, %",
    "in2": "in 2 std, %",
    "in3": "in 3 std, %",
    "grade_rms": "grade RMS, degrees",
    "grade_in2": "grade in 2 std, %",
    "grade_in3": "grade in 3 std, %",
    "valid": "valid after 120 s, %",
    "ever_valid": "runs that become valid, %",
    "valid_wrong": "valid but off by 8 %, %",
    "valid_beyond": "valid but off by 3 std, %",
    "nis": "NIS",
}
_POOLED_RMS = ("mass_rms", "rms_120", "grade_rms")
_WORST = ("mass_max", "settled_max")

Run = dict[str, Any]


class Group(NamedTuple):
    """Runs of one kind of drive, one estimator, with or without accelerometer; drive "": of all kinds."""

    drive: str
    estimator: str
    accelerometer: bool
    runs: list[Run]


def grouped(runs: list[Run], drives: Sequence[str], total: bool = False) -> Iterator[Group]:
    """Yield the runs by `drive`, accelerometer and estimator, in this order; `total`: and those of all."""
    estimators = list(dict.fromkeys(run["estimator"] for run in runs))
    for drive in [*drives, *([""] if total else [])]:
        for accelerometer in (False, True):
            for estimator in estimators:
                mine = [
                    run
                    for run in runs
                    if drive in ("", run["drive"])
                    and (run["estimator"], run["accelerometer"]) == (estimator, accelerometer)
                ]
                if mine:
                    yield Group(drive, estimator, accelerometer, mine)


def drive_count(runs: list[Run]) -> int:
    """Return how many drives the runs are of."""
    return len({(run["drive"], run["seed"]) for run in runs})


def page_head(title: str, text: str, command: str) -> list[str]:
    """Return how a page begins: title, what is on it, and the command that writes it."""
    return [f"# {title}", "", text, "", f"    {command}", ""]


def pooled(runs: list[Run], figures: Sequence[str]) -> dict[str, float]:
    """Pool runs: root mean square of RMS figures, worst of maxima, mean of shares, median of stds.

    A run without a figure (NaN) does not count; NaN where no run has it.
    """
    out = {}
    for key in figures:
        values = np.array([run[key] for run in runs], np.float64)
        values = values[~np.isnan(values)]
        if not len(values):
            out[key] = float("nan")
        elif key in _POOLED_RMS:
            out[key] = float(np.sqrt(np.mean(values * values)))
        elif key in _WORST:
            out[key] = float(values.max())
        else:
            out[key] = float(np.median(values) if key == "std" else np.mean(values))
    return out


def text_table(groups: Sequence[Group], figures: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a table for the terminal."""
    wide = max(len(group.drive) for group in groups) + 1
    name = max(len(group.estimator) for group in groups) + 1
    yield f"{'drives':{wide}s}{'':{name}s} acc runs" + "".join(f"{key:>13s}" for key in figures)
    for drive, estimator, accelerometer, runs in groups:
        numbers = "".join(f"{value:13.2f}" for value in pooled(runs, figures).values())
        about = f"{drive or 'all':{wide}s}{estimator:{name}s}{'yes' if accelerometer else 'no':>4s}"
        yield f"{about}{len(runs):5d}{numbers}"


def page_table(
    groups: Sequence[Group], figures: Sequence[str], least: Mapping[str, float] | None = None
) -> list[str]:
    """Return the lines of a table in Markdown; the estimator has a column if there are several.

    least: figure -> what it should reach; one that does not is bold.
    """
    several = len({group.estimator for group in groups}) > 1
    titles = ["drives", *(["estimator"] if several else []), "accelerometer", *(HEADINGS[k] for k in figures)]
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for group in groups:
        cells = [group.drive or "**all**", *([f"`{group.estimator}`"] if several else [])]
        cells.append("yes" if group.accelerometer else "no")
        missed = missing(group, least or {})
        for key, value in pooled(group.runs, figures).items():
            cell = "" if np.isnan(value) else f"{value:.2f}"
            cells.append(f"**{cell}**" if key in missed else cell)
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def missing(group: Group, least: Mapping[str, float]) -> list[str]:
    """Return the figures of a group that do not reach what they should, as printed."""
    return [key for key, value in pooled(group.runs, list(least)).items() if round(value, 2) < least[key]]
