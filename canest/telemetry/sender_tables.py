"""Senders as rows and keys of the snapshot, so that noise from every address does not make it long."""

from __future__ import annotations

from typing import Any

from canest.decode.counters import Counters
from canest.telemetry.sender_rates import Key

#: most senders listed
MOST_SENDERS, MOST_OTHERS = 100, 20


def used_senders(counters: Counters) -> dict[str, dict[str, Any]]:
    """Return what was received from each sender that the config uses, at most `MOST_SENDERS`."""
    senders: dict[str, dict[str, Any]] = {}
    for key, counted in sorted(counters.senders.items(), key=_by_id):
        if counted.used and len(senders) < MOST_SENDERS:
            senders[sender_key(key)] = {
                "frames": counted.frames,
                "rate_hz": None if counted.rate_Hz is None else round(counted.rate_Hz, 1),
                "not_available": counted.not_available,
                "error_values": counted.error_value,
                "wrong_length": counted.wrong_length,
                "unknown_mux": counted.unknown_mux,
                "remote_frames": counted.remote_frames,
                "transport_errors": counted.transport_errors,
            }
    return senders


def busiest_others(senders: dict[Key, int]) -> dict[str, int]:
    """Return the frames of the `MOST_OTHERS` busiest of the senders, in the order of their identifiers."""
    busiest = sorted(senders.items(), key=lambda item: -item[1])[:MOST_OTHERS]
    return {sender_key(key): frames for key, frames in sorted(busiest, key=_by_id)}


def contested_signals(counters: Counters) -> dict[str, dict[str, int]]:
    """Return, per role that several addresses send, the refused samples of the `MOST_OTHERS` busiest."""
    return {
        role: {address(a): n for a, n in sorted(refused.items(), key=_by_count)[:MOST_OTHERS]}
        for role, refused in counters.contested().items()
    }


def sender_name(key: Key) -> str:
    """Return a sender's name: its group (or identifier) and address."""
    group, source = key
    return f"0x{group & 0x1FFF_FFFF:X}" if source is None else f"PGN {group} from {address(source)}"


def sender_key(key: Key) -> str:
    """Return a sender as a key without spaces, as programs and log lines need it: pgn_61444_from_0x00."""
    return sender_name(key).replace("PGN ", "pgn_").replace(" ", "_")


def address(source: int | None) -> str:
    """Return a source address in hexadecimal."""
    return "unknown" if source is None else f"0x{source:02X}"


def _by_id(item: tuple[Key, Any]) -> tuple[int, int]:
    (group, source), _ = item
    return group, -1 if source is None else source


def _by_count(item: tuple[int | None, int]) -> int:
    return -item[1]
