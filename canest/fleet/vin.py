"""The vehicle identification number that a log itself carries (PGN 65260, SPN 237)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import ERROR, EXTENDED, REMOTE, BoolColumn, FrameBlock
from canest.decode.j1939 import (
    PGN_MASK,
    TP_CM_PGN,
    TP_DT_PGN,
    destination_of,
    source_of,
)
from canest.decode.transport_protocol import Transport
from canest.logs.format_detection import open_log

VIN_PGN = 65260
_ENGINE_ADDRESS = 0
#: J1939 allows other numbers than those of ISO 3779; they end with an asterisk
_NUMBER = re.compile(rb"[A-Za-z0-9-]{5,200}")


class VinReader:
    """Finds the numbers in a stream of frames. found: source address -> the number that it sent last."""

    def __init__(self) -> None:
        self.found: dict[int, str] = {}
        self._transport = Transport(lambda pgn, source: pgn == VIN_PGN, lambda pgn, source: None)

    def add(self, block: FrameBlock) -> None:
        """Take the next frames, in order of arrival."""
        can_id = block.can_id
        managing = _in_group(can_id, TP_CM_PGN)
        # packets matter only where a session is open or opens here
        if not self._transport.open_sessions and not (managing & _names_vin(block)).any():
            return
        for at in np.flatnonzero(managing | _in_group(can_id, TP_DT_PGN)).tolist():
            identifier, word = int(can_id[at]), int(block.data[at])
            frame = (
                int(block.t_us[at]), source_of(identifier), destination_of(identifier), int(block.length[at]),
            )  # fmt: skip
            if managing[at]:
                self._transport.manage(*frame, word)
                continue
            done = self._transport.packet(*frame, word)
            if done is not None:
                self._note(frame[1], done[1])

    @property
    def vin(self) -> str:
        """Return the engine's number, else the only one there is; '' where none or several are left."""
        if _ENGINE_ADDRESS in self.found:
            return self.found[_ENGINE_ADDRESS]
        numbers = set(self.found.values())
        return numbers.pop() if len(numbers) == 1 else ""

    def _note(self, source: int, payload: bytes) -> None:
        number = payload.partition(b"*")[0].strip(b" \0\xff")
        if _NUMBER.fullmatch(number):
            self.found[source] = number.decode("ascii").upper()


def vin_of(log: Path) -> VinReader:
    """Read a log to its end and return what VINs it carries; a table of signals has none.

    Errors: LogError.
    """
    reader = VinReader()
    with open_log(log, wanted=_is_transport, columns=()) as blocks:
        if blocks.kind != "frames":
            return reader
        for block in blocks:
            assert isinstance(block, FrameBlock)
            reader.add(block)
    return reader


def _in_group(can_id: NDArray[np.uint32], pgn: int) -> BoolColumn:
    """Return which identifiers (n,) are data frames of a destination-specific group."""
    whole = (can_id & np.uint32(EXTENDED | REMOTE | ERROR)) == EXTENDED
    return np.asarray(whole & ((can_id >> np.uint32(8)) & np.uint32(PGN_MASK & ~0xFF) == pgn))


def _is_transport(can_id: NDArray[np.uint32]) -> BoolColumn:
    return _in_group(can_id, TP_CM_PGN) | _in_group(can_id, TP_DT_PGN)


def _names_vin(block: FrameBlock) -> BoolColumn:
    return np.asarray(block.data >> np.uint64(40) == VIN_PGN)
