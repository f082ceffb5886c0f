"""Estimates as an MCAP file (extra ``mcap``): JSON messages for Foxglove, Lichtblick and PlotJuggler."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from canest import __version__
from canest.core.errors import OutputError
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS
from canest.logs.estimate_file import GRADE_DECIMALS, MASS_DECIMALS, Columns, Decimals, EstimateWriter
from canest.logs.estimate_message import SCHEMA_NAME, TOPIC, message, schema
from canest.system.installation import how_to_add

if TYPE_CHECKING:
    from canest.core.estimates import Estimates

#: column -> decimals, as est.csv has them
NUMBERS = {
    "mass_kg": MASS_DECIMALS,
    "mass_std_kg": MASS_DECIMALS,
    "grade": GRADE_DECIMALS,
    "grade_std": GRADE_DECIMALS,
}
_NS_PER_US = 1000


class McapEstimateWriter(EstimateWriter):
    """One message per row on the topic `TOPIC`, with the decimals of est.csv, in compressed chunks.

    log_time is the tick in nanoseconds of the log's clock. Errors: OutputError, also for a clock that is
    negative, which MCAP cannot hold.
    """

    def __init__(self, path: Path, more: Decimals | None = None) -> None:
        try:
            from mcap.writer import Writer
        except ImportError:
            raise OutputError(
                "cannot write MCAP", where=str(path), expected=f"the mcap package: {how_to_add('mcap')}"
            ) from None
        super().__init__(path)
        self._decimals = {**NUMBERS, **(more or {})}
        self._rows = 0
        with self._out.errors():
            self._writer: Any = Writer(self._out.file)
            self._writer.start(profile="", library=f"canest {__version__}")
            self._writer.add_metadata("canest", {"version": __version__})
            text = schema(self._decimals).encode()
            schema_id = self._writer.register_schema(SCHEMA_NAME, "jsonschema", text)
            self._channel = self._writer.register_channel(TOPIC, "json", schema_id)

    def write(self, estimates: Estimates, more: Columns | None = None) -> None:
        """Append the next rows."""
        e = estimates
        if len(e) and int(e.t_us[0]) < 0:
            raise OutputError(
                "MCAP holds no time before 1970",
                where=str(self._out.path), found=f"{int(e.t_us[0]) / 1e6:.2f} s",
                expected="a log whose clock starts at 0 or later",
            )  # fmt: skip
        columns = {**{name: getattr(e, name) for name in NUMBERS}, **(more or {})}
        names = tuple(self._decimals.items())
        lists = [columns[name].tolist() for name, _ in names]
        with self._out.errors():
            for t_us, status, gate, *values in zip(
                e.t_us.tolist(), e.status.tolist(), e.gate.tolist(), *lists, strict=True
            ):
                numbers = {
                    name: round(value, digits or None) if value - value == 0 else None  # inf - inf is NaN
                    for (name, digits), value in zip(names, values, strict=True)
                }
                data = message(numbers, (status, STATUS_LABELS[status]), (gate, LABELS[gate]))
                t_ns = t_us * _NS_PER_US
                self._writer.add_message(self._channel, t_ns, data, t_ns, self._rows)
                self._rows += 1

    def _finish(self) -> None:
        with self._out.errors():
            self._writer.finish()
