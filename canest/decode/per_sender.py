"""Decodes roles for every source address by itself, where no address owns a role."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import EXTENDED, FloatColumn, FrameBlock, IntColumn
from canest.decode import j1939
from canest.decode.decoder import Decoder
from canest.decode.groups import Want

if TYPE_CHECKING:
    from cantools.database.can import Database

Samples = dict[str, tuple[IntColumn, FloatColumn]]


class PerSender:
    """One decoder for each source address.

    wants: role -> Want; a source that it names is kept. databases: as of `Decoder`. Errors: ConfigError.
    """

    def __init__(self, wants: Mapping[str, Want], databases: Sequence[Database]) -> None:
        self._wants, self._databases = dict(wants), databases
        anyone = {role: want._replace(source=None) for role, want in wants.items()}
        self._selector = Decoder(anyone, databases)
        self._pgns = np.array(self._selector.pgns, np.uint32)
        self._decoders: dict[int | None, Decoder] = {}

    def push(self, block: FrameBlock) -> dict[int | None, Samples]:
        """Return the samples of the next frames: address (None: no J1939 message) -> role -> samples."""
        selected = self._selector.select(block)
        if not len(selected):
            return {}
        ids = selected.can_id
        pgns = np.array([j1939.pgn_of(can_id) for can_id in ids.tolist()], np.uint32)
        addressed = ((ids & np.uint32(EXTENDED)) != 0) & np.isin(pgns, self._pgns)
        senders = np.where(addressed, (ids & np.uint32(0xFF)).astype(np.int64), -1)
        found: dict[int | None, Samples] = {}
        for number in np.unique(senders).tolist():
            address = None if number < 0 else number
            samples = self._decoder(address).push(selected[np.flatnonzero(senders == number)]).samples
            if samples:
                found[address] = dict(samples)
        return found

    def _decoder(self, address: int | None) -> Decoder:
        decoder = self._decoders.get(address)
        if decoder is None:
            decoder = self._decoders[address] = Decoder(self._wants, self._databases)
        return decoder
