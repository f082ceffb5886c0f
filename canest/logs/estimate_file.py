"""What every writer of estimates offers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from canest.core.frames import FloatColumn
from canest.logs.growing_result import GrowingResult

if TYPE_CHECKING:
    from canest.core.estimates import Estimates

#: of est.csv and of what equals it
MASS_DECIMALS = 1
GRADE_DECIMALS = 6
#: further columns by name, in the order of the file
Columns = Mapping[str, FloatColumn]
Decimals = Mapping[str, int]


class EstimateWriter(ABC):
    """Takes estimates in order; use as a context manager. An exception inside leaves no file.

    Errors: OutputError when the file cannot be written (full disk, no permission).
    """

    def __init__(self, path: Path) -> None:
        self._out = GrowingResult(path)

    @abstractmethod
    def write(self, estimates: Estimates, more: Columns | None = None) -> None:
        """Append the next rows. more: the further columns that the file was opened with, each (n,)."""

    def _finish(self) -> None:  # noqa: B027 - only formats that hold something back need it
        """Write what is held back."""

    def _abandon(self) -> None:  # noqa: B027 - as above
        """Let go of what cannot be finished."""

    def __enter__(self) -> EstimateWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._abandon()
            self._out.discard()
            return
        try:
            self._finish()
        except BaseException:
            self._abandon()
            self._out.discard()
            raise
        self._out.commit()
