"""Sends through a python-can interface, in the driver's thread: an adapter may take its time."""

from __future__ import annotations

import contextlib
import time
from collections import Counter, deque

from canest.bus import drivers
from canest.bus.pythoncan import PythonCanReceiver
from canest.system.python_can import can

_SEND_S = 0.002  #: how long is waited to see whether a frame was sent
_MOST_UNSENT = 16  #: frames that wait for an adapter
_UNSENT_S = 0.25  #: older ones are of no use to anybody


class PythonCanTransmitter:
    """Sends through the receiver's bus."""

    def __init__(self, receiver: PythonCanReceiver) -> None:
        self._receiver = receiver
        self._timeout_s = drivers.send_timeout_s(receiver._config.interface)
        self.counters: Counter[str] = Counter()
        self._taken = self._finished = 0  #: frames; the latter is counted by the thread
        self._failed: deque[int] = deque()
        self._generation = 0  #: of the address that frames are sent from

    def send(self, can_id: int, payload: bytes) -> bool:
        """Send one frame if the interface takes it at once; see `canest.bus.protocols.Transmitter`.

        An adapter that takes longer than a moment has the frame in its queue; what becomes of it is counted.
        """
        receiver = self._receiver  # the transmitter shares the receiver's bus
        if receiver._bus is None:
            self.counters["dropped_interface_absent"] += 1
            return False
        if receiver._thread.waiting >= _MOST_UNSENT:
            self.counters["dropped_buffer_full"] += 1
            return False
        sending = _Sending(self, receiver._bus, can_id, payload)
        self._taken += 1
        if not receiver._thread.do(sending.run).done(_SEND_S):
            return True
        if not sending.sent and can_id in self._failed:
            self._failed.remove(can_id)  # known at once
        return sending.sent

    @property
    def waiting(self) -> int:
        """Return how many frames are with the driver; see `canest.bus.protocols.Transmitter`."""
        return self._taken - self._finished

    def failed(self) -> list[int]:
        """Return what became nothing; see `canest.bus.protocols.Transmitter`."""
        return [self._failed.popleft() for _ in range(len(self._failed))]

    def drop_waiting(self) -> None:
        """Send none of what waits; see `canest.bus.protocols.Transmitter`."""
        self._generation += 1


class _Sending:
    """One frame on its way out, in the driver's thread."""

    def __init__(
        self, transmitter: PythonCanTransmitter, bus: can.BusABC, can_id: int, payload: bytes
    ) -> None:
        self._transmitter, self._bus = transmitter, bus
        self._can_id, self._payload = can_id, payload
        self._until_s, self._generation = time.monotonic() + _UNSENT_S, transmitter._generation
        self.sent = False

    def run(self) -> None:
        self._send()
        if not self.sent:
            self._transmitter._failed.append(self._can_id)
        self._transmitter._finished += 1

    def _send(self) -> None:
        counters, echoes = self._transmitter.counters, self._transmitter._receiver._echoes
        if time.monotonic() > self._until_s:
            counters["dropped_too_late"] += 1
            return
        if self._generation != self._transmitter._generation:
            counters["dropped_address_lost"] += 1
            return
        echo = self._can_id, self._payload
        if echoes is not None:
            echoes.append(echo)  # before it is sent: it may come back at once
        try:
            self._bus.send(
                drivers.message_of(self._can_id, self._payload), timeout=self._transmitter._timeout_s
            )
        except Exception:  # full queues and dead devices, in every driver's own words
            counters["dropped_send_failed"] += 1
            if echoes is not None:
                with contextlib.suppress(ValueError):  # it came back although the send failed
                    echoes.remove(echo)
            return
        counters["sent"] += 1
        self.sent = True
