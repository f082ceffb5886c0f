"""Plays a recorded log onto a bus, in the log's own rhythm or a multiple of it."""

from __future__ import annotations

import time
from collections.abc import Callable

from canest.bus.link import require_interface
from canest.config.bus import Bus
from canest.core.errors import BusError, LogError, UsageError
from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.logs.candump_line import CLASSIC_BYTES
from canest.logs.reader import open_log

#: how long a full transmit buffer may hold up a frame before it is dropped
SEND_TIMEOUT_S = 0.1
#: frames this close are sent without sleeping between them
_SHORT_S = 0.0005
#: a clock that goes back further was set: the rhythm begins anew, where else all that follows would be late
_SET_BACK_US = 500_000
#: a longer pause is cut to this: the clock was set forward, or nothing was recorded
_PAUSE_US = 60_000_000
#: frames read at once
_BLOCK_FRAMES = 1 << 12


def play(
    log: str,
    bus: str,
    speed: float = 1.0,
    *,
    channel: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> str:
    """Send every frame of a log onto ``bus`` ("interface:channel"), ``speed`` times real time.

    A pause of more than a minute is cut to one. A frame that the interface does not take in time is dropped
    and counted. Error frames are not sent, nor are CAN FD frames beyond eight bytes, of which a block holds
    the first eight only.
    Returns one sentence that says how many went out. Errors: UsageError, ConfigError (an unknown
    interface), BusError, LogError.
    """
    interface, colon, name = bus.partition(":")
    if not colon or not interface or not name:
        raise UsageError("malformed --to", found=bus, expected="INTERFACE:CHANNEL, e.g. socketcan:vcan0")
    require_interface(Bus(interface=interface, channel=name), lambda _: bus)
    reader = open_log(log, channel=channel, block_frames=_BLOCK_FRAMES)
    if reader.kind == "table":
        raise LogError("holds decoded signals, no frames: it cannot be played onto a bus", where=log)
    import can

    from canest.bus.drivers import driver_of

    try:
        out = can.Bus(interface=interface, channel=name)
    except Exception as error:  # each of python-can's interfaces has exceptions of its own
        raise BusError(
            f"cannot be opened ({' '.join(str(error).split())})",
            where=bus,
            expected=driver_of(interface)
            if "not installed" in str(error)
            else "an interface that is up (ip link), or another one, e.g. udp_multicast:239.74.163.2",
        ) from None
    sent = dropped = long = pauses = left_out_us = 0
    started = begin = time.monotonic()
    first_us: int | None = None
    last_us = 0
    try:
        for block in reader:
            assert isinstance(block, FrameBlock)
            for t_us, can_id, length, word in zip(
                block.t_us.tolist(),
                block.can_id.tolist(),
                block.length.tolist(),
                block.data.tolist(),
                strict=True,
            ):
                if can_id & ERROR:
                    continue
                if length > CLASSIC_BYTES and not can_id & REMOTE:
                    long += 1
                    continue
                if first_us is None or t_us < last_us - _SET_BACK_US:
                    begin, first_us = time.monotonic(), t_us
                elif t_us - last_us > _PAUSE_US:
                    beyond_us = t_us - last_us - _PAUSE_US
                    first_us += beyond_us
                    left_out_us += beyond_us
                    pauses += 1
                last_us = t_us
                wait_s = begin + (t_us - first_us) * 1e-6 / speed - time.monotonic()
                if wait_s > _SHORT_S:
                    time.sleep(wait_s)
                message = can.Message(
                    arbitration_id=can_id & ID_MASK,
                    is_extended_id=bool(can_id & EXTENDED),
                    is_remote_frame=bool(can_id & REMOTE),
                    dlc=length,
                    data=None if can_id & REMOTE else word.to_bytes(8, "little")[:length],
                )
                try:
                    out.send(message, timeout=SEND_TIMEOUT_S)
                    sent += 1
                except (can.CanError, ValueError):
                    dropped += 1
            if progress is not None:
                progress(reader.bytes_done, reader.bytes_total)
    finally:
        out.shutdown()
    lost = f", {dropped:,} dropped (the interface did not take them)" if dropped else ""
    if long:
        lost += f", {long:,} CAN FD frames of more than eight bytes not sent"
    if pauses:
        several = "s" if pauses > 1 else ""
        lost += f", {pauses} pause{several} cut to a minute ({left_out_us / 3.6e9:,.1f} h left out)"
    return f"{log}: {sent:,} frames sent to {bus} in {time.monotonic() - started:.1f} s{lost}"
