"""Parses DBC files with cantools, and finds messages and signals in them, or the nearest names.

cantools is imported with the first file, and only its databases: much of canest needs no DBC, and a replay
needs no bus.
"""

from __future__ import annotations

import codecs
import difflib
import importlib
import io
import logging
import sys
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from canest.core.errors import ConfigError
from canest.decode.database_limits import refuse_excess
from canest.decode.unused_entries import unused_entries, unused_entry_note, without_entries

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal
#: formats whose files are written in Windows' letters; the others in UTF-8
_WINDOWS_FORMATS = ("dbc", "sym")
#: in cantools' message about two signals that have bits in common
_OVERLAP = "are overlapping in message"
_OVERLAPS_SHOWN = 3
#: of cantools' message, whose lines are joined
_MOST_CHARS = 300
#: modules of cantools that take longer to import than they are worth here
_NOT_IMPORTED = ("tester", "logreader")
# cantools logs two messages of one name or identifier; the check names those in use, with their files
logging.getLogger("cantools.database.can.database").addFilter(
    lambda record: not str(record.msg).startswith("Overwriting message")
)
#: database -> its signals that overlap, where some do
_overlaps: WeakKeyDictionary[Database, list[str]] = WeakKeyDictionary()
#: database -> its entries without a signal, where it has some
_unused: WeakKeyDictionary[Database, list[str]] = WeakKeyDictionary()


def parse(content: bytes, suffix: str, where: str) -> Database:
    """Return the database that the bytes of a file hold.

    suffix: of the file's name, .dbc, .kcd, .sym or .arxml. where: names the file in errors.
    Errors: ConfigError for what is no database, is beyond any limit, or has no CAN messages.
    """
    file_format = suffix[1:].lower()
    marked = content.startswith(codecs.BOM_UTF8)  # an editor saved the file as UTF-8
    content = content.removeprefix(codecs.BOM_UTF8)
    refuse_excess(content, file_format, where)
    cantools_database = _cantools_database()
    encoding = "cp1252" if file_format in _WINDOWS_FORMATS and not marked else "utf-8"
    overlaps: list[str] = []
    unused: list[str] = []

    def load(strict: bool) -> Any:
        nonlocal content
        text = io.TextIOWrapper(io.BytesIO(content), encoding=encoding, errors="replace")
        try:
            return cantools_database.load(text, file_format, strict=strict)
        except cantools_database.Error as error:
            entries = unused_entries(str(error))
            shorter = without_entries(content, entries)
            if shorter == content:
                raise
        content = shorter
        unused.extend(entries)
        return load(strict)

    try:
        try:
            loaded = load(strict=True)
        except cantools_database.Error as error:
            if _OVERLAP not in str(error):
                raise
            loaded = load(strict=False)
            overlaps = _overlaps_of(loaded, cantools_database.Error)
    except Exception as error:  # a damaged file meets any exception of cantools' parsers
        reason = " ".join(str(error).split())[:_MOST_CHARS] or type(error).__name__
        raise ConfigError(
            "not a readable database", where=where, found=reason, expected="a DBC file"
        ) from error
    if not isinstance(loaded, cantools_database.Database) or not loaded.messages:
        raise ConfigError("database without CAN messages", where=where, expected="a DBC file with messages")
    database: Database = loaded
    if overlaps:
        _overlaps[database] = overlaps
    if unused:
        _unused[database] = unused
    return database


def database_warnings(databases: Sequence[Database]) -> list[str]:
    """Return which signals overlap and which entries have no signal, one sentence each."""
    unused = [unused_entry_note(_unused[database]) for database in databases if database in _unused]
    return overlap_warnings(databases) + unused


def overlap_warnings(databases: Iterable[Database]) -> list[str]:
    """Return which signals of databases overlap, one sentence for each of the first, then how many more."""
    found = [sentence for database in databases for sentence in _overlaps.get(database, [])]
    more = len(found) - _OVERLAPS_SHOWN
    return found[:_OVERLAPS_SHOWN] + ([f"{more} more messages have signals that overlap"] if more > 0 else [])


def _overlaps_of(database: Any, error_class: type[Exception]) -> list[str]:
    """Return the first overlap of each message. Errors: error_class for what else is wrong with a message."""
    found = []
    for message in database.messages:
        try:
            message.refresh(strict=True)
        except error_class as error:
            if _OVERLAP not in str(error):
                raise
            _refuse_too_long(message, error_class)
            found.append(
                f"{str(error).rstrip('.')}: both are read as the database has them, one may be wrong"
            )
    return found


def _cantools_database() -> Any:
    """Import cantools.database without cantools' bus tester and log reader.

    The tester imports python-can with a reader for every log format that is installed: 0.15 s, and more
    than a second and 100 MB where asammdf brings pandas. The log reader compiles a dozen patterns. Their
    places are held while cantools is imported, and given back, so that whoever wants them can import them.
    """
    if "cantools" in sys.modules:
        return importlib.import_module("cantools.database")
    held = [f"cantools.{name}" for name in _NOT_IMPORTED]
    sys.modules.update({name: ModuleType(name) for name in held})
    try:
        database = importlib.import_module("cantools.database")
    finally:
        for name in held:
            del sys.modules[name]
    for name in _NOT_IMPORTED:
        vars(sys.modules["cantools"]).pop(name, None)
    return database


def find_signal(
    databases: Sequence[Database], message: str, signal: str, where: str = ""
) -> tuple[Message, Signal]:
    """Return a message and its signal by name; the first database that has the message counts.

    Errors: ConfigError with the nearest names when there is no such message or signal.
    """
    for database in databases:
        for candidate in database.messages:
            if candidate.name != message:
                continue
            for found in candidate.signals:
                if found.name == signal:
                    return candidate, found
            names = [s.name for s in candidate.signals]
            raise ConfigError(
                f"no such signal in {message}", where=where, found=signal, expected=_near(signal, names)
            )
    names = [m.name for database in databases for m in database.messages]
    raise ConfigError("no such message", where=where, found=message, expected=_near(message, names))


def _near(name: str, names: Iterable[str]) -> str:
    spelled = {n.lower(): n for n in names}
    if not spelled:  # cantools reads a DBC that ends in mid-line without complaint
        return "a name, but there are none: is the file cut short?"
    near = [spelled[n] for n in difflib.get_close_matches(name.lower(), spelled, n=3, cutoff=0.5)]
    if near:
        return "a name of the DBC, perhaps " + " or ".join(near)
    return "one of " + ", ".join(sorted(spelled.values()))


def is_j1939(message: Message) -> bool:
    """Return True when a message is matched by parameter group, False when by its exact identifier."""
    return bool(message.is_extended_frame) and message.protocol == "j1939"


def _refuse_too_long(message: Message, error_class: type[Exception]) -> None:
    """Refuse a signal beyond the end of its message, which an overlap before it has hidden."""
    for signal in message.signals:
        first = signal.start
        if signal.byte_order == "big_endian":
            first = 8 * (first // 8) + 7 - first % 8
        if first + signal.length > 8 * message.length:
            raise error_class(f"The signal {signal.name} does not fit in message {message.name}")
