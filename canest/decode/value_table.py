"""Value tables: what the labels of a DBC, the texts of a table or raw numbers mean to a role.

A config's ``map`` has labels (``Gang_1``) or raw numbers (``3``) as keys. Letter case does not count, and
``on``, ``yes`` and ``true`` are one word, as they are to YAML. What a map does not list holds no value.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canest.core.errors import ConfigError

if TYPE_CHECKING:
    from cantools.database.can import Signal

_SWITCH = {"yes": "on", "true": "on", "no": "off", "false": "off"}
#: labels that an error names
_SHOWN = 8


@dataclass(slots=True)
class Label:
    """A raw number of a signal or text of a column: its label, how often it came, what it counts as."""

    raw: int | str
    label: str
    count: int
    value: float | None


def labels_of(signal: Signal) -> dict[int, str]:
    """Return the value table (VAL_) of a DBC signal: raw number -> label."""
    return {int(raw): str(label) for raw, label in (signal.choices or {}).items()}


def raw_table(entries: Mapping[str, float], signal: Signal, where: str = "") -> dict[int, float]:
    """Return a map of labels and raw numbers as raw bits -> number.

    Errors: ConfigError for a label that the DBC does not have, and a number that the signal cannot hold.
    """
    if signal.is_float:
        raise ConfigError("a float signal has no raw numbers to map", where=where, expected="no map:")
    labels, found = labels_of(signal), {}
    low, high = (-1 << (signal.length - 1), (1 << (signal.length - 1)) - 1)
    if not signal.is_signed:
        low, high = 0, (1 << signal.length) - 1
    for key, number in entries.items():
        raws = [raw for raw, label in labels.items() if label.strip().casefold() == key.strip().casefold()]
        raws = raws or [raw for raw, label in labels.items() if _word(label) == _word(key)]
        if not raws:
            raws = [_raw_number(key, labels, where)]
        for raw in raws:
            if not low <= raw <= high:
                expected = f"{low} to {high}, as {signal.name} holds"
                raise ConfigError("no raw number of the signal", where=where, found=raw, expected=expected)
            found[raw & ((1 << signal.length) - 1)] = number
    return found


def _raw_number(key: str, labels: Mapping[int, str], where: str) -> int:
    try:
        number = float(key)
    except ValueError:
        number = math.nan
    if math.isfinite(number) and number.is_integer():
        return int(number)
    if labels:
        near = difflib.get_close_matches(key, labels.values(), n=3, cutoff=0.5)
        named = near or list(dict.fromkeys(labels.values()))[:_SHOWN]
        expected = "a raw number, or a label of the DBC: " + ", ".join(named)
    else:
        expected = "a raw number: the DBC has no labels (VAL_) for this signal"
    if key in _SWITCH.values():
        expected += " (YAML reads a bare yes, no, true or false as on or off)"
    raise ConfigError("no such label", where=where, found=key, expected=expected)


class TextTable:
    """What the cells of a column, or the characters of a signal, mean.

    entries: text or number -> number.
    """

    def __init__(self, entries: Mapping[str, float]) -> None:
        self._words = {_word(key): number for key, number in entries.items()}
        self._numbers = {n: number for key, number in entries.items() if (n := _number(key)) is not None}

    def number(self, cell: str | float) -> float:
        """Return what a cell means, NaN for one that is not listed. Its text counts, then its number."""
        if isinstance(cell, str):
            word = _word(cell)
            if word in self._words:
                return self._words[word]
        value = _number(cell)
        return math.nan if value is None else self._numbers.get(value, math.nan)


def _word(label: str) -> str:
    word = label.strip().casefold()
    return _SWITCH.get(word, word)


def _number(cell: str | float) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
