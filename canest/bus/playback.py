"""Plays a recorded log onto a bus, in the log's own timing or a multiple of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from canest.bus.link import require_interface
from canest.config.bus import Bus
from canest.core.errors import BusError, LogError, UsageError
from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.logs.candump_line import CLASSIC_BYTES
from canest.logs.format_detection import open_log

if TYPE_CHECKING:
    import can

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
    Returns one sentence with the number of frames sent. Errors: UsageError, ConfigError (an unknown
    interface), BusError, LogError.
    """
    interface, colon, name = bus.partition(":")
    if not colon or not interface or not name:
        raise UsageError("malformed --to", found=bus, expected="INTERFACE:CHANNEL, e.g. socketcan:vcan0")
    require_interface(Bus(interface=interface, channel=name), lambda _: bus)
    reader = open_log(log, channel=channel, block_frames=_BLOCK_FRAMES)
    if reader.kind == "table":
        raise LogError("holds decoded signals, no frames: it cannot be played onto a bus", where=log)
    out = _open(interface, name, bus)
    timing, player = _Timing(speed), _Player(out)
    started_s = time.monotonic()
    try:
        for block in reader:
            assert isinstance(block, FrameBlock)
            player.play(block, timing)
            if progress is not None:
                progress(reader.bytes_done, reader.bytes_total)
    finally:
        out.shutdown()
    took_s = time.monotonic() - started_s
    return f"{log}: {player.sent:,} frames sent to {bus} in {took_s:.1f} s{player.losses()}{timing.cuts()}"


def _open(interface: str, channel: str, bus: str) -> can.BusABC:
    from canest.bus.drivers import missing_driver
    from canest.system.python_can import can  # heavy

    try:
        return can.Bus(interface=interface, channel=channel)
    except Exception as error:  # each of python-can's interfaces has exceptions of its own
        raise BusError(
            f"cannot be opened ({' '.join(str(error).split())})",
            where=bus,
            expected=missing_driver(interface)
            if "not installed" in str(error)
            else "an interface that is up (ip link), or another one, e.g. udp_multicast:239.74.163.2",
        ) from None


class _Timing:
    """When each frame is due: first + (t - t_first) / speed, without clock steps and long pauses."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._begin_s = time.monotonic()
        self._first_us: int | None = None
        self._last_us = self._pauses = self._left_out_us = 0

    def wait(self, t_us: int) -> None:
        """Sleep until a frame of this stamp is due."""
        if self._first_us is None or t_us < self._last_us - _SET_BACK_US:
            self._begin_s, self._first_us = time.monotonic(), t_us
        elif t_us - self._last_us > _PAUSE_US:
            beyond_us = t_us - self._last_us - _PAUSE_US
            self._first_us += beyond_us
            self._left_out_us += beyond_us
            self._pauses += 1
        self._last_us = t_us
        wait_s = self._begin_s + (t_us - self._first_us) * 1e-6 / self._speed - time.monotonic()
        if wait_s > _SHORT_S:
            time.sleep(wait_s)

    def cuts(self) -> str:
        """Return the pauses that were cut, as the end of a sentence."""
        if not self._pauses:
            return ""
        several = "s" if self._pauses > 1 else ""
        left_out_h = self._left_out_us / 3.6e9
        return f", {self._pauses} pause{several} cut to a minute ({left_out_h:,.1f} h left out)"


class _Player:
    """Sends the frames of a log and counts them."""

    def __init__(self, out: can.BusABC) -> None:
        self._out = out
        self.sent = self._dropped = self._too_long = 0

    def play(self, block: FrameBlock, timing: _Timing) -> None:
        """Send the frames of a block, each when it is due."""
        columns = block.t_us, block.can_id, block.length, block.data
        for t_us, can_id, length, word in zip(*(column.tolist() for column in columns), strict=True):
            if can_id & ERROR:
                continue
            if length > CLASSIC_BYTES and not can_id & REMOTE:
                self._too_long += 1
                continue
            timing.wait(t_us)
            self._send(can_id, length, word)

    def losses(self) -> str:
        """Return the frames that were not sent, as the end of a sentence."""
        text = f", {self._dropped:,} dropped (the interface did not take them)" if self._dropped else ""
        if self._too_long:
            text += f", {self._too_long:,} CAN FD frames of more than eight bytes not sent"
        return text

    def _send(self, can_id: int, length: int, word: int) -> None:
        import can  # loaded by now

        message = can.Message(
            arbitration_id=can_id & ID_MASK,
            is_extended_id=bool(can_id & EXTENDED),
            is_remote_frame=bool(can_id & REMOTE),
            dlc=length,
            data=None if can_id & REMOTE else word.to_bytes(8, "little")[:length],
        )
        try:
            self._out.send(message, timeout=SEND_TIMEOUT_S)
            self.sent += 1
        except (can.CanError, ValueError):
            self._dropped += 1
