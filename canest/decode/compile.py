"""Compiles a DBC signal to shifts and masks over whole columns, and to the same over one frame.

Both forms of a signal do the same float64 operations in the same order (integer to float, times scale,
plus offset), so a column and a single frame give the same bits. cantools is the reference.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import ConfigError
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.decode.validity import first_not_available, gear_of_text, highest_valid

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

    from canest.decode.value_table import TextTable

Words = NDArray[np.uint64]
FRAME_BYTES = 8  #: payload that a `FrameBlock` carries
_NAN = float("nan")
_FLOATS = {32: ("<I", "<f", np.uint32, np.float32), 64: ("<Q", "<d", np.uint64, np.float64)}


class Field(NamedTuple):
    """Where a field lies in a payload of ``size`` bytes that has been read as one integer.

    The integer is little-endian, or big-endian after a byte swap when ``swapped``.
    """

    shift: int
    width: int
    swapped: bool
    size: int

    @property
    def mask(self) -> int:
        """Ones over the width."""
        return (1 << self.width) - 1

    def column(self, words: Words) -> Words:
        """Return the raw bits of a column of payloads (uint64)."""
        if self.swapped:
            words = words.byteswap()
        if self.shift:
            words = words >> np.uint64(self.shift)
        return words if self.width == 64 else words & np.uint64(self.mask)

    def one(self, word: int) -> int:
        """Return the raw bits of one payload, given as its little-endian integer."""
        if self.swapped:
            word = int.from_bytes(word.to_bytes(self.size, "little"), "big")
        return (word >> self.shift) & self.mask

    def placed(self, raw: int) -> int:
        """Return the little-endian integer of a payload that holds nothing but these raw bits."""
        word = raw << self.shift
        return int.from_bytes(word.to_bytes(self.size, "little"), "big") if self.swapped else word


def locate(signal: Signal, size: int) -> tuple[Field, int]:
    """Return the field of a signal in a payload of ``size`` bytes, and how many bytes must be there."""
    if signal.byte_order == "little_endian":
        return Field(signal.start, signal.length, False, size), (signal.start + signal.length + 7) // 8
    # a Motorola start bit names the most significant bit: byte, then bit within it counted from the right
    before = 8 * (signal.start // 8) + 7 - signal.start % 8
    return Field(8 * size - before - signal.length, signal.length, True, size), (
        before + signal.length + 7
    ) // 8


class CompiledSignal:
    """One signal of one message, with its validity rule and the conversion to its role's unit.

    ``scale`` and ``offset`` take raw to the role's unit: raw * scale + offset.
    A value table stands in the place of the DBC's factor and offset: of raw bits (``values``), which then
    decide what is valid too, or of characters (``texts``, rule ``ascii``).
    ``needs`` is the number of payload bytes that must be there.
    """

    def __init__(
        self,
        message: Message,
        signal: Signal,
        *,
        validity: str = "j1939",
        factor: float = 1.0,
        offset: float = 0.0,
        size: int = FRAME_BYTES,
        values: Mapping[int, float] | None = None,
        texts: TextTable | None = None,
    ) -> None:
        where = f"{message.name}.{signal.name}"
        self.name = signal.name
        self.field, self.needs = locate(signal, size)
        self.signed = bool(signal.is_signed)
        self.is_float = bool(signal.is_float)
        self.text = validity == "ascii"
        self.scale = float(signal.scale) * factor
        self.offset = float(signal.offset) * factor + offset
        self._table, self._texts = (dict(values) if values is not None else None), texts
        if values is not None or texts is not None:
            self.scale, self.offset = factor, offset
        if self._table is not None:
            self._raws = np.array(sorted(self._table), np.uint64)
            self._numbers = np.array([self._table[raw] for raw in sorted(self._table)], np.float64)
        width = signal.length
        highest = highest_valid(width, validity, signal.spn, where)
        # indicator ranges are defined for unsigned integers alone
        self.highest = (1 << width) - 1 if self.signed or self.is_float else highest
        self.multiplexer = _multiplexer(message, signal, size)
        if self.is_float and width not in _FLOATS:
            raise ConfigError(
                "float signal of this width", where=where, found=width, expected="32 or 64 bits"
            )
        if self.text and (width % 8 or width > 64 or self.is_float):
            raise ConfigError(
                "ascii signal", where=where, found=f"{width} bits", expected="whole bytes, at most 8"
            )
        self._gears: dict[int, float] = {}
        self.one = self._scalar()

    def columns(self, words: Words) -> tuple[IntColumn | None, FloatColumn, BoolColumn | None, Words]:
        """Decode a column of payloads.

        Return the rows that carry the signal (None: all), their values (NaN where not valid), which of
        them are not valid (None: none) and their raw bits.
        """
        rows: IntColumn | None = None
        if self.multiplexer is not None:
            selector, ids = self.multiplexer
            raw_ids = selector.column(words)
            hit = (
                raw_ids == np.uint64(ids[0]) if len(ids) == 1 else np.isin(raw_ids, np.array(ids, np.uint64))
            )
            rows = np.flatnonzero(hit)
            words = words[rows]
        raw = self.field.column(words)
        if self.text:
            unique, inverse = np.unique(raw, return_inverse=True)
            values = np.array([self._gear(r) for r in unique.tolist()], np.float64)[inverse]
        elif self._table is not None:
            at = np.minimum(np.searchsorted(self._raws, raw), len(self._raws) - 1)
            values = np.where(self._raws[at] == raw, self._numbers[at], _NAN)
        elif self.is_float:
            _, _, as_int, as_float = _FLOATS[self.field.width]
            with np.errstate(all="ignore"):  # a payload may be any float, signalling NaN included
                values = raw.astype(as_int).view(as_float).astype(np.float64) * self.scale + self.offset
        elif self.signed:
            spare = np.int64(64 - self.field.width)
            values = ((raw << spare.astype(np.uint64)).view(np.int64) >> spare).astype(np.float64)
        else:
            values = raw.astype(np.float64)
        if not self.is_float:
            values *= self.scale
            values += self.offset
        if self.text or self.is_float or self._table is not None:
            bad: BoolColumn = ~np.isfinite(values)
        elif self.highest < self.field.mask:
            bad = raw > np.uint64(self.highest)
        else:
            return rows, values, None, raw
        if not bad.any():
            return rows, values, None, raw
        values[bad] = _NAN
        return rows, values, bad, raw

    def raw(self, word: int) -> int:
        """Return the raw bits of one payload, given as its little-endian integer."""
        return self.field.one(word)

    @property
    def first_not_available(self) -> int:
        """Lowest raw value that means "not available" (invalid values below it mean "error")."""
        return first_not_available(self.field.width)

    def _gear(self, raw: int) -> float:
        value = self._gears.get(raw)
        if value is None:
            order = "big" if self.field.swapped else "little"
            text = raw.to_bytes(self.field.width // 8, order)  # type: ignore[arg-type]
            if self._texts is not None:
                value = self._texts.number(text.strip(b" \0").decode("latin-1"))
            else:
                value = gear_of_text(text)
            if len(self._gears) < 1024:  # two characters make few words; a broken sender makes many
                self._gears[raw] = value
        return value

    def _scalar(self) -> Callable[[int], float | None]:
        """Return the decoder of one payload: its value, NaN when not valid, None when not in this frame."""
        field, scale, offset, highest = self.field, self.scale, self.offset, self.highest
        shift, mask, width = field.shift, field.mask, field.width
        table = self._table

        def value(word: int) -> float:
            raw = field.one(word)
            if self.text:
                return self._gear(raw) * scale + offset
            if table is not None:
                return table.get(raw, _NAN) * scale + offset
            if self.is_float:
                as_int, as_float, *_ = _FLOATS[width]
                number = struct.unpack(as_float, struct.pack(as_int, raw))[0] * scale + offset
                return number if abs(number) < float("inf") else _NAN
            if raw > highest:
                return _NAN
            if self.signed and raw >> (width - 1):
                raw -= 1 << width
            return raw * scale + offset

        def plain(word: int) -> float:
            raw = (word >> shift) & mask
            return raw * scale + offset if raw <= highest else _NAN

        odd = self.text or self.is_float or self.signed or field.swapped or table is not None
        decode = value if odd else plain
        if self.multiplexer is None:
            return decode
        selector, ids = self.multiplexer
        known = frozenset(ids)
        return lambda word: decode(word) if selector.one(word) in known else None


def _multiplexer(message: Message, signal: Signal, size: int) -> tuple[Field, list[int]] | None:
    """Return the field that selects a multiplexed signal and its values for it, None for a plain signal."""
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return None
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    if selector.multiplexer_ids:
        raise ConfigError(
            "multiplexed more than one level deep",
            where=f"{message.name}.{signal.name}",
            expected="one level",
        )
    return locate(selector, size)[0], sorted(signal.multiplexer_ids)


def known_selectors(message: Message) -> tuple[Field, frozenset[int]] | None:
    """Return the multiplexor field of a message and every value the DBC knows, None without one."""
    selectors = [s for s in message.signals if s.is_multiplexer and not s.multiplexer_ids]
    if len(selectors) != 1:
        return None
    known = {
        i
        for s in message.signals
        if s.multiplexer_signal == selectors[0].name
        for i in s.multiplexer_ids or ()
    }
    return locate(selectors[0], FRAME_BYTES)[0], frozenset(known)
