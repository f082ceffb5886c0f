"""The live stream's protocol, for both of its ends.

One JSON object per line over a local socket beside the status socket, each with one of these keys:

- ``canest``: first, once: the version, with ``columns`` (of a row), ``gates`` and ``statuses`` (by code).
- ``rows``: after every estimation, with ``newest`` (a row, null where no estimate is of now) and ``quiet_s``
  (`quiet_s` of the status).
- ``status``: once a second, the snapshot of `canest status --json`.
- ``refused``: last, a sentence: the daemon has watchers enough.
"""

from __future__ import annotations

from pathlib import Path

#: column -> decimals, in the order of a row. status and gate are the codes of `dbc/canest.dbc`
DECIMALS: dict[str, int] = {
    "t_s": 2, "mass_kg": 1, "mass_std_kg": 1, "grade": 6, "grade_std": 6, "status": 0, "gate": 0,
    "speed_mps": 3, "torque_Nm": 1, "gear": 0, "residual_N": 0,
}  # fmt: skip
COLUMNS = tuple(DECIMALS)

Row = list[float | None]  #: one value per column, None where there is no number


def stream_path(status_path: Path) -> Path:
    """Return the stream's socket beside a daemon's status socket."""
    return status_path.with_name(status_path.name.replace("status-", "live-", 1))
