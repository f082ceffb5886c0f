"""A changed config put into force while the daemon runs: new parts are built before old ones are dropped.

Whatever takes long (files, validation, databases, the pipeline) is done by a thread of its own, while the
loop goes on; `replacement` touches the bus and the endpoints, so the loop calls it, in one go.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from canest.bus.link import may_transmit
from canest.bus.protocols import Receiver
from canest.config.schema import Config
from canest.node.node import Node, join, rejoined
from canest.pipeline.pipeline import Pipeline
from canest.system.journal import Journal
from canest.system.systemd_notify import Notifier
from canest.telemetry.endpoints import Endpoints

#: sections of a config whose change means to leave the bus and join it anew
_BUS_SECTIONS = ("bus", "broadcast", "signals", "dbc")
#: those of them that say what is received
_RECEIVED_SECTIONS = ("bus", "signals", "dbc")
#: sections of a config whose change means to estimate anew, from the mass learned so far
_ESTIMATE_SECTIONS = (
    "bus", "dbc", "signals", "sampling", "vehicle", "effects", "filter", "gates", "estimator", "road_map",
)  # fmt: skip
#: a config that has not been read by then is refused; the largest database takes less
LONGEST_S = 120.0


@dataclass(frozen=True)
class Prepared:
    """A config that was read, the sections that have changed, the pipeline it asks for (None: the old)."""

    config: Config
    changed: frozenset[str]
    pipeline: Pipeline | None
    keeps_receiver: bool = False  #: what is received, and whether anything is sent, are the same

    @property
    def joins_anew(self) -> bool:
        """Return whether the daemon leaves the bus and joins it anew."""
        return not self.changed.isdisjoint(_BUS_SECTIONS)


@dataclass(frozen=True)
class Replacement:
    """The config in force from now on, and what it makes anew: None for what goes on as it is.

    joined: the node, and the receiver unless the old one goes on.
    """

    config: Config
    pipeline: Pipeline | None
    joined: tuple[Receiver | None, Node] | None


@dataclass
class _Attempt:
    """One reading of the config. outcome: None while the thread works."""

    end_s: float
    thread: threading.Thread | None = None
    outcome: Prepared | Exception | None = None


@dataclass
class ConfigReloader:
    """Reads the config in the background, one attempt at a time; counts, logs and notifies its outcome.

    read: reads the config (None: there is nothing to reload). accepted, refused: attempts by their outcome.
    refused_because: why the newest one was refused, '' when it was accepted.
    """

    read: Callable[[], Config] | None
    journal: Journal
    notifier: Notifier
    accepted: int = 0
    refused: int = 0
    refused_because: str = ""
    _attempt: _Attempt | None = None
    _timed_out: list[threading.Thread] = field(default_factory=list)

    @property
    def under_way(self) -> bool:
        """Return whether an attempt has begun whose outcome has not been fetched."""
        return self._attempt is not None

    def begin(self, old: Config, running: Pipeline, make: Callable[[Config], Pipeline], now_s: float) -> None:
        """Start to read the config and to build its pipeline. old, running: what is in force meanwhile.

        make: returns a new pipeline. Refused while an attempt that timed out still hangs.
        """
        read = self.read
        if read is None or self.under_way:
            return
        self.notifier.reloading()
        try:
            self._timed_out = [thread for thread in self._timed_out if thread.is_alive()]
            if self._timed_out:  # a thread for every signal would be more and more of them
                raise TimeoutError("the config of the reload before is still being read")  # noqa: TRY301
            self._start(lambda: prepare(old, read, running, make), now_s)
        except Exception as error:  # no thread to be had, or one that hangs
            self.refuse(error)

    def finished(self, now_s: float) -> Prepared | None:
        """Return the config once it is read, and refuse it if that failed; None while there is none."""
        outcome = self._outcome(now_s)
        if isinstance(outcome, Exception):
            self.refuse(outcome)
            return None
        return outcome

    def accept(self, config_name: str) -> None:
        """Report that the config is in force."""
        self.accepted += 1
        self.refused_because = ""
        self.journal.notice("reloaded", config=config_name)
        self.notifier.ready()

    def refuse(self, error: Exception) -> None:
        """Report that the config before stays in force."""
        self.refused += 1
        self.refused_because = str(error) or type(error).__name__
        self.journal.error("reload-refused", error=self.refused_because)
        self.notifier.ready()

    def wait(self, timeout_s: float) -> None:
        """Wait for the thread of an attempt (not for the loop: tests)."""
        if self._attempt is not None and self._attempt.thread is not None:
            self._attempt.thread.join(timeout_s)

    def _start(self, prepare_config: Callable[[], Prepared], now_s: float) -> None:
        attempt = _Attempt(now_s + LONGEST_S)

        def work() -> None:
            try:
                attempt.outcome = prepare_config()
            except Exception as error:  # whatever is wrong with the new config
                # its frames hold this attempt, and would keep it and the old pipeline for long
                attempt.outcome = error.with_traceback(None)

        attempt.thread = threading.Thread(target=work, name="canest-reload", daemon=True)
        self._attempt = attempt
        attempt.thread.start()

    def _outcome(self, now_s: float) -> Prepared | Exception | None:
        """Return the outcome of the attempt, an exception of any type if it failed, None while it goes on."""
        attempt = self._attempt
        if attempt is None or attempt.thread is None:
            return None
        if attempt.outcome is None and attempt.thread.is_alive():
            if now_s < attempt.end_s:
                return None
            self._timed_out.append(attempt.thread)
        self._attempt = None
        return attempt.outcome or TimeoutError(f"the config could not be read within {LONGEST_S:g} s")


def prepare(
    old: Config, read: Callable[[], Config], running: Pipeline, make: Callable[[Config], Pipeline]
) -> Prepared:
    """Read a config, and its databases, and build the pipeline that it asks for, beside the running one.

    Errors: whatever is wrong with the config, of any type.
    """
    config = read()
    changed = {part for part in Config.model_fields if getattr(config, part) != getattr(old, part)}
    if config.databases != running.decoder.databases:  # a file of the same name with other content
        changed.add("dbc")
    if config.road_map is not None and old.road is not None and config.road != old.road:  # likewise
        changed.add("road_map")
    new = None
    if not changed.isdisjoint(_ESTIMATE_SECTIONS):
        new = make(config)
    keeps_receiver = changed.isdisjoint(_RECEIVED_SECTIONS) and _sending(config) == _sending(old)
    return Prepared(config, frozenset(changed), new, keeps_receiver)


def _sending(config: Config) -> tuple[int, bool, bool]:
    """Return what of its sending decides how an interface is opened."""
    broadcast = config.broadcast
    return broadcast.pgn, broadcast.listen_only, may_transmit(config.bus, broadcast)


def replacement(
    prepared: Prepared, running: Pipeline, endpoints: Endpoints | None, node: Node
) -> Replacement:
    """Join the bus anew where that is needed, and move the endpoints, if there are any.

    node: the old one, whose transmitter the new one has where the receiver is kept: an adapter is not opened
    twice, and no frame is missed.
    Errors: whatever is wrong with the config, of any type; everything is as it was then.
    """
    config = prepared.config
    joined: tuple[Receiver | None, Node] | None = None
    if prepared.joins_anew and prepared.keeps_receiver:
        joined = None, rejoined(config, node)
    elif prepared.joins_anew:
        joined = join(config, (prepared.pipeline or running).decoder.can_filters())
    try:
        if endpoints is not None:
            endpoints.move(config)
    except Exception:
        if joined is not None and joined[0] is not None:
            joined[0].close()
        raise
    return Replacement(config, prepared.pipeline, joined)
