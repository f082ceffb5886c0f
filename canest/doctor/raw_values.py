"""Which raw numbers a log's signals hold: with the labels of the DBC, and those that J1939 would reserve."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import ERROR, EXTENDED, REMOTE, FrameBlock
from canest.core.roles import TWO_STATE
from canest.decode import j1939
from canest.decode.compile import FRAME_BYTES, CompiledSignal
from canest.decode.database import is_j1939
from canest.decode.groups import build_groups, exact_id
from canest.decode.validity import GEAR_PARK, gear_of_text, highest_valid
from canest.decode.value_table import Label, labels_of
from canest.pipeline.signal_map import signal_of, wants_of

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

    from canest.config import Config
    from canest.config.sections import Source

#: different raw numbers of a signal that are counted
_KEPT = 256
#: reserved numbers are values if they come for this share of the samples, and in turns with others so often
_SHARE, _TURNS = 0.01, 3
#: a wide field runs into its reserved range and out of it by steps, as a share of all its numbers
_STEP = 1 / 16
#: a field of so many bits has values that come near to its last number before they come to it
_WIDE = 8
#: labels that mean that there is no value
_NO_VALUE = re.compile(
    r"n/?a\b|sna\b|not.?avail|nicht.?verf|invalid|ungue?ltig|error|fehler|fault|defe[ck]t|init|reserv"
)


class RawSignal:
    """Counts the raw numbers of one role's signal. Streams; memory is bounded."""

    def __init__(
        self, role: str, source: Source, message: Message, signal: Signal, used: CompiledSignal
    ) -> None:
        self.role, self._source, self._signal, self._used = role, source, signal, used
        self._j1939 = is_j1939(message)
        self._id = j1939.pgn_of(message.frame_id) if self._j1939 else exact_id(message)
        self._length = message.length
        self.labels = labels_of(signal)
        self._plain = CompiledSignal(message, signal, validity="full")
        width = signal.length
        #: no range is reserved to a map, a sign or another rule
        guarded = source.validity in ("j1939", "gear") and not (
            source.map or signal.is_signed or signal.is_float
        )
        self._highest = highest_valid(width, source.validity, signal.spn) if guarded else (1 << width) - 1
        #: the last number of a field that is taken whole, and the largest that came below it
        whole = source.validity == "full" and not (source.map or signal.is_signed or signal.is_float)
        self._last_number = (1 << width) - 1 if whole and width >= _WIDE else -1
        self._ones, self._largest = 0, 0
        self._counts: dict[int, int] = {}
        self._samples = self._reserved = self._turns = self._small_turns = 0
        self._last: int | None = None

    def push(self, block: FrameBlock) -> None:
        """Take the frames of a block."""
        ids = block.can_id
        if self._j1939:
            groups = (ids >> np.uint32(8)) & np.uint32(j1939.PGN_MASK)
            if j1939.is_destination_specific(self._id):
                groups = groups & np.uint32(j1939.PGN_MASK & ~0xFF)
            hit = (groups == np.uint32(self._id)) & ((ids & np.uint32(EXTENDED)) != 0)
            if self._source.source is not None:
                hit &= (ids & np.uint32(0xFF)) == np.uint32(self._source.source)
        else:
            hit = ids == np.uint32(self._id)
        hit &= (ids & np.uint32(ERROR | REMOTE)) == 0
        rows = np.flatnonzero(hit & (block.length == self._length))
        if not len(rows):
            return
        raw = self._plain.columns(block.data[rows])[3]
        if len(raw):
            self._count(raw.astype(np.int64) if self._signal.length < 64 else raw.view(np.int64))

    def _count(self, raw: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        unique, counts = np.unique(raw, return_counts=True)
        if len(unique) <= _KEPT:
            for number, count in zip(unique.tolist(), counts.tolist(), strict=True):
                if number in self._counts or len(self._counts) < _KEPT:
                    self._counts[number] = self._counts.get(number, 0) + count
        if self._last_number > 0:
            below = raw[raw < self._last_number]
            self._ones += len(raw) - len(below)
            self._largest = max(self._largest, int(below.max(initial=0)))
        if self._last is not None:
            raw = np.concatenate(([self._last], raw))
        reserved = raw > self._highest
        self._samples += len(raw) - (self._last is not None)
        self._reserved += int(np.count_nonzero(reserved[self._last is not None :]))
        turns = reserved[1:] != reserved[:-1]
        self._turns += int(np.count_nonzero(turns))
        self._small_turns += int(
            np.count_nonzero(np.abs(np.diff(raw))[turns] < _STEP * (1 << self._signal.length))
        )
        self._last = int(raw[-1])

    def seen(self) -> list[Label]:
        """Return the numbers that came, commonest first; [] where none of them has a label."""
        if not any(self._number(raw) in self.labels for raw in self._counts):
            return []
        found = sorted(self._counts.items(), key=lambda item: -item[1])
        return [
            Label(self._number(r), self.labels.get(self._number(r), ""), n, self._value(r)) for r, n in found
        ]

    def _number(self, raw: int) -> int:
        width = self._signal.length
        return raw - (1 << width) if self._signal.is_signed and raw >> (width - 1) else raw

    def _value(self, raw: int) -> float | None:
        word = self._used.field.placed(raw & self._used.field.mask)
        if self._used.multiplexer is not None:
            selector, (selected, *_) = self._used.multiplexer
            word |= selector.placed(selected)
        (value,) = self._used.columns(np.array([word], np.uint64))[1].tolist()
        return None if np.isnan(value) else value

    def hints(self) -> list[str]:
        """Return the lines that would read the signal better, one sentence each."""
        found = (self._reserved_hint(), self._last_number_hint(), self._label_hint())
        return [hint for hint in found if hint]

    def _last_number_hint(self) -> str:
        """Return that a field which is taken whole jumps to its last number, as where there is no value."""
        leaps = self._last_number - self._largest > _STEP * self._last_number
        if not (0 < self._ones < self._samples and self._ones >= _SHARE * self._samples and leaps):
            return ""
        return (
            f"signals.{self.role}: {self._ones:,} of {self._samples:,} samples hold raw number "
            f"{self._last_number}, the last one of {self._signal.name}, and none comes near it: if it says "
            "that there is no value, leave validity: full out"
        )

    def _reserved_hint(self) -> str:
        """Return that reserved numbers look like values, on a bus where J1939 reserves none."""
        if self._j1939 or self._reserved < _SHARE * self._samples or self._turns < _TURNS:
            return ""
        width = self._signal.length
        if width >= 8 and 2 * self._small_turns < self._turns:  # values do not jump to the end of a field
            return ""
        high = sorted(raw for raw in self._counts if raw > self._highest)
        good = [raw for raw in high if not means_no_value(self.labels.get(raw, ""))]
        if not good:
            return ""
        shown = ", ".join(
            f"{raw} {self.labels[raw]!r}" if raw in self.labels else str(raw) for raw in good[:4]
        )
        found = (
            f"signals.{self.role}: {self._reserved:,} of {self._samples:,} samples hold a raw number that "
            f"J1939 reserves ({shown}) and count as no value, but {self._signal.name} is no J1939 "
            "signal and they come in turns with values"
        )
        if self.role in TWO_STATE and 0 not in self._counts:
            states = sorted(self._counts, key=lambda raw: -self._counts[raw])[:2]
            map_of = map_line({raw: float(n == 0) for n, raw in enumerate(sorted(states))})
            return f"{found}: if they are states, paste {map_of}, or the other way round"
        if len(good) == len(high):
            return f"{found}: if they are values, paste validity: full"
        entries = {
            raw: self._signal.offset + self._signal.scale * raw
            for raw in sorted(self._counts)
            if raw not in set(high) - set(good)
        }
        return f"{found}: if they are values, paste {map_line(entries)}"

    def _label_hint(self) -> str:
        """Return a map, where the labels of a gear are other numbers than it counts as."""
        if self.role not in ("gear", "selected_gear") or self._source.map or not self.labels:
            return ""
        meant = {
            label.label: number
            for label in self.seen()
            if (number := meaning(self.role, label.label)) is not None
        }
        wrong = [
            label for label in self.seen()
            if label.label in meant and label.value is not None and label.value != meant[label.label]
        ]  # fmt: skip
        if not wrong:
            return ""
        every = {
            text: number for raw, text in self.labels.items() if (number := self._meant(raw)) is not None
        }
        shown = ", ".join(f"{label.value:g} for {label.label!r}" for label in wrong[:3])
        return f"signals.{self.role} reads {shown} of the DBC: to go by its labels, paste {map_line(every)}"

    def _meant(self, raw: int) -> float | None:
        """Return what a labelled number most likely means: what its label says, else what it counts as."""
        label = self.labels[raw]
        number = meaning(self.role, label)
        if number is None and not means_no_value(label):
            return self._value(raw)
        return number


class RawValueCheck:
    """The raw numbers of all signals of a config that have labels or are not J1939."""

    def __init__(self, config: Config) -> None:
        self._signals: dict[str, RawSignal] = {}
        for role, source in config.signals.items():
            if (known := signal_of(config, role)) is None:
                continue
            message, signal = known
            if message.length > FRAME_BYTES or source.validity == "ascii":
                continue
            if not (signal.choices or not is_j1939(message)):
                continue
            self._signals[role] = RawSignal(role, source, message, signal, _used(config, role))

    def push(self, block: FrameBlock) -> None:
        """Take the frames of a block."""
        for signal in self._signals.values():
            signal.push(block)

    def labels(self, role: str) -> list[Label]:
        """Return the labelled numbers of a role that came, [] where its signal has no labels."""
        return self._signals[role].seen() if role in self._signals else []

    def hints(self) -> list[str]:
        """Return which lines of the signal map would read a signal better."""
        return [hint for signal in self._signals.values() for hint in signal.hints()]


def text_hints(config: Config, texts: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return a value table for each column that holds text and has none. texts: column -> text -> cells."""
    hints = []
    for role, source in config.signals.items():
        if source.column is None or source.map or source.column not in texts:
            continue
        found = sorted(texts[source.column].items(), key=lambda item: -item[1])
        shown = ", ".join(f"{text!r} {count:,} times" for text, count in found[:4])
        meant = {text: number for text, _ in found if (number := meaning(role, text)) is not None}
        line = f"paste {map_line(meant)}" if meant else "it needs map: {TEXT: NUMBER, ...}"
        hints.append(f"signals.{role}: column {source.column} holds text ({shown}): {line}")
    return hints


def _used(config: Config, role: str) -> CompiledSignal:
    """Return a role's signal as the config has it decoded."""
    (group,) = build_groups({role: wants_of(config)[role]}, config.databases)
    return group.signals[0].signal


def meaning(role: str, text: str) -> float | None:
    """Return the number that a label or text most likely means to a role, None for one that means none."""
    word = text.strip()
    if role in TWO_STATE:
        return {"on": 1.0, "true": 1.0, "yes": 1.0, "off": 0.0, "false": 0.0, "no": 0.0}.get(word.casefold())
    if role not in ("gear", "selected_gear"):
        return None
    number = gear_of_text(word.upper().encode("ascii", "replace"))
    if not np.isnan(number):
        return float(number)
    if re.match(r"neutral|leerlauf", word, re.IGNORECASE):
        return 0.0
    if re.match(r"r[eü]+(ue)?[vc]", word, re.IGNORECASE):
        return -1.0
    if re.match(r"park", word, re.IGNORECASE):
        return GEAR_PARK
    forward = re.search(r"(?:gear|gang|drive|^d|_|\s)\s*_?(\d{1,2})$", word, re.IGNORECASE)
    ordinal = re.match(r"(\d{1,2})\s*(?:st|nd|rd|th|\.)?[\s_]*(?:gear|gang)", word, re.IGNORECASE)
    match = forward or ordinal
    return float(match[1]) if match else None


def means_no_value(label: str) -> bool:
    """Return whether a label of a DBC says that there is no value."""
    return _NO_VALUE.search(label.casefold()) is not None


def map_line(entries: dict[str, float] | dict[int, float]) -> str:
    """Return a value table as it stands in a signal map entry."""
    return "map: {" + ", ".join(f"{_quoted(key)}: {number:g}" for key, number in entries.items()) + "}"


def _quoted(key: str | int) -> str:
    plain = isinstance(key, int) or (
        re.fullmatch(r"[A-Za-z][\w.-]*", key) and key.casefold() not in ("null", "y", "n")
    )
    return str(key) if plain or key in ("N", "n", "y", "Y") else "'" + str(key).replace("'", "''") + "'"
