"""The channel groups of an MF4 file that log a CAN bus (ASAM MDF bus logging), and their fields."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from canest.logs.mf4_blocks import Block, Mf4File, UnsupportedMf4Error

_HEADER_ADDRESS = 64
_CHANNELS_MAX = 10_000
_BUS_EVENT = 2  #: flag of a channel group
_SOURCE_BUS, _BUS_CAN = 2, 2
_FIXED, _VARIABLE_LENGTH, _MASTER, _VIRTUAL = 0, 1, 2, 6  #: kinds of channels
_TIME = 1  #: what a master channel counts
_UNSIGNED, _FLOAT, _BYTES = 0, 4, 10  #: types of values, little-endian
_LINEAR, _TABLE = 1, 5  #: conversions; a table without interpolation
_RECORD_FLAG_VARIABLE = 1  #: of a channel group whose records have a length of their own
#: unfinished recordings: what a logger that lost power has not written (ASAM MDF 4.1, 5.3)
COUNTS_MISSING, LENGTH_MISSING, VARIABLE_BYTES_MISSING = 1, 4, 32
KINDS = ("CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame")
_NEEDED: dict[str, set[str]] = {
    KINDS[0]: {"ID", "DataLength", "DataBytes"},
    KINDS[1]: set(),
    KINDS[2]: {"ID", "DLC"},
}


@dataclass(frozen=True, slots=True)
class Field:
    """A number in every record, or the same in all.

    byte, bit, bits: where it stands. conversion: kind and parameters. constant: instead of all this.
    """

    byte: int
    bit: int
    bits: int
    is_float: bool
    conversion: tuple[int, tuple[float, ...]] | None
    constant: float | None = None
    data_address: int = 0  #: of bytes that stand elsewhere; the number is their place there

    def values(self, records: NDArray[np.uint8]) -> NDArray[np.float64] | NDArray[np.uint64]:
        """Return the numbers of records uint8 (n, size). Errors: UnsupportedMf4Error."""
        if self.constant is not None:
            return np.full(len(records), self.constant)
        raw = self._raw(records)
        if self.conversion is None:
            return raw
        kind, parameters = self.conversion
        if kind == _LINEAR:
            b, a = parameters
            scaled: NDArray[np.float64] = raw * np.float64(a)
            return scaled + np.float64(b) if b else scaled
        keys, values = np.array(parameters[0::2]), np.array(parameters[1::2])
        at = np.minimum(np.searchsorted(keys, raw), len(keys) - 1)
        if (keys[at] != raw).any():
            raise UnsupportedMf4Error("a value that its table does not have")
        return values[at]

    def _raw(self, records: NDArray[np.uint8]) -> NDArray[np.float64] | NDArray[np.uint64]:
        count = (self.bit + self.bits + 7) // 8
        column = np.zeros((len(records), 8), np.uint8)
        column[:, :count] = records[:, self.byte : self.byte + count]
        if self.is_float:
            if self.bits == 32:
                return column[:, :4].copy().view("<f4")[:, 0].astype(np.float64)
            return column.view("<f8")[:, 0]
        words: NDArray[np.uint64] = column.view("<u8")[:, 0]
        if self.bit:
            words >>= np.uint64(self.bit)
        if self.bits < 64:
            words &= np.uint64((1 << self.bits) - 1)
        return words


@dataclass(frozen=True, slots=True)
class Group:
    """A channel group: what one kind of record looks like.

    fields: of a bus-logging group, by name without that of the group; empty for what is passed over.
    """

    kind: str
    record_id: int
    cycles: int
    record_bytes: int
    variable_length: bool
    fields: dict[str, Field]


@dataclass(frozen=True, slots=True)
class DataGroup:
    """Channel groups that share a stream of records.

    record_id_bytes: in front of each record where the groups' records are mixed, else 0.
    """

    data_address: int
    record_id_bytes: int
    groups: tuple[Group, ...]


def start_s(file: Mf4File) -> float:
    """Return when the recording began, in seconds since 1970. A local time without its zone counts as UTC."""
    (nanoseconds,) = struct.unpack_from("<Q", file.block(_HEADER_ADDRESS, b"HD").data)
    return datetime.fromtimestamp(nanoseconds / 10**9, UTC).timestamp()  # to the microsecond


def data_groups(file: Mf4File) -> Iterator[DataGroup]:
    """Yield the data groups of a file. Errors: UnsupportedMf4Error."""
    for block in file.chain(file.block(_HEADER_ADDRESS, b"HD").link(0), b"DG"):
        groups = tuple(_group(file, group) for group in file.chain(block.link(1), b"CG"))
        record_id_bytes = block.data[0]
        if record_id_bytes not in (0, 1, 2, 4, 8) or (not record_id_bytes and len(groups) > 1):
            raise UnsupportedMf4Error(f"record identifiers of {record_id_bytes} bytes")
        yield DataGroup(block.link(2), record_id_bytes, groups)


def _group(file: Mf4File, block: Block) -> Group:
    record_id, cycles, flags, data_bytes, invalid_bytes = struct.unpack_from("<QQH6xII", block.data)
    kind, fields = "", {}
    if flags & _BUS_EVENT and block.link(3):
        source = file.block(block.link(3), b"SI").data
        if source[0] & _SOURCE_BUS and source[1] == _BUS_CAN:
            channels = {file.text(channel.link(2)): channel for channel in _channels(file, block.link(1))}
            kind = next((name for name in KINDS if name in channels), "")
            if kind:
                if invalid_bytes:
                    raise UnsupportedMf4Error("values that may be invalid")
                fields = _fields(file, kind, channels, data_bytes)
    size = data_bytes + invalid_bytes
    return Group(kind, record_id, cycles, size, bool(flags & _RECORD_FLAG_VARIABLE), fields)


def _channels(file: Mf4File, address: int) -> list[Block]:
    """Return all channels of a group, also those within others."""
    found: list[Block] = []
    waiting = [address]
    while waiting:
        for channel in file.chain(waiting.pop(), b"CN"):
            found.append(channel)
            if len(found) > _CHANNELS_MAX:
                raise UnsupportedMf4Error("channels without end")
            if channel.link(1):
                waiting.append(channel.link(1))
    return found


def _fields(file: Mf4File, kind: str, channels: dict[str, Block], record_bytes: int) -> dict[str, Field]:
    masters = [c for c in channels.values() if c.data[0] == _MASTER and c.data[1] == _TIME]
    if len(masters) != 1:
        raise UnsupportedMf4Error("a group without one column of time")
    fields = {"Time": _field(file, masters[0], record_bytes)}
    for name in ("BusChannel", "ID", "IDE", "DLC", "DataLength", "DataBytes", "RTR"):
        channel = channels.get(f"{kind}.{name}")
        if channel is not None:
            fields[name] = _field(file, channel, record_bytes, name == "DataBytes")
    missing = _NEEDED[kind] - fields.keys()
    if missing:
        raise UnsupportedMf4Error(f"frames without {', '.join(sorted(missing))}")
    return fields


def _field(file: Mf4File, channel: Block, record_bytes: int, is_payload: bool = False) -> Field:
    kind, _, data_type, bit, byte, bits = struct.unpack_from("<BBBBII", channel.data)
    conversion = _conversion(file, channel.link(4))
    if kind == _VIRTUAL and conversion is not None and conversion[0] == _LINEAR and not conversion[1][1]:
        return Field(0, 0, 0, False, None, constant=conversion[1][0])
    variable = is_payload and kind == _VARIABLE_LENGTH
    if kind not in (_FIXED, _MASTER) and not variable:
        raise UnsupportedMf4Error(f"a channel of kind {kind}")
    if byte + (bit + bits + 7) // 8 > record_bytes:
        raise UnsupportedMf4Error("a field beyond its record")
    if is_payload:
        if data_type != _BYTES or bit or bits % 8 or conversion is not None or (variable and bits > 64):
            raise UnsupportedMf4Error("data bytes of another type")
        return Field(byte, 0, bits, False, None, data_address=channel.link(5) if variable else 0)
    if data_type not in (_UNSIGNED, _FLOAT) or not bits or bit + bits > 64:
        raise UnsupportedMf4Error(f"a number of type {data_type}")
    if data_type == _FLOAT and (bit or bits not in (32, 64)):
        raise UnsupportedMf4Error(f"a float of {bits} bits")
    return Field(byte, bit, bits, data_type == _FLOAT, conversion)


def _conversion(file: Mf4File, address: int) -> tuple[int, tuple[float, ...]] | None:
    if not address:
        return None
    block = file.block(address, b"CC")
    kind, count = struct.unpack_from("<B5xH", block.data)
    values = struct.unpack_from(f"<{count}d", block.data, 24)
    if kind == 0 or (kind == _LINEAR and values == (0.0, 1.0)):
        return None
    if kind == _LINEAR and count == 2:
        return kind, values
    if kind == _TABLE and count and not count % 2 and list(values[0::2]) == sorted(values[0::2]):
        return kind, values
    raise UnsupportedMf4Error(f"a conversion of kind {kind}")
