"""Refuses a database whose numbers would make cantools allocate gigabytes or compute for hours.

cantools makes lists with one entry per bit of every message and signal, and one layout per multiplexer value,
as soon as it reads their numbers. So the numbers are looked up in the text first.
"""

from __future__ import annotations

import re

from canest.core.errors import ConfigError

MOST_FILE_BYTES = 16 * 1024 * 1024  #: a whole J1939 database has 4 MB
MOST_MESSAGE_BYTES = 4096  #: CAN XL has 2048, ISO-TP and J1939 transport up to 4095 and 1785
MOST_TOTAL_BYTES = 256 * 1024  #: of all messages: cantools takes 0.35 s for each one of 4096
MOST_MULTIPLEXER_VALUES = 65_536

_STRING = re.compile(rb'"(?:\\.|[^"\\])*"', re.DOTALL)
#: by format: the length of a message in bytes, then start and length of a signal in bits. A pattern of one
#: format that begins with its letters is found ten times faster than one of all formats.
_DBC = (rb"BO_\s+\d+\s+\w+\s*:\s*(\d+)", rb"SG_\s+\w+[^:\"]{0,40}:\s*(\d+)\s*\|\s*(\d+)")
_SYM = (rb"^\s*(?:Len|DLC)=(\d+)", rb"^\s*Sig=\S+\s+(\d+)|^\s*(?:Sig|Var)=\S+\s+\w+\s+(\d+)(?:,(\d+))?")
_XML = (
    rb"<Message\b[^>]*\slength=[\"'](\d+)|<FRAME-LENGTH>\s*(\d+)",
    rb"\b(?:offset|length)=[\"'](\d+)|<(?:LENGTH|START-POSITION)>\s*(\d+)",
)
_NUMBERS = {"dbc": _DBC, "sym": _SYM}
_MULTIPLEXED = re.compile(rb"\bSG_MUL_VAL_\s[^;]*")
_RANGE = re.compile(rb"(\d+)\s*-\s*(\d+)")


def refuse_excess(content: bytes, file_format: str, where: str) -> None:
    """Look through the content of a database file. Errors: ConfigError naming what is too large.

    file_format: dbc, sym, or one of XML: kcd, arxml.
    """
    if len(content) > MOST_FILE_BYTES:
        expected = f"at most {MOST_FILE_BYTES >> 20} MB"
        raise ConfigError("database too large", where=where, expected=expected)
    message_bytes, signal_bits = (
        re.compile(numbers, re.MULTILINE) for numbers in _NUMBERS.get(file_format, _XML)
    )
    if file_format in _NUMBERS:  # XML has its numbers in quotes
        content = _STRING.sub(lambda text: b'"' + b"\n" * text[0].count(b"\n") + b'"', content)
    total = 0
    for found in message_bytes.finditer(content):
        length = _largest(found)
        total += length
        _refuse("message too long", length, MOST_MESSAGE_BYTES, "bytes", content, found, where)
        _refuse("messages too long altogether", total, MOST_TOTAL_BYTES, "bytes", content, found, where)
    for found in signal_bits.finditer(content):
        most = 8 * MOST_MESSAGE_BYTES
        _refuse("signal outside any message", _largest(found), most, "bits", content, found, where)
    values = 0
    for found in _MULTIPLEXED.finditer(content):
        values += sum(max(0, int(high) - int(low) + 1) for low, high in _ranges(found[0]))
        what = "too many multiplexer values"
        _refuse(what, values, MOST_MULTIPLEXER_VALUES, "values", content, found, where)


def _largest(found: re.Match[bytes]) -> int:
    # more digits than a number can have that anybody means; int() refuses more than 4300
    return max(int(number[:20]) for number in found.groups() if number is not None)


def _ranges(text: bytes) -> list[tuple[int, int]]:
    return [(int(low[:20]), int(high[:20])) for low, high in _RANGE.findall(text)]


def _refuse(
    what: str, value: int, most: int, unit: str, content: bytes, found: re.Match[bytes], where: str
) -> None:
    if value > most:
        line = content.count(b"\n", 0, found.end()) + 1
        raise ConfigError(
            what, where=f"{where}:{line}", found=f"{value:,} {unit}", expected=f"at most {most:,} {unit}"
        )
