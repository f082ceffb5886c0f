"""The daemon as a node of the bus: what it notices there, and, unless it only listens, what it says."""

from __future__ import annotations

import time

from canest.bus.link import (
    Filters,
    Receiver,
    Transmitter,
    may_transmit,
    open_link,
    require_frames,
    require_interface,
)
from canest.config.schema import Config
from canest.core.frames import FrameBlock
from canest.node.broadcast import Broadcaster
from canest.node.bus_monitor import CVW_PGN, BusWatch
from canest.node.estimate_frame import Estimate
from canest.node.network_management import Citizen

_AWAKE_CLOCK: int = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  #: only Linux has, and needs, it
LISTENING_ONLY = "listening only (broadcast.listen_only)"
NEVER_US = 1 << 62
NOT_ENABLED = "broadcast is off (a physical bus needs broadcast.enabled: true)"


class Node:
    """Times are microseconds of a monotonic clock.

    Without a transmitter there is nothing that could send: neither estimates nor a claim.
    """

    def __init__(self, config: Config, watch: BusWatch) -> None:
        self.watch = watch
        self.citizen: Citizen | None = None
        self.broadcaster: Broadcaster | None = None
        self._transmitter: Transmitter | None = None
        self._mute = LISTENING_ONLY if config.broadcast.listen_only else NOT_ENABLED

    def attach(self, config: Config, transmitter: Transmitter, now_us: int) -> None:
        """Become a node that speaks."""
        self._transmitter = transmitter
        self.broadcaster = Broadcaster(config.broadcast)
        self.citizen = Citizen(config.broadcast, self.broadcaster.groups)
        self.citizen.start(now_us)

    def restart(self, now_us: int) -> None:
        """The interface was opened anew: another bus may be behind it."""
        if self.citizen is not None:
            self.citizen.start(now_us)

    def observe(self, frames: FrameBlock, now_us: int) -> None:
        """Take the frames that arrived."""
        self.watch.observe(frames, now_us)
        if self.citizen is not None:
            self.citizen.observe(self.watch, now_us)

    def take(self, estimate: Estimate, now_us: int) -> None:
        """Take the newest estimate."""
        if self.broadcaster is not None:
            self.broadcaster.take(estimate, now_us)

    def due_us(self, now_us: int) -> int:
        """Return when the next `speak` is going to send an estimate (far in the future while it must not)."""
        if self.broadcaster is None or self.silence(now_us):
            return NEVER_US
        return self.broadcaster.due_us

    def speak(self, now_us: int) -> None:
        """Send what is due."""
        citizen, broadcaster, transmitter = self.citizen, self.broadcaster, self._transmitter
        if citizen is None or broadcaster is None or transmitter is None:
            return
        for can_id, payload in citizen.poll(now_us, awake_us()):
            if not transmitter.send(can_id, payload):
                citizen.claim.not_sent(now_us)
        address = citizen.address_to_speak_from(now_us)
        if address is None:
            return
        taken = {CVW_PGN} if self.watch.mass_is_sent_by_others(now_us) else set()
        for can_id, payload in broadcaster.frames(now_us, address, citizen.requested, taken):
            transmitter.send(can_id, payload)
        citizen.requested.clear()

    def silence(self, now_us: int) -> str:
        """Return in plain words why nothing is broadcast ('' when something is)."""
        return self._mute if self.citizen is None else self.citizen.silence(now_us)

    @property
    def group_is_taken(self) -> bool:
        """Return whether somebody else uses our group, so that we are silent."""
        return self.citizen is not None and self.citizen.group_user is not None

    @property
    def address(self) -> int | None:
        """Return the address we own."""
        return None if self.citizen is None else self.citizen.claim.address

    def counters(self) -> dict[str, int]:
        """Return everything counted here."""
        counted = dict(self.watch.counters)
        if self.citizen is not None:
            counted |= self.citizen.counters
            counted |= self.citizen.claim.counters
        if self.broadcaster is not None:
            counted |= self.broadcaster.counters
        if self._transmitter is not None:
            counted |= self._transmitter.counters
        return counted


def awake_us() -> int:
    """Return the time of a clock that goes on while the machine is suspended, unlike Linux' monotonic one."""
    return time.clock_gettime_ns(_AWAKE_CLOCK) // 1000


def join(config: Config, wanted: Filters) -> tuple[Receiver, Node]:
    """Open the bus that a config names and become a node of it, one that speaks where the config lets it.

    wanted: kernel filters of what the estimation needs; what a node has to hear comes beside it.
    Errors: ConfigError, BusError when the interface can never be opened here.
    """
    require_frames(config)
    require_interface(config.bus, config.at)
    watch = BusWatch(config.broadcast.pgn)
    receiver, transmitter = open_link(
        config.bus,
        sorted({*wanted, *watch.filters()}),
        transmit=may_transmit(config.bus, config.broadcast),
    )
    node = Node(config, watch)
    if transmitter is not None:
        node.attach(config, transmitter, time.monotonic_ns() // 1000)
    return receiver, node
