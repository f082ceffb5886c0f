"""Logs what has changed in the daemon's condition, each change once, and the last one late if need be."""

from __future__ import annotations

from canest.bus.protocols import bus_state
from canest.node.estimate_frame import STATUS_NAMES
from canest.system.journal import Journal
from canest.telemetry.daemon_view import DaemonView
from canest.telemetry.sender_tables import sender_name

#: kinds of files, as `Background` counts them
_FILE_KINDS = ("state", "metrics", "record", "ring", "estimates")


class StateChangeLog:
    """Keeps the logged value of every event. The names of the events are a public contract.

    Of values that come and go faster than the journal writes, the last is written as soon as there is room.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._logged: dict[str, object] = {}
        self._held_back: dict[str, object] = {}

    def log(self, view: DaemonView) -> None:
        """Log every value that differs from the one before."""
        self._log("bus", bus_state(view.receiver), bad=view.receiver.state != "up")
        self._log_node(view)
        self._log("status", STATUS_NAMES[view.estimate.status])
        notes = view.notes_logged
        self._log("notes", notes or "none", bad=bool(notes), unless_first=not notes)
        self._log_senders(view)
        for kind in _FILE_KINDS:
            failure = view.background.failures.get(kind, "")
            self._log(f"writing-{kind}", failure or "works", bad=bool(failure), unless_first=not failure)

    def _log_node(self, view: DaemonView) -> None:
        node = view.node
        silence = node.silence_reason(view.now_us)
        self._log("broadcast", silence or f"on from address {node.address:#04x}", bad=node.group_is_taken)
        shared = "" if silence else ", ".join(f"{a:#04x}" for a in node.other_group_users)
        self._log("group-used-by-others", shared or "none", bad=bool(shared), unless_first=not shared)
        lost = node.monitor.counters["cannot_claim_received"]
        self._log("addresses-lost-by-others", lost, bad=True, unless_first=not lost)
        masses = ", ".join(f"{a:#04x}" for a in sorted(node.monitor.other_masses))
        self._log("masses-sent-by-others", masses, unless_first=not masses)

    def _log_senders(self, view: DaemonView) -> None:
        counters = view.pipeline.decoder.counters
        others = len(counters.other_senders)
        self._log("other-senders", others, bad=True, unless_first=not others)
        contested = ", ".join(sorted(counters.contested()))
        self._log("contested-signals", contested, bad=True, unless_first=not contested)
        faster = ", ".join(sorted(map(sender_name, view.sender_rates.faster)))
        self._log("senders-faster-than-usual", faster or "none", bad=bool(faster), unless_first=not faster)
        stuck = ", ".join(sorted(view.pipeline.stuck_ticks))
        self._log("frozen-signals", stuck, bad=True, unless_first=not stuck)

    def _log(self, event: str, value: object, *, bad: bool = False, unless_first: bool = False) -> None:
        """Log a value that differs from the one before; ``unless_first``: not when it is the first one."""
        if self._logged.get(event) == value or (unless_first and event not in self._logged):
            self._held_back.pop(event, None)
            return
        if self._held_back.get(event) == value and not self._journal.has_room(event):
            return  # counted before
        if (self._journal.warning if bad else self._journal.notice)(event, now=value):
            self._logged[event] = value
            self._held_back.pop(event, None)
        else:
            self._held_back[event] = value
