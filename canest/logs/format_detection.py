"""Opens any log: looks at the first bytes (of the decompressed content) and picks the reader."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from canest.core.errors import LogError
from canest.logs.base import BLOCK_FRAMES, KNOWN_LOGS, LogReader
from canest.logs.candump import CandumpParser
from canest.logs.candump_line import Line, is_ignorable, parse_line
from canest.logs.candump_reader import CandumpReader
from canest.logs.compression import ARCHIVE_SUFFIXES, Source
from canest.logs.line_parser import Wanted
from canest.logs.memory import MemoryLog

_HEAD_BYTES = 1 << 16
_BLANK = 0x20  #: what stands before it in ASCII steers a terminal
#: content that identifies itself -> suffix under which python-can knows it
_BINARY = {b"LOGG": ".blf", b"MDF     ": ".mf4", b"UnFinMF ": ".mf4", b"SQLite format 3\0": ".db"}
_PARQUET = b"PAR1"
#: editors of another system put it before a text
_BOM = b"\xef\xbb\xbf"
_CANDUMP_SUFFIXES = (".log", ".txt", ".candump", ".dump", "")
EXPECTED = f"{KNOWN_LOGS}, or a table of decoded signals (.csv .parquet), also compressed"


def open_log(
    path: str | Path | MemoryLog,
    *,
    wanted: Wanted | None = None,
    channel: str | None = None,
    time_column: str = "t_s",
    columns: Collection[str] | None = None,
    as_text: Collection[str] = (),
    block_frames: int = BLOCK_FRAMES,
) -> LogReader:
    """Open a log, in a file or in memory, for one pass over its blocks.

    wanted: identifiers uint32 (n,) with flags -> which frames to deliver; all are counted.
    channel: deliver this interface only; None for all.
    time_column: the column of a decoded table that holds the time, in seconds or as ISO 8601.
    columns: the columns of a decoded table to deliver; None for all. as_text: those of them that hold text.
    block_frames: about how many frames or rows a block holds; memory does not depend on the log's length.

    Errors: LogError, one line, for what cannot be opened, is no log, or has no interfaces to choose from.
    """
    if isinstance(path, MemoryLog):
        return path.open(channel=channel, time_column=time_column, columns=columns, as_text=as_text)
    path = Path(path)
    source = Source(path)
    head = source.read(_HEAD_BYTES)
    suffix = _suffix(path)
    text = head.removeprefix(_BOM)
    for magic, binary_suffix in _BINARY.items():
        if head.startswith(magic):
            return _from_python_can(source, head, binary_suffix, wanted, channel, block_frames)
    if head.startswith(_PARQUET):
        from canest.logs.parquet import ParquetReader  # wanted for this format alone

        _refuse_channel(source, channel)
        return ParquetReader(source, head, time_column, columns, block_frames, as_text)
    if _looks_like_candump(text):
        return CandumpReader(source, text, CandumpParser(wanted, channel), block_frames)
    text_suffix = _text_format(text, suffix)
    if text_suffix == "table":
        # each wanted for such a text alone
        from canest.logs.csv_table import CsvReader
        from canest.logs.frame_table import frame_table
        from canest.logs.frame_table_reader import FrameTableReader, refuse_channel_of

        laid_out = frame_table(text)
        if laid_out is not None:
            refuse_channel_of(laid_out, source, channel)
            return FrameTableReader(source, text, laid_out, wanted, channel, block_frames)
        _refuse_channel(source, channel)
        return CsvReader(source, text, time_column, columns, block_frames, as_text)
    if text_suffix:
        return _from_python_can(source, text, text_suffix, wanted, channel, block_frames)
    if not text or suffix in _CANDUMP_SUFFIXES:
        return CandumpReader(source, text, CandumpParser(wanted, channel), block_frames)
    source.close()
    raise LogError("no log that canest knows", where=str(path), found=_shown(head), expected=EXPECTED)


def _refuse_channel(source: Source, channel: str | None) -> None:
    if channel is not None:
        source.close()
        raise LogError(
            "a table of decoded signals has no interfaces",
            where=str(source.path),
            found=f"--channel {channel}",
            expected="none",
        )


def _from_python_can(
    source: Source, head: bytes, suffix: str, wanted: Wanted | None, channel: str | None, block_frames: int
) -> LogReader:
    # each wanted for its format alone
    if suffix == ".mf4":
        from canest.logs.mf4 import Mf4Reader

        return Mf4Reader(source, head, suffix, wanted, channel, block_frames)
    if suffix == ".blf":
        from canest.logs.blf import BlfReader

        return BlfReader(source, head, suffix, wanted, channel, block_frames)
    if suffix == ".asc":
        from canest.logs.asc import AscReader

        return AscReader(source, head, suffix, wanted, channel, block_frames)
    from canest.logs.python_can import PythonCanReader

    return PythonCanReader(source, head, suffix, wanted, channel, block_frames)


def _suffix(path: Path) -> str:
    """Return the suffix below that of the archive: '.csv' of 'trip.csv.xz'."""
    suffix = path.suffix.lower()
    return Path(path.stem).suffix.lower() if suffix in ARCHIVE_SUFFIXES else suffix


def _looks_like_candump(head: bytes) -> bool:
    lines = [line for line in head.split(b"\n")[:1000] if not is_ignorable(line)]
    return any(isinstance(parse_line(line), Line) for line in lines if len(line) < 1024)


def _text_format(head: bytes, suffix: str) -> str:
    """Return the suffix under which python-can knows a text log, "table", or ''."""
    lines = [line.strip() for line in head.split(b"\n")[:20]]
    first = next((line for line in lines if line), b"")
    if not first or any(byte < _BLANK and byte not in b"\t\r" for byte in first):
        return ""  # no text: bytes of some other kind may well hold a comma
    if first.lower().startswith((b"date ", b"base hex", b"base dec")) or suffix == ".asc":
        return ".asc"
    if first.startswith(b";$FILEVERSION") or suffix == ".trc":
        return ".trc"
    if first.startswith(b"timestamp,arbitration_id,"):
        return ".csv"
    separated = max(first.count(separator) for separator in (b",", b";", b"\t"))
    return "table" if suffix == ".csv" or separated >= 1 else ""


def _shown(head: bytes) -> str:
    return head[:24].decode("ascii", "backslashreplace")
