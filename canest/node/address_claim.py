"""J1939 address claim (SAE J1939-81) as a state machine without input, output or clock.

Inputs are received claims and requests with the time (microseconds of a monotonic clock); outputs are frames
to send. It owns an address only after its claim stood 250 ms unopposed; until then, and after it has lost
every address, nothing may be broadcast. All it sends passes one token bucket, so nobody can make it flood:
answers that found the bucket empty are merged into one, sent as soon as a token is there.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from enum import Enum

from canest.config.bus import Name
from canest.decode import j1939

CLAIM_PGN = 0xEE00
REQUEST_PGN = 0xEA00
NULL_ADDRESS = 0xFE

VETO_US = 250_000  #: J1939-81: a claim of an address in 128..247 stands when unopposed for this long
RETRY_US = 60_000_000  #: after "cannot claim": try again, the bus may have changed
#: the same because of our own NAME, the first time: two nodes that start at once lose to each other
FIRST_RETRY_US = 1_000_000
SPREAD_US = 10_000_000  #: up to so much later, at random: two nodes of one NAME do not try again together
FIRST_ADDRESS, LAST_ADDRESS = 128, 247  #: the self-configurable addresses
#: J1939-81: "cannot claim" is sent after a pseudo-random delay of 0..153 ms, so that losers do not collide
_DELAY_STEP_US = 600
BURST, REFILL_US = 8, 200_000  #: token bucket: at most 8 frames at once, 5 per second in the long run
#: no tick for this long (SIGSTOP, a suspended machine): somebody may have taken the address meanwhile
_SUSPENDED_US = 2_000_000

Frame = tuple[int, bytes]  #: identifier with flags, payload


class State(Enum):
    """Where the claim stands."""

    IDLE = "not started"
    CLAIMING = "claiming"
    OWNED = "owned"
    CANNOT_CLAIM = "cannot claim"


def encode_name(name: Name) -> int:
    """Return the 64-bit NAME (ISO 11783-5, J1939-81) of a config section."""
    return (
        name.identity
        | name.manufacturer << 21
        | name.ecu_instance << 32
        | name.function_instance << 35
        | name.function << 40
        | name.vehicle_system << 49
        | name.vehicle_system_instance << 56
        | name.industry_group << 60
        | int(name.arbitrary_address_capable) << 63
    )


class AddressClaim:
    """Claims and defends one address.

    name: our NAME; the numerically lower one wins a contest. preferred: first address tried; with an
    arbitrary-address-capable NAME the others of 128..247 follow, those known to be taken left out.
    uniform: returns a random number from 0 to 1, another one in each process.
    """

    def __init__(self, name: int, preferred: int, uniform: Callable[[], float] = random.random) -> None:
        self.name, self._preferred, self._uniform = name, preferred, uniform
        self.state = State.IDLE
        self.reason = ""
        self.counters: Counter[str] = Counter()
        self._arbitrary = bool(name >> 63)
        self._candidate = preferred
        self._taken: dict[int, int] = {}
        self._lost: set[int] = set()
        self._due_us: int | None = None  #: when the next claim (or "cannot claim") is to be sent
        self._sent_us = 0  #: when the present claim went out
        self._announced = False  #: the present claim has gone out at least once
        self._retry_us = RETRY_US  #: from "cannot claim" to the next attempt
        self._lost_to_own_name = False  #: since we last owned an address
        self._tokens, self._refilled_us = float(BURST), 0
        self._boottime_us: int | None = None  #: when `poll` was last called

    @property
    def address(self) -> int | None:
        """Return the address we own, None while we own none."""
        return self._candidate if self.state is State.OWNED else None

    def start(self, now_us: int) -> None:
        """Begin (or begin anew, after the interface came back) with the preferred address."""
        self._taken.clear()
        self._lost.clear()
        self._claim(self._preferred, now_us)

    def on_claim(self, source: int, name: int, now_us: int) -> None:
        """Handle a claim of ``source`` (254: the sender cannot claim any address)."""
        if source >= NULL_ADDRESS:
            return
        self._taken = {a: n for a, n in self._taken.items() if n != name}  # it has left its old address
        self._taken[source] = name
        if source != self._candidate or self.state not in (State.CLAIMING, State.OWNED):
            return
        self.counters["address_contests"] += 1
        if self.name < name:
            self._due_us = now_us  # ours wins: repeat the claim
            return
        if self.name == name and self.state is State.OWNED:
            self._claim(source, now_us)  # a second node with our NAME receives it, and yields as we would
            return
        self.counters["addresses_lost"] += 1
        self._lost.add(source)
        if name == self.name:
            self._give_up(now_us, "another node sends our NAME")
            first, self._lost_to_own_name = not self._lost_to_own_name, True
            self._retry_us = (FIRST_RETRY_US if first else RETRY_US) + round(self._uniform() * SPREAD_US)
            return
        following = self._next_address()
        if following is None:
            self._give_up(now_us, "every address we may use is taken")
        else:
            self._claim(following, now_us)

    def on_request(self, now_us: int) -> None:
        """Answer a request for address claims: repeat the claim, or that we could not claim."""
        if self.state is not State.IDLE and self._due_us is None:
            self._due_us = now_us + (self._delay_us if self.state is State.CANNOT_CLAIM else 0)

    def poll(self, now_us: int, boottime_us: int | None = None) -> list[Frame]:
        """Return the frames to send now; call every tick.

        boottime_us: time of a clock that goes on while the machine is suspended (default: ``now_us``).
        """
        before_us, self._boottime_us = self._boottime_us, now_us if boottime_us is None else boottime_us
        suspended = before_us is not None and self._boottime_us - before_us > _SUSPENDED_US
        if suspended and self.state is State.OWNED:
            self.counters["reclaimed_after_sleep"] += 1
            self._claim(self._candidate, now_us)
        if self.state is State.CANNOT_CLAIM and self._announced and now_us - self._sent_us >= self._retry_us:
            self.start(now_us)
        frames = []
        if self._due_us is not None and now_us >= self._due_us and self._take_token(now_us):
            frames.append(self._claim_frame())
            if not self._announced:
                self._announced, self._sent_us = True, now_us
            self._due_us = None
        if self.state is State.CLAIMING and self._claim_stands(now_us):
            self.state, self.reason, self._lost_to_own_name = State.OWNED, "", False
        return frames

    def not_sent(self, now_us: int) -> None:
        """The interface did not take the frame of the last `poll`: it is sent again."""
        self._due_us = now_us
        if self.state is not State.OWNED:
            self._announced = False

    def is_on_its_way(self, now_us: int) -> None:
        """The interface has a frame that is not on the bus yet: the time to contest a claim has not begun."""
        if self.state is State.CLAIMING and self._announced:
            self._sent_us = now_us

    def _claim_stands(self, now_us: int) -> bool:
        return self._announced and self._due_us is None and now_us - self._sent_us >= VETO_US

    def _claim(self, address: int, now_us: int) -> None:
        self._candidate, self.state, self.reason = address, State.CLAIMING, ""
        self._announced, self._due_us = False, now_us

    def _give_up(self, now_us: int, reason: str) -> None:
        self.state, self.reason = State.CANNOT_CLAIM, reason
        self._announced, self._retry_us = False, RETRY_US
        self._due_us = now_us + self._delay_us

    @property
    def _delay_us(self) -> int:
        """Delay before "cannot claim" is sent."""
        return (self.name * 2654435761 >> 16 & 0xFF) * _DELAY_STEP_US

    def _next_address(self) -> int | None:
        """Return the next free address after the candidate, walking round once."""
        if not self._arbitrary:
            return None
        span = LAST_ADDRESS - FIRST_ADDRESS + 1
        for step in range(1, span + 1):
            address = FIRST_ADDRESS + (self._candidate - FIRST_ADDRESS + step) % span
            if address not in self._taken and address not in self._lost:
                return address
        return None

    def _claim_frame(self) -> Frame:
        self.counters["claims_sent"] += 1
        source = NULL_ADDRESS if self.state is State.CANNOT_CLAIM else self._candidate
        return j1939.pack(CLAIM_PGN, source), self.name.to_bytes(8, "little")

    def _take_token(self, now_us: int) -> bool:
        self._tokens = min(BURST, self._tokens + (now_us - self._refilled_us) / REFILL_US)
        self._refilled_us = now_us
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True
