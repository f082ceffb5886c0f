"""Every other interface python-can has (udp_multicast, virtual, slcan, pcan, ...), behind the same halves.

The loop itself reads, without waiting; what may take a driver seconds is done by a `DriverThread`. An error
about one line or datagram is counted, and the next one read; the device's own failure leads to a new attempt
to open it.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections import Counter, deque
from typing import TYPE_CHECKING

from canest.bus import drivers
from canest.bus.driver_thread import DriverThread, Job
from canest.bus.kernel_drain import Drained
from canest.bus.protocols import REOPEN_S, Filters
from canest.bus.sandbox import forbidden_sockets
from canest.config.bus import Bus
from canest.core.errors import BusError
from canest.core.frames import ERROR, FrameBlock, frame_of
from canest.core.samples import STEP_US

if TYPE_CHECKING:
    import can  # at run time only by way of `drivers`, which keeps the import light

GUARD_US = 20_000  #: drivers hand a frame over this long after its stamp at the latest
_IDS_KEPT = 4096  #: a bus has some hundreds of identifiers, noise has millions
_MAX_FRAMES = 4096  #: read at once, so that a flood cannot keep a tick from ending
#: failures in a row, with nothing read and no end of the input in between, that close an interface: more than
#: a socket or a terminal can hold of damaged input, and as many of a driver's own errors
_MAX_BAD_INPUTS, _MAX_ERRORS = 2500, 20
_FAILURES_BUDGET_S = 0.05  #: time spent on failures at once
#: stamps further from the machine's clock may be those of a log that somebody plays at any speed
_PRESENT_US = 1_000_000
_STAMP_MAX_S = 9e12  #: what microseconds in 64 bits can hold
#: how long is waited for an interface to open: at the start, and between two ticks. Some take seconds
_FIRST_OPEN_S, _OPEN_S = 0.25, 0.02
_CLOSE_S = 0.25  #: how long an adapter may take to be closed before the process ends without it


class _Opening:
    """One attempt to open an interface, in the driver's thread."""

    def __init__(self, config: Bus, thread: DriverThread) -> None:
        self._config = config
        self.bus: can.BusABC | None = None
        self.never: tuple[Exception, str] | None = None  #: why it cannot open, however long it is waited for
        self.reason = "being opened"
        self._job: Job = thread.do(self._run)

    def done(self, wait_s: float) -> bool:
        """Return whether it is over, after ``wait_s`` at most."""
        return self._job.done(wait_s)

    def _run(self) -> None:
        try:
            self.bus = drivers.open_bus(self._config)
        except Exception as error:  # drivers raise anything when a device is not there
            expected = drivers.never_opens(error, self._config.interface)
            self.never = (error.with_traceback(None), expected) if expected else None
            self.reason = "; ".join(
                filter(None, (drivers.error_text(error), forbidden_sockets(self._config)))
            )


class PythonCanReceiver:
    """Receives from any python-can interface; see `canest.bus.protocols.Receiver`.

    Errors: BusError when python-can has no such interface, lacks its driver or an option of it; an interface
    that is merely absent now is waited for.
    """

    max_poll_interval_us = STEP_US  # the size of a driver's buffer is not known

    def __init__(self, bus: Bus, filters: Filters) -> None:
        self._config = bus
        # python-can's own filters make recv(0) return None, as if nothing waited, for every frame they refuse
        self._filters = [(i & m, m) for i, m in filters]
        self._wanted: dict[int, bool] = {}
        self.state, self.reason = "absent", ""
        self.opened = 0
        self.counters: Counter[str] = Counter()
        self._thread = DriverThread(f"canest-{bus.interface}")
        self._opening: _Opening | None = None
        self._bus: can.BusABC | None = None
        self._failures = 0  #: in a row
        self._rows: list[tuple[int, int, bytes]] = []
        #: the newest stamp less the monotonic time at which it was read: stamps may come from any clock
        self._clock_offset_us: int | None = None
        #: frames sent whose echo is to be dropped when it comes
        self._echoes: deque[tuple[int, bytes]] | None = (
            deque(maxlen=64) if bus.interface in drivers.ECHOING else None
        )
        self._retry_at_s = 0.0
        never = self._open(_FIRST_OPEN_S)
        if never is not None:
            self.close()
            error, expected = never
            raise BusError(
                f"cannot be used ({drivers.error_text(error).rstrip('.')})",
                where=f"bus.interface {bus.interface}",
                expected=expected,
            ) from error

    def collect(self) -> bool:
        """Empty the driver's buffer; see `canest.bus.protocols.Receiver`."""
        if self._bus is None and (self._opening is not None or time.monotonic() >= self._retry_at_s):
            self._open(_OPEN_S)
        until_s = time.monotonic() + _FAILURES_BUDGET_S
        for _ in range(_MAX_FRAMES):
            if self._bus is None or not self._read(self._bus):
                return True
            if self._failures and time.monotonic() > until_s:
                break
        return self._bus is None

    def drain(self) -> Drained:
        """Return what has arrived; see `canest.bus.protocols.Receiver`."""
        before_us = time.monotonic_ns() // 1000
        reached_us = None
        if self.collect() and self._clock_offset_us is not None:
            # a frame waits before it is read, so the clock of the stamps is at least this far
            stamping_us = before_us + self._clock_offset_us
            if abs(stamping_us - time.time_ns() // 1000) < _PRESENT_US:
                reached_us = stamping_us - GUARD_US
        rows, self._rows = self._rows, []
        return Drained(FrameBlock.from_frames(rows), reached_us)

    def close(self) -> None:
        """Let the interface go; one that does not close in a quarter of a second is left to its thread."""
        self._release().done(_CLOSE_S)
        self._thread.end()

    def _read(self, bus: can.BusABC) -> bool:
        """Read once; False when the driver has nothing more, or has failed."""
        try:
            message = bus.recv(0)
            self._failures = 0
            if message is not None:
                self._take(message)
            elif not drivers.has_more_input(self._config.interface, bus):
                if drivers.has_overlong_line(bus):
                    self._note_damaged(bus)
                return False
        except Exception as error:  # drivers raise anything; none of it may end the loop
            self._failures += 1
            most = _MAX_ERRORS if drivers.is_driver_error(error) else _MAX_BAD_INPUTS
            if drivers.is_device_failure(error) or self._failures >= most:
                self._failed(error)
                return False
            self._note_damaged(bus)
        return True

    def _take(self, message: can.Message) -> None:
        if not abs(message.timestamp) < _STAMP_MAX_S:  # or not a number
            self.counters["unusable_stamp"] += 1
            return
        if not drivers.is_whole(message):
            self.counters["damaged_input"] += 1
            return
        row = frame_of(message)
        self._clock_offset_us = row[0] - time.monotonic_ns() // 1000
        if not self._is_wanted(row[1]):
            return
        if self._echoes:
            with contextlib.suppress(ValueError):  # it is a stranger's
                self._echoes.remove(row[1:])
                return
        self._rows.append(row)

    def _is_wanted(self, can_id: int) -> bool:
        wanted = self._wanted.get(can_id)
        if wanted is None:
            wanted = bool(can_id & ERROR) or any(can_id & mask == value for value, mask in self._filters)
            if len(self._wanted) >= _IDS_KEPT:
                self._wanted.clear()
            self._wanted[can_id] = wanted
        return wanted

    def _note_damaged(self, bus: can.BusABC) -> None:
        self.counters["damaged_input"] += 1
        drivers.discard_damaged_line(bus)

    def _open(self, wait_s: float) -> tuple[Exception, str] | None:
        """Begin to open the interface, or see whether it is open; return why it never can, and what helps."""
        opening = self._opening
        if opening is None:
            opening = self._opening = _Opening(self._config, self._thread)
        else:
            wait_s = 0.0
        if not opening.done(wait_s):
            self.reason = opening.reason
            return None
        self._opening = None
        self._bus, self.reason = opening.bus, opening.reason
        if self._bus is None:
            self.counters["open_failed"] += 1
            self._retry_at_s = time.monotonic() + REOPEN_S
            return opening.never
        self._failures = 0
        self.opened += 1
        self.state, self.reason = "up", ""
        return None

    def _failed(self, error: Exception) -> None:
        kind = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", type(error).__name__).lower()
        self.counters[f"receive_{kind}"] += 1
        self.counters["interface_lost"] += 1
        self._release()
        self.reason = drivers.error_text(error)
        self._retry_at_s = time.monotonic() + REOPEN_S

    def _release(self) -> Job:
        """Close the interface, be it open or still being opened, in the driver's thread."""
        bus, opening = self._bus, self._opening
        self._bus, self._opening, self.state = None, None, "absent"

        def shutdown() -> None:
            late = None if opening is None else opening.bus
            try:
                for opened in (bus, late):
                    if opened is not None:
                        opened.shutdown()
            except Exception:  # closing a device that is gone
                self.counters["close_failed"] += 1

        return self._thread.do(shutdown)
