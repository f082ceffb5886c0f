"""Objects of a BLF log, unpacked, to frames: all of a stretch at once (layouts as in python-can's reader)."""

from __future__ import annotations

import struct
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, BoolColumn, FloatColumn, IntColumn
from canest.logs.frame_columns import FrameColumns, payload_words

_CAN_MESSAGE, _CAN_MESSAGE2, _CAN_ERROR_EXT, _CAN_FD_MESSAGE, _CAN_FD_MESSAGE_64 = 1, 86, 73, 100, 101
#: what must be there of an object's body
_BODY_BYTES = {
    _CAN_MESSAGE: 16,
    _CAN_MESSAGE2: 16,
    _CAN_ERROR_EXT: 32,
    _CAN_FD_MESSAGE: 84,
    _CAN_FD_MESSAGE_64: 40,
}
_SIGNATURE = b"LOBJ"
_SIGNATURE_WORD = int.from_bytes(_SIGNATURE, "little")
_BASE = struct.Struct("<4sHHLL")
_STAMP_AT, _BODY_AT = 24, {1: 32, 2: 40}  #: by version of the header
#: between objects stand at most so many bytes
_PADDING_MAX = 4
_TEN_MICROSECONDS = 1  #: flag of an object; its stamp else counts nanoseconds
_EXACT = 1 << 53
_REMOTE_FLAG, _REMOTE_FLAG_64 = 0x80, 0x10
_FD_LENGTHS = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64, *[64] * 240], np.int64)


class OddBlfError(Exception):
    """An object that is not as usual: python-can decides what it is."""


class _Bytes:
    """Numbers at any place of a stretch of bytes."""

    def __init__(self, data: bytes) -> None:
        self._chars = np.frombuffer(data + bytes(8), np.uint8)

    def u8(self, at: IntColumn) -> IntColumn:
        return self._chars[at].astype(np.int64)

    def u16(self, at: IntColumn) -> IntColumn:
        return self._at("<u2", at).astype(np.int64)

    def u32(self, at: IntColumn) -> NDArray[np.uint32]:
        return self._at("<u4", at).astype(np.uint32)

    def u64(self, at: IntColumn) -> NDArray[np.uint64]:
        return self._at("<u8", at).astype(np.uint64)

    def _at(self, kind: str, at: IntColumn) -> NDArray[np.generic]:
        size = np.dtype(kind).itemsize
        return np.ndarray(len(self._chars) - size + 1, kind, self._chars, strides=(1,))[at]


def parse(data: bytes, start_s: float) -> tuple[FrameColumns, int]:
    """Return the frames of all whole objects, and where the first one begins that is not whole.

    start_s: when the measurement began, seconds since 1970. Errors: OddBlfError.
    """
    begins, sizes, consumed = _objects(data)
    read = _Bytes(data)
    versions, kinds = read.u16(begins + 6), read.u32(begins + 12)
    body = begins + np.where(versions == 1, _BODY_AT[1], _BODY_AT[2])
    known = (versions == 1) | (versions == 2)
    can_id, length = np.zeros(len(begins), np.uint32), np.zeros(len(begins), np.int64)
    words, channel = np.zeros(len(begins), np.uint64), np.zeros(len(begins), np.int64)
    is_frame = np.zeros(len(begins), np.bool_)
    for kind in np.unique(kinds).tolist():
        if kind not in _BODY_BYTES:
            continue
        rows = np.flatnonzero((kinds == kind) & known)
        at = body[rows]
        if len(at) and at[-1] + _BODY_BYTES[kind] > len(data):
            raise OddBlfError
        is_frame[rows] = True
        can_id[rows], length[rows], words[rows], channel[rows] = _FRAMES[kind](
            read, at, begins[rows], sizes[rows]
        )
    rows = np.flatnonzero(is_frame)
    t_s = _seconds(read.u64(begins[rows] + _STAMP_AT), read.u32(begins[rows] + 16)) + start_s
    return FrameColumns(t_s, can_id[rows], length[rows], words[rows], channel[rows] - 1), consumed


def _objects(data: bytes) -> tuple[IntColumn, IntColumn, int]:
    """Return where the whole objects begin, their sizes, and where the first one begins that is not whole."""
    begins = 4 * np.flatnonzero(np.frombuffer(data, "<u4", len(data) // 4) == _SIGNATURE_WORD)
    begins = begins[begins + _BASE.size <= len(data)]
    sizes = _Bytes(data).u32(begins + 8).astype(np.int64)
    ends = begins + sizes
    gaps = begins[1:] - ends[:-1]
    if not len(begins) or begins[0] > _PADDING_MAX or ((gaps < 0) | (gaps > _PADDING_MAX)).any():
        return _objects_one_by_one(data)  # signatures elsewhere, or among the data
    if (sizes < _BASE.size).any():
        raise OddBlfError
    last = int(ends[-1])
    if last > len(data):
        return begins[:-1], sizes[:-1], int(ends[-2]) if len(ends) > 1 else 0
    following = data.find(_SIGNATURE, last, last + 2 * _PADDING_MAX)
    if 0 <= following <= len(data) - _BASE.size:  # off the boundaries of words
        return _objects_one_by_one(data)
    _require_end(data, last)
    return begins, sizes, last


def _objects_one_by_one(data: bytes) -> tuple[IntColumn, IntColumn, int]:
    begins, sizes, end = [], [], 0
    while True:
        begin = data.find(_SIGNATURE, end, end + 2 * _PADDING_MAX)
        if begin < 0:
            _require_end(data, end)
            break
        if begin + _BASE.size > len(data):
            break
        size = int.from_bytes(data[begin + 8 : begin + 12], "little")
        if size < _BASE.size:
            raise OddBlfError
        if begin + size > len(data):
            break
        begins.append(begin)
        sizes.append(size)
        end = begin + size
    return np.array(begins, np.int64), np.array(sizes, np.int64), end


def _require_end(data: bytes, end: int) -> None:
    """Require that behind the last object there is no room for another. Errors: OddBlfError."""
    if end + 2 * _PADDING_MAX <= len(data) and data.find(_SIGNATURE, end, end + 2 * _PADDING_MAX) < 0:
        raise OddBlfError


def _seconds(stamps: NDArray[np.uint64], flags: NDArray[np.uint32]) -> FloatColumn:
    coarse = flags == _TEN_MICROSECONDS
    seconds = stamps / np.where(coarse, 1e5, 1e9)
    for row in np.flatnonzero(stamps >= _EXACT).tolist():  # beyond what a float64 counts exactly
        factor = Decimal("1e-5") if coarse[row] else Decimal("1e-9")
        seconds[row] = float(Decimal(int(stamps[row])) * factor)
    return seconds


_Frames = tuple[NDArray[np.uint32], IntColumn, NDArray[np.uint64], IntColumn]


def _identifiers(numbers: NDArray[np.uint32], remote: BoolColumn) -> NDArray[np.uint32]:
    """Return identifiers with our flags: bit 31 stands for 29 bits in both."""
    can_id: NDArray[np.uint32] = numbers & np.uint32(EXTENDED | ID_MASK)
    return can_id | remote * np.uint32(REMOTE)


def _classic(read: _Bytes, at: IntColumn, begins: IntColumn, sizes: IntColumn) -> _Frames:
    remote = (read.u8(at + 2) & _REMOTE_FLAG) != 0
    announced = read.u8(at + 3)
    length = np.minimum(announced, 8)
    words = payload_words(read.u64(at + 8), np.where(remote, 0, length))
    can_id = _identifiers(read.u32(at + 4), remote)
    return can_id, np.where(remote, announced, length), words, read.u16(at)


def _error(read: _Bytes, at: IntColumn, begins: IntColumn, sizes: IntColumn) -> _Frames:
    length = np.minimum(read.u8(at + 10), 8)
    can_id = (read.u32(at + 16) & np.uint32(ID_MASK)) | np.uint32(ERROR)
    return can_id, length, payload_words(read.u64(at + 24), length), read.u16(at)


def _long(read: _Bytes, at: IntColumn, begins: IntColumn, sizes: IntColumn) -> _Frames:
    remote = (read.u8(at + 2) & _REMOTE_FLAG) != 0
    length = np.minimum(read.u8(at + 14), 64)
    words = payload_words(read.u64(at + 20), np.where(remote, 0, length))
    length = np.where(remote, _FD_LENGTHS[read.u8(at + 3)], length)
    return _identifiers(read.u32(at + 4), remote), length, words, read.u16(at)


def _long64(read: _Bytes, at: IntColumn, begins: IntColumn, sizes: IntColumn) -> _Frames:
    remote = (read.u32(at + 12) & _REMOTE_FLAG_64) != 0
    announced, extension = read.u8(at + 2), read.u8(at + 35)
    # of more bytes than there are, those that are missing are zero
    end = np.where(extension == 0, sizes, extension)
    there = np.clip(end - read.u16(begins + 4) - 40, 0, announced)
    words = payload_words(read.u64(at + 40), np.where(remote, 0, there))
    length = np.where(remote, _FD_LENGTHS[read.u8(at + 1)], announced)
    return _identifiers(read.u32(at + 4), remote), length, words, read.u8(at)


_FRAMES = {
    _CAN_MESSAGE: _classic,
    _CAN_MESSAGE2: _classic,
    _CAN_ERROR_EXT: _error,
    _CAN_FD_MESSAGE: _long,
    _CAN_FD_MESSAGE_64: _long64,
}
