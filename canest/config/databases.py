"""The databases that stand beside a config: what the files under its key `dbc` hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cantools.database.can import Database


class Databases:
    """Kept beside a config, and no part of its content.

    names: the value of `dbc` that they belong to; None while none have been read.
    Equal to any other, and left behind where a config goes to another process, which reads the files faster
    than it is handed their contents.
    """

    def __init__(self, names: tuple[str, ...] | None = None, databases: Sequence[Database] = ()) -> None:
        self.names, self.databases = names, list(databases)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Databases)

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[type[Databases], tuple[()]]:
        return Databases, ()
