"""Frames to samples: DBC signals compiled to shifts and masks, J1939 matching, multi-packet reassembly."""

from __future__ import annotations

from canest.decode.decoder import Decoder
from canest.decode.groups import Want

__all__ = ["Decoder", "Want"]
