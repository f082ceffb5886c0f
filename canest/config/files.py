"""What was read of the files that a config names."""

from __future__ import annotations

from typing import Any


class ReadFiles:
    """Kept beside a config, and no part of what it says.

    Equal to any other, and left behind where a config goes to another process, which reads the files faster
    than it is handed their contents.
    """

    def __init__(self) -> None:
        self.kept: dict[tuple[str, ...], list[Any]] = {}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ReadFiles)

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[type[ReadFiles], tuple[()]]:
        return ReadFiles, ()
