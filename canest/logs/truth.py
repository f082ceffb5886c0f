"""truth.csv: what mass and grade really were, from a simulation or a weighbridge and a map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from canest.core.errors import CanestError, LogError
from canest.core.frames import FloatColumn, IntColumn
from canest.core.table_block import TableBlock
from canest.logs.format_detection import open_log
from canest.logs.log_warnings import log_warnings
from canest.logs.memory import MemoryLog

COLUMNS = ("grade", "mass_kg")
#: tangent of the steepest road
STEEPEST_GRADE = 0.35


class Truth(NamedTuple):
    """Truth at its own rate: t_us int64 (n,), increasing; grade tan(beta), mass_kg float64 (n,) or None.

    notes: what was wrong with its table, one sentence each.
    """

    t_us: IntColumn
    grade: FloatColumn | None
    mass_kg: FloatColumn | None
    notes: tuple[str, ...] = ()


def read_truth(path: str | Path | MemoryLog) -> Truth:
    """Read a table with ``t_s`` and ``grade`` or ``mass_kg`` or both; other columns are ignored.

    Rows are put in the order of their stamps; of several with one stamp the first counts.
    Errors: LogError, one line, for a file that is none of this.
    """
    try:
        reader = open_log(path, columns=COLUMNS)
        blocks = [block for block in reader if isinstance(block, TableBlock)]
    except LogError:
        raise
    except CanestError as error:
        raise LogError(str(error), where=str(path)) from None
    if not blocks or not sum(map(len, blocks)):
        raise LogError("no truth, as it has no row", where=str(path), expected="t_s and grade or mass_kg")
    names = [name for name in COLUMNS if name in blocks[0].columns]
    if not names:
        raise LogError(
            "neither grade nor mass_kg among the columns", where=str(path), expected="t_s,grade,mass_kg"
        )
    t_us = np.concatenate([block.t_us for block in blocks])
    if "mass_kg" in names:
        mass_kg = np.concatenate([block.columns["mass_kg"] for block in blocks])
        for row in np.flatnonzero(mass_kg <= 0)[:1].tolist():
            raise LogError(
                "no vehicle weighs so little",
                where=f"{path}: row {row + 1} (t_s {t_us[row] / 1e6:.3f}): mass_kg",
                found=f"{mass_kg[row]:g}",
                expected="a mass above 0, or an empty cell where it is not known",
            )
    t_us, first = np.unique(t_us, return_index=True)
    columns = {name: np.concatenate([block.columns[name] for block in blocks])[first] for name in names}
    known = np.any([np.isfinite(column) for column in columns.values()], axis=0)
    unread = log_warnings(reader)
    if not known.any():
        raise LogError(
            "; ".join([f"no row has a number in {' or '.join(names)}", *unread]),
            where=str(path),
            expected="numbers, e.g. 0.05 for a grade of 5 %, 21000 for a mass",
        )
    notes = [f"truth: {note}" for note in (*unread, *_doubts(t_us[known], columns))]
    return Truth(t_us, columns.get("grade"), columns.get("mass_kg"), tuple(notes))


def _doubts(known_us: IntColumn, columns: Mapping[str, FloatColumn]) -> Iterator[str]:
    """Yield what can hardly be meant. known_us: stamps (n,) of the rows with a number."""
    if len(known_us) == 1:
        yield f"one row alone has a number, at t_s {known_us[0] / 1e6:.3f}; a constant mass: --mass KG"
    grade = columns.get("grade", np.empty(0))
    steepest = float(np.nanmax(np.abs(grade), initial=0.0))
    if steepest > STEEPEST_GRADE:
        yield f"grade {steepest:g} is steeper than any road: another unit, or an error (5 % is 0.05)"
