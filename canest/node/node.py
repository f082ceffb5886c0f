"""The daemon as a J1939 node: it monitors the bus and, unless it only listens, sends the estimate."""

from __future__ import annotations

import time

from canest.bus.link import may_transmit, open_link, require_frames, require_interface
from canest.bus.protocols import Filters, Receiver, Transmitter
from canest.config.schema import Config
from canest.core.frames import FrameBlock
from canest.decode import j1939
from canest.node.address_claim import CLAIM_PGN, AddressClaim
from canest.node.broadcast import Broadcaster
from canest.node.bus_monitor import CVW_PGN, BusMonitor
from canest.node.estimate_frame import Estimate
from canest.node.network_management import NetworkManagement

_BOOT_CLOCK: int = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  #: only Linux has, and needs, it
LISTENING_ONLY = "listening only (broadcast.listen_only)"
NEVER_US = 1 << 62
NOT_ENABLED = "broadcast is off (a physical bus needs broadcast.enabled: true)"


class Node:
    """Times are microseconds of a monotonic clock.

    Without a transmitter there is nothing that could send: neither estimates nor a claim.
    """

    def __init__(self, config: Config, monitor: BusMonitor) -> None:
        self.monitor = monitor
        self.network_management: NetworkManagement | None = None
        self.broadcaster: Broadcaster | None = None
        self.transmitter: Transmitter | None = None
        self._sent_from: int | None = None  #: address of the last frames
        self._not_sending_because = LISTENING_ONLY if config.broadcast.listen_only else NOT_ENABLED

    def attach(self, config: Config, transmitter: Transmitter, now_us: int) -> None:
        """Begin to send: claim an address, then broadcast."""
        self.transmitter = transmitter
        self.broadcaster = Broadcaster(config.broadcast)
        self.network_management = NetworkManagement(config.broadcast, self.broadcaster.groups)
        self.network_management.start(now_us)

    def restart(self, now_us: int) -> None:
        """The interface was opened anew: another bus may be behind it."""
        if self.network_management is not None:
            self.network_management.start(now_us)

    def repeat_claim(self, now_us: int) -> None:
        """The interface was off the bus for a moment: show whose the address is."""
        if self.network_management is not None:
            self.network_management.claim.on_request(now_us)

    def observe(self, frames: FrameBlock, now_us: int) -> None:
        """Take the frames that arrived."""
        self.monitor.observe(frames, now_us)
        if self.network_management is not None:
            self.network_management.observe(self.monitor, now_us)

    def set_estimate(self, estimate: Estimate, now_us: int) -> None:
        """Take the newest estimate."""
        if self.broadcaster is not None:
            self.broadcaster.set_estimate(estimate, now_us)

    def due_us(self, now_us: int) -> int:
        """Return when the next estimate is due (far in the future while none may be sent)."""
        if self.broadcaster is None or self.silence_reason(now_us):
            return NEVER_US
        return self.broadcaster.due_us

    def send_due(self, now_us: int) -> None:
        """Send what is due."""
        management, broadcaster = self.network_management, self.broadcaster
        transmitter = self.transmitter
        if management is None or broadcaster is None or transmitter is None:
            return
        self._follow_frames_that_wait(management.claim, transmitter, now_us)
        for can_id, payload in management.poll(now_us, boottime_us()):
            if not transmitter.send(can_id, payload):
                management.claim.not_sent(now_us)
        address = management.broadcast_address(now_us)
        taken = {CVW_PGN} if self.monitor.mass_is_sent_by_others(now_us) else set()
        available = frozenset() if address is None else broadcaster.available(now_us, taken)
        for can_id, payload in management.refusals(now_us, available):
            transmitter.send(can_id, payload)
        if address is not None:
            for can_id, payload in broadcaster.frames(now_us, address, management.requested, taken):
                transmitter.send(can_id, payload)
        management.requested.clear()

    def _follow_frames_that_wait(self, claim: AddressClaim, transmitter: Transmitter, now_us: int) -> None:
        """See what a slow interface has made of our frames: a claim counts from when it is on the bus."""
        if self._sent_from not in (None, claim.address):
            transmitter.drop_waiting()
        self._sent_from = claim.address
        if any(j1939.pgn_of(can_id) == CLAIM_PGN for can_id in transmitter.failed()):
            claim.not_sent(now_us)
        if transmitter.waiting:
            claim.is_on_its_way(now_us)

    def silence_reason(self, now_us: int) -> str:
        """Return one sentence on why nothing is broadcast ('' when something is)."""
        management = self.network_management
        return self._not_sending_because if management is None else management.silence_reason(now_us)

    @property
    def group_is_taken(self) -> bool:
        """Return whether another address sends in our group, so that we do not."""
        return self.network_management is not None and self.network_management.group_user is not None

    @property
    def other_group_users(self) -> list[int]:
        """Return the other addresses that send in our group."""
        return sorted(a for a in self.monitor.group_users if a != self.address)

    @property
    def address(self) -> int | None:
        """Return the address we own."""
        return None if self.network_management is None else self.network_management.claim.address

    def counters(self) -> dict[str, int]:
        """Return everything counted here."""
        counted = dict(self.monitor.counters)
        if self.network_management is not None:
            counted |= self.network_management.counters
            counted |= self.network_management.claim.counters
        if self.broadcaster is not None:
            counted |= self.broadcaster.counters
        if self.transmitter is not None:
            counted |= self.transmitter.counters
        return counted


def boottime_us() -> int:
    """Return the time of a clock that goes on while the machine is suspended, unlike Linux' monotonic one."""
    return time.clock_gettime_ns(_BOOT_CLOCK) // 1000


def join(config: Config, wanted: Filters) -> tuple[Receiver, Node]:
    """Open the bus that a config names and become a node of it, one that sends where the config allows it.

    wanted: kernel filters of what the estimation needs; those of a node are added.
    Errors: ConfigError, BusError when the interface can never be opened here.
    """
    require_frames(config)
    require_interface(config.bus, config.at)
    monitor = BusMonitor(config.broadcast.pgn)
    receiver, transmitter = open_link(
        config.bus,
        sorted({*wanted, *monitor.filters()}),
        transmit=may_transmit(config.bus, config.broadcast),
        silent=config.broadcast.listen_only,
    )
    node = Node(config, monitor)
    if transmitter is not None:
        node.attach(config, transmitter, time.monotonic_ns() // 1000)
    return receiver, node


def rejoined(config: Config, node: Node) -> Node:
    """Return a new node on the bus of another: a config that sends otherwise, through the same interface."""
    new = Node(config, BusMonitor(config.broadcast.pgn))
    if node.transmitter is not None:
        node.transmitter.drop_waiting()
        node.transmitter.failed()
        new.attach(config, node.transmitter, time.monotonic_ns() // 1000)
    return new
