"""J1939 identifiers: what sender, parameter group and destination a 29-bit identifier names.

An identifier is priority (3 bits), extended data page and data page (2), PDU format (8), PDU specific (8)
and source address (8). Below PDU format 240 the PDU specific byte is a destination, above it belongs to
the parameter group (SAE J1939-21).
"""

from __future__ import annotations

from canest.core.frames import EXTENDED, REMOTE

GLOBAL_ADDRESS = 0xFF  #: destination of a broadcast
PGN_BITS = 18
PGN_MASK = (1 << PGN_BITS) - 1
FIRST_PDU2_FORMAT = 240  #: PDU formats from here on have no destination

TP_CM_PGN = 0xEC00  #: transport protocol, connection management
TP_DT_PGN = 0xEB00  #: transport protocol, data transfer


def is_destination_specific(pgn: int) -> bool:
    """Return True for a PDU1 group, whose identifier carries a destination instead of a low PGN byte."""
    return (pgn >> 8) & 0xFF < FIRST_PDU2_FORMAT


def pgn_of(can_id: int) -> int:
    """Return the parameter group number (18 bits) of an identifier; flags and priority are ignored."""
    pgn = (can_id >> 8) & PGN_MASK
    return pgn & ~0xFF if is_destination_specific(pgn) else pgn


def source_of(can_id: int) -> int:
    """Return the source address of an identifier."""
    return can_id & 0xFF


def destination_of(can_id: int) -> int:
    """Return the destination address; `GLOBAL_ADDRESS` for groups that have none."""
    return (can_id >> 8) & 0xFF if is_destination_specific((can_id >> 8) & PGN_MASK) else GLOBAL_ADDRESS


def pack(pgn: int, source: int, priority: int = 6, destination: int = GLOBAL_ADDRESS) -> int:
    """Return the identifier, with the `EXTENDED` flag, of a parameter group from an address."""
    low = (destination & 0xFF) << 8 if is_destination_specific(pgn) else 0
    return EXTENDED | (priority & 7) << 26 | (pgn & PGN_MASK) << 8 | low | source & 0xFF


def kernel_filter(pgn: int) -> tuple[int, int]:
    """Return (id, mask) that passes the data frames of a group: any priority, source and destination."""
    ignored = 0xFFFF if is_destination_specific(pgn) else 0xFF
    mask = (PGN_MASK << 8) & ~ignored
    return EXTENDED | (pgn << 8) & mask, EXTENDED | REMOTE | mask
