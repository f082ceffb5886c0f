"""Reads the database files that a config names, each once while its content stays the same."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from canest.config.limits import how_to_read
from canest.config.schema import Config
from canest.core.errors import ConfigError
from canest.system.output_conflicts import Named
from canest.system.shipped_files import candidates, find, is_file

if TYPE_CHECKING:
    from cantools.database.can import Database

#: file -> its time of change and size when it was looked at, its bytes and the database that they hold
_parsed: dict[Path, tuple[tuple[int, int], bytes, Database]] = {}


def read_databases(config: Config) -> Config:
    """Return a config with what its DBC files, and its road map, hold now beside it.

    Errors: ConfigError for a file that is missing or no database, with its place in the config.
    """
    places = ((name, config.at(f"dbc.{i}")) for i, name in enumerate(config.dbc))
    config = config.with_databases([read_database(find("dbc", name, place)) for name, place in places])
    return _read_road(config) if config.road_map is not None else config


def config_files(config: Config) -> list[Named]:
    """Return the files that a config was made from, those that are still there: its own, DBCs, road map."""
    named: list[tuple[str, str, str]] = [("the config", "configs", config.file)] if config.file else []
    named += [(f"the DBC {name}", "dbc", name) for name in config.dbc]
    found: list[Named] = [
        (what, next(filter(is_file, candidates(kind, name)), None)) for what, kind, name in named
    ]
    return [*found, ("the road map", config.road_map)]


def _read_road(config: Config) -> Config:
    """Return a config with its road map. Errors: ConfigError with its place in the config."""
    from canest.road.table import read_map

    assert config.road_map is not None
    try:
        return config.with_road(read_map(config.road_map))
    except ConfigError as error:
        where = f"{config.at('road_map')}: {error.where}"
        raise ConfigError(error.what, where=where, found=error.found, expected=error.expected) from error


def read_database(path: str | Path) -> Database:
    """Return the database of a file (DBC, or another format that cantools reads).

    The same object comes back until there is something else in the file.
    Errors: ConfigError for a file that is missing, no database, or one without CAN messages.
    """
    # numpy comes with the decoder, which takes as long to import as the config
    from canest.decode.database import parse
    from canest.decode.database_limits import MOST_FILE_BYTES

    file = Path(path).resolve()
    before = _parsed.get(file)
    try:
        status = file.stat()
        # looked up first: what changes meanwhile is read next time
        version = status.st_mtime_ns, status.st_size
        if before is not None and before[0] == version:
            return before[2]
        with file.open("rb") as opened:
            content = opened.read(MOST_FILE_BYTES + 1)
    except OSError as error:
        raise ConfigError(
            f"cannot be read: {error.strerror or error}", where=str(path), expected=how_to_read(error)
        ) from error
    same = before is not None and before[1] == content
    database = before[2] if before is not None and same else parse(content, file.suffix, str(path))
    _parsed[file] = version, content, database
    return database
