"""A changed config taken over while the daemon runs: all that it makes anew is built before any is let go.

Whatever takes long (files, validation, databases, the pipeline) is done by a thread of its own, while the
loop goes on; what touches the bus and the endpoints is done by the loop, in one go.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from canest.bus.protocols import Receiver
from canest.config.schema import Config
from canest.node.node import Node, join
from canest.pipeline.pipeline import Listener, Pipeline
from canest.pipeline.signal_map import databases_of
from canest.telemetry.endpoints import Endpoints

#: sections of a config whose change means to leave the bus and join it anew
_MAKES_THE_BUS = ("bus", "broadcast", "signals", "dbc")
#: sections of a config whose change means to estimate anew, from the mass learned so far
_MAKES_THE_ESTIMATE = (
    "bus", "dbc", "signals", "sampling", "vehicle", "effects", "filter", "gates", "estimator",
)  # fmt: skip
#: a config that has not been read by then is refused; the largest database takes less
LONGEST_S = 120.0


@dataclass(frozen=True)
class Prepared:
    """A config that was read, the sections that have changed, the pipeline it asks for (None: the old)."""

    config: Config
    changed: frozenset[str]
    pipeline: Pipeline | None


@dataclass(frozen=True)
class Replacement:
    """The config in force from now on, and what it makes anew: None for what goes on as it is."""

    config: Config
    pipeline: Pipeline | None
    joined: tuple[Receiver, Node] | None


@dataclass
class _Attempt:
    """One reading of the config. outcome: None while the thread works."""

    end_s: float
    thread: threading.Thread | None = None
    outcome: Prepared | Exception | None = None


@dataclass
class ConfigReloader:
    """Reads the config in the background, one attempt at a time, and counts what came of it.

    read: reads the config (None: there is nothing to reload). taken, refused: attempts by their outcome.
    refused_because: why the newest one was refused, '' when it was taken.
    """

    read: Callable[[], Config] | None
    taken: int = 0
    refused: int = 0
    refused_because: str = ""
    _attempt: _Attempt | None = None
    _given_up: list[threading.Thread] = field(default_factory=list)

    @property
    def under_way(self) -> bool:
        """Return whether an attempt has begun whose outcome nobody has taken yet."""
        return self._attempt is not None

    def begin(self, old: Config, running: Pipeline, listener: Listener, now_s: float) -> None:
        """Start to read the config and to build its pipeline. old, running: what is in force meanwhile.

        listener: of a new pipeline. Errors: TimeoutError while an attempt that was given up still hangs.
        """
        read = self.read
        if read is None or self.under_way:
            return
        self._given_up = [thread for thread in self._given_up if thread.is_alive()]
        if self._given_up:  # a thread for every signal would be more and more of them
            raise TimeoutError("the config of the reload before is still being read")
        attempt = _Attempt(now_s + LONGEST_S)

        def work() -> None:
            try:
                attempt.outcome = prepare(old, read, running, listener)
            except Exception as error:  # whatever is wrong with the new config
                # its frames hold this attempt, and would keep it and the old pipeline for long
                attempt.outcome = error.with_traceback(None)

        attempt.thread = threading.Thread(target=work, name="canest-reload", daemon=True)
        self._attempt = attempt
        attempt.thread.start()

    def outcome(self, now_s: float) -> Prepared | Exception | None:
        """Return what the attempt has come to, None while it goes on.

        An exception, of any type, is what is wrong with the config; a TimeoutError that it took too long.
        """
        attempt = self._attempt
        if attempt is None or attempt.thread is None:
            return None
        if attempt.outcome is None and attempt.thread.is_alive():
            if now_s < attempt.end_s:
                return None
            self._given_up.append(attempt.thread)
        self._attempt = None
        return attempt.outcome or TimeoutError(f"the config could not be read within {LONGEST_S:g} s")

    def note(self, refused_because: str) -> None:
        """Count an attempt: '' when it was taken."""
        self.refused_because = refused_because
        if refused_because:
            self.refused += 1
        else:
            self.taken += 1

    def wait(self, timeout_s: float) -> None:
        """Wait for the thread of an attempt (not for the loop: tests)."""
        if self._attempt is not None and self._attempt.thread is not None:
            self._attempt.thread.join(timeout_s)


def prepare(old: Config, read: Callable[[], Config], running: Pipeline, listener: Listener) -> Prepared:
    """Read a config, and its databases, and build the pipeline that it asks for, beside what runs.

    Errors: whatever is wrong with the config, of any type.
    """
    config = read()
    changed = {part for part in Config.model_fields if getattr(config, part) != getattr(old, part)}
    if databases_of(config) != running.decoder.databases:  # a file of the same name with other content
        changed.add("dbc")
    following = None
    if not changed.isdisjoint(_MAKES_THE_ESTIMATE):
        following = Pipeline(config, listener=listener)
    return Prepared(config, frozenset(changed), following)


def renew(prepared: Prepared, running: Pipeline, endpoints: Endpoints | None) -> Replacement:
    """Join the bus anew where that is needed, and let the endpoints follow, if there are any.

    Errors: whatever is wrong with the config, of any type; everything is as it was then.
    """
    config, joined = prepared.config, None
    if not prepared.changed.isdisjoint(_MAKES_THE_BUS):
        joined = join(config, (prepared.pipeline or running).decoder.can_filters())
    try:
        if endpoints is not None:
            endpoints.follow(config)
    except Exception:
        if joined is not None:
            joined[0].close()
        raise
    return Replacement(config, prepared.pipeline, joined)
