"""The lines of .asc, .trc and python-can's .csv on their way through python-can: none vanishes uncounted."""

from __future__ import annotations

import binascii
import re
from collections.abc import Callable

from canest.logs.compression import Source
from canest.logs.line_splitting import text_lines

_HEADER_LINES_MAX = 200
#: ends python-can's search for an .asc header, which otherwise swallows a line behind it
_ASC_HEADER_END = "no internal events logged\n"

_ASC_HEADER = r"//|date\b|base\b|(no\s+)?internal\s+events|(begin|end)\s+trigger"
#: what Vector's tools log beside frames: bus statistics, states, other buses, transport messages, triggers
_ASC_EVENT = (
    r"[\d.]+\s+(\d+\s+(statistic|overloadframe)|can\s+\d+\s+status|start of measurement|log\b|trig|sv:|tfs:|"
    r"j1939tp|l(in|i|\d+)\b|eth|fr\b|flexray|most|afdx|a429|wlan|gps|comment|//)"
)
#: what python-can takes for a frame
_ASC_FRAME = re.compile(r"\d+\.\d+\s+(\d+\s+(\w+\s+(Tx|Rx)|ErrorFrame)|CANFD)", re.ASCII | re.IGNORECASE)
#: PEAK's: comments, and by format version the words for warnings, errors, events and states
_TRC_EVENT = r";|.*\s(warng|error|er|ec|ev|st)\s|.*\sFFFFFFFF\s"
#: lines that hold no frame and are no fault
_NO_FRAME = {
    ".asc": re.compile(rf"\s*($|{_ASC_HEADER}|{_ASC_EVENT})", re.IGNORECASE),
    ".trc": re.compile(rf"\s*($|{_TRC_EVENT})", re.IGNORECASE),
    ".csv": re.compile(r"\s*$|timestamp,"),
}

_ASC_HEADER_LINE = re.compile(r"(date\s+\w+\s+.+|base\s+(?P<base>hex|dec)\b.*|//.*)", re.IGNORECASE)

_UNPACKED = re.compile(r"(not enough|too many) values to unpack|(list|tuple|string) index out of range")
_NO_NUMBER = re.compile(r"invalid literal for int.*?: (.*)|could not convert string to float: (.*)")


def in_plain_words(error: Exception) -> str:
    """Return Python's error for a line that holds no frame, in words for people who do not write Python."""
    text = str(error).replace("\n", " ")[:200]
    if match := _UNPACKED.match(text):
        return "too many fields" if match[1] == "too many" else "too few fields"
    if match := _NO_NUMBER.match(text):
        return f"found {match[1] or match[2]} where a number is expected"
    if isinstance(error, binascii.Error):
        return "data bytes that are not in base64"
    return f"not readable ({text})"


class Lines:
    """The lines of a source as a text file that python-can accepts, able to show the header again.

    number, current: the line handed out last. skip: called, when the next line is asked for, with one that
    should hold a frame and that nobody has claimed.
    """

    def __init__(self, source: Source, head: bytes, suffix: str, skip: Callable[[int, str], None]) -> None:
        self.number, self.current, self.ended = 0, "", False
        self._skip, self._no_frame, self._claimed = skip, _NO_FRAME[suffix], True
        self._header: list[str] = []
        self._replay: list[str] = []
        self._suffix = suffix
        self._stream = text_lines(source, head, lambda line: skip(self.number + 1, line.strip()))

    def rewind_header(self) -> None:
        """Let a new reader begin: header first, then the lines nobody has seen."""
        self._replay = list(self._header)
        if self._header and self._suffix == ".asc":
            self._replay.append(_ASC_HEADER_END)

    def drop_header(self) -> None:
        """Go on without a header, behind the next line."""
        self._header, self._replay = [], []
        next(self, None)

    def claim(self) -> None:
        """Mark the current line: it became a frame, or has been counted already."""
        self._claimed = True

    def __iter__(self) -> Lines:
        return self

    def __next__(self) -> str:
        if self._replay:
            return self._replay.pop(0)
        if not self._claimed and not self._no_frame.match(self.current):
            self._skip(self.number, self.current.strip())
        self._claimed = True  # also when there is no next one
        try:
            self.current = next(self._stream) + "\n"
        except StopIteration:
            self.ended = True
            raise
        self.number += 1
        self._claimed = False
        if len(self._header) == self.number - 1 and self._is_header(self.current):
            self._header.append(self.current)
        return self.current

    def readline(self) -> str:
        """Return the next line, '' at the end."""
        return next(self, "")

    def _is_header(self, line: str) -> bool:
        if self.number > _HEADER_LINES_MAX:
            return False
        if self._suffix == ".csv":
            return self.number == 1
        if self._suffix == ".trc":
            return line.startswith(";")
        return not line.strip()[:1].isdigit()

    # python-can takes for a file whatever has these
    def read(self, *_: object) -> str:
        """Return the next line."""
        return self.readline()

    def write(self, *_: object) -> int:
        """Take nothing."""
        return 0

    def close(self) -> None:
        """Leave the source to whoever opened it."""


def asc_base(head: str) -> str:
    """Return the base of an .asc log's numbers, "hex" or "dec", as python-can finds it in the first lines.

    '' where the header does not end within them, or ends with a frame, which python-can loses.
    """
    base = "hex"
    for line in head.split("\n")[:_HEADER_LINES_MAX]:
        match = _ASC_HEADER_LINE.match(line.strip())
        if match is None:
            return "" if _ASC_FRAME.match(line.strip()) else base
        base = match["base"] or base
    return ""


class OneLine:
    """One line of a text log, with its number."""

    def __init__(self, number: int, current: str) -> None:
        self.number, self.current = number, current

    @property
    def holds_no_frame(self) -> bool:
        """Return whether it is an .asc line that is no fault: header, comment, statistics."""
        return _NO_FRAME[".asc"].match(self.current) is not None

    @property
    def looks_like_a_frame(self) -> bool:
        """Return whether python-can takes it for a frame of an .asc log."""
        return _ASC_FRAME.match(self.current.strip()) is not None
