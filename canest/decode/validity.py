"""Validity rules: which raw values of a field are values, and which mean "not available" or "error".

J1939-71 reserves the top of every field: with a most significant byte of 0xFB and above a raw value is an
indicator, not a measurement (0xFE error, 0xFF not available); in fields shorter than a byte the two top
states are (10b and 11b of two bits).
"""

from __future__ import annotations

import re

from canest.core.errors import ConfigError

#: rule -> what it accepts, in the words of the documentation
RULES: dict[str, str] = {
    "j1939": "everything below the J1939 indicator range",
    "full": "every raw value (J1587, and buses without indicator values)",
    "source_address": "addresses 0 to 253",
    "gear": "as j1939, and raw 251 of a byte, which is park",
    "ascii": "characters of a gear: digits, N, R, P, D and a digit",
}

#: SPNs whose highest valid raw value does not follow from their width
HIGHEST_BY_SPN = {
    527: 6,  # cruise control states: only 7 is not available
    4154: 7,  # fraction of torque: 0 to 7 eighths in four bits
}

GEAR_PARK_RAW = 251  #: SPN 523, 524
GEAR_PARK = 126.0  #: the number park gets, as raw 251 with offset -125 has
_GEAR_TEXT = re.compile(rb"(?P<reverse>R(?P<back>\d?))|(?P<neutral>N)|(?P<park>P)|D?(?P<number>\d{1,2})[CL]?")


def highest_valid(width: int, rule: str, spn: int | None = None, where: str = "") -> int:
    """Return the highest raw value that a field of ``width`` bits may have under a rule.

    Errors: ConfigError for a rule that does not exist.
    """
    if rule not in RULES:
        raise ConfigError(
            "unknown validity rule", where=where, found=rule, expected="one of " + ", ".join(RULES)
        )
    everything = (1 << width) - 1
    if rule in {"full", "ascii"} or width == 1:
        return everything
    if rule == "source_address":
        return min(253, everything)
    if spn in HIGHEST_BY_SPN:
        return HIGHEST_BY_SPN[spn]
    if width < 8:
        return everything - 2
    limit = (0xFB << (width - 8)) - 1
    return GEAR_PARK_RAW if rule == "gear" and width == 8 else limit


def first_not_available(width: int) -> int:
    """Return the lowest raw value that means "not available"; the indicators below it mean "error"."""
    return 0xFF << (width - 8) if width >= 8 else (1 << width) - 1


def gear_of_text(text: bytes) -> float:
    """Return the gear that a transmission's range characters name, NaN when they name none.

    ``3``, `` 3``, ``03`` and ``D3`` are 3, so are ``3C`` and ``3L`` (torque converter open or locked), ``N``
    is 0, ``R`` and ``R1`` are -1, ``P`` is `GEAR_PARK` (SPN and PID 162 and 163).
    """
    match = _GEAR_TEXT.fullmatch(text.strip(b" \0"))
    if match is None:
        return float("nan")
    if match["number"]:
        return float(match["number"])
    if match["reverse"]:
        return -float(match["back"] or 1)
    return GEAR_PARK if match["park"] else 0.0
