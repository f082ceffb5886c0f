"""Columns of a table that are empty in most rows: each row holds what has changed, and no more."""

from __future__ import annotations

from canest.core.gates import Gate
from canest.doctor.reasons import FinishedRun

#: share of samples that the gate `invalid` closes, and of a column's rows that are empty, from which on
#: the cells in between may be what is lacking
_INVALID_SHARE, _EMPTY_SHARE = 0.25, 0.25
_SHOWN = 4


def sparse_column_warnings(run: FinishedRun) -> list[str]:
    """Return that empty cells keep samples from being learned from, and what helps."""
    rows, pipeline = run.reader.frames, run.pipeline
    empty: dict[str, int] = getattr(run.reader, "bad_cells", {})
    if pipeline.gate_counts.get(Gate.INVALID.label, 0) < _INVALID_SHARE * max(pipeline.samples, 1):
        return []
    columns = dict.fromkeys(column for column, *_ in run.table_map.roles.values())
    shares = {column: empty.get(column, 0) / max(rows, 1) for column in columns}
    sparse = [f"{name} {100 * share:.0f} %" for name, share in shares.items() if _EMPTY_SHARE <= share < 1]
    if not sparse:
        return []
    more = f" and {len(sparse) - _SHOWN} more" if len(sparse) > _SHOWN else ""
    return [
        f"columns are empty in many rows ({', '.join(sparse[:_SHOWN])}{more}), and an empty cell counts as "
        "not available: where it stands for the value before, fill it (pandas: table.ffill())"
    ]
