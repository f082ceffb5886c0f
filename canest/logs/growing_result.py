"""A result file while it grows: it appears under its name when it is complete, or not at all."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from canest.system.result_files import open_result, output_errors


class GrowingResult:
    """A result that is written piece by piece. path: the name it will have. Errors: OutputError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with self.errors():
            self._result = open_result(path)
        self.file = self._result.file

    def errors(self) -> AbstractContextManager[None]:
        """Turn the system's errors into one line each."""
        return output_errors(self.path)

    def write(self, data: bytes) -> None:
        """Append bytes."""
        with self.errors():
            self.file.write(data)

    def commit(self) -> None:
        """Give the complete file its name."""
        with self.errors():
            self._result.commit()

    def discard(self) -> None:
        """Remove what has been written."""
        self._result.discard()
