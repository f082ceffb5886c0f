"""Tells the journal what has changed since the last look, and nothing twice."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.node.estimate_frame import STATUS_WORDS
from canest.telemetry.snapshot import bus_state, sender_name

if TYPE_CHECKING:
    from canest.live.daemon import Daemon

_KINDS = ("state", "metrics", "record", "ring", "estimates")


class Changes:
    """Remembers what was told."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self._told: dict[str, object] = {}

    def tell(self, now_us: int) -> None:
        """Look at everything worth a line in the journal."""
        daemon = self._daemon
        self._tell("bus", bus_state(daemon), bad=daemon.receiver.state != "up")
        silence, address = daemon.node.silence(now_us), daemon.node.address
        speaks = silence or f"on from address {address:#04x}"
        self._tell("broadcast", speaks, bad=daemon.node.group_is_taken)
        self._tell("status", STATUS_WORDS[daemon.estimate(now_us).status])
        others = len(daemon.pipeline.decoder.counters.other_senders)
        self._tell("other-senders", others, bad=True, unless_first=not others)
        doubted = ", ".join(sorted(daemon.pipeline.decoder.counters.contested()))
        self._tell("contested-signals", doubted, bad=True, unless_first=not doubted)
        faster = ", ".join(sorted(map(sender_name, daemon.paces.faster)))
        self._tell("senders-faster-than-usual", faster or "none", bad=bool(faster), unless_first=not faster)
        frozen = ", ".join(sorted(daemon.pipeline.stuck_ticks))
        self._tell("frozen-signals", frozen, bad=True, unless_first=not frozen)
        lost = daemon.node.watch.counters["cannot_claim_heard"]
        self._tell("addresses-lost-by-others", lost, bad=True, unless_first=not lost)
        masses = ", ".join(f"{a:#04x}" for a in sorted(daemon.node.watch.other_masses))
        self._tell("masses-sent-by-others", masses, unless_first=not masses)
        for kind in _KINDS:
            failure = daemon.background.failures.get(kind, "")
            self._tell(f"writing-{kind}", failure or "works", bad=bool(failure), unless_first=not failure)

    def _tell(self, what: str, value: object, *, bad: bool = False, unless_first: bool = False) -> None:
        """Log a value that is another one than before; ``unless_first``: not when it is the first one."""
        if self._told.get(what) == value or (unless_first and what not in self._told):
            return
        self._told[what] = value
        journal = self._daemon.journal
        (journal.warning if bad else journal.notice)(what, now=value)
