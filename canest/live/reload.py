"""A changed config taken over while the daemon runs: all that it makes anew is built before any is let go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from canest.bus.link import Receiver
from canest.config.schema import Config
from canest.node.node import Node, join
from canest.pipeline.pipeline import Listener, Pipeline
from canest.pipeline.signal_map import databases_of
from canest.telemetry.endpoints import Doors

#: sections of a config whose change means to leave the bus and join it anew
_MAKES_THE_BUS = ("bus", "broadcast", "signals", "dbc")
#: sections of a config whose change means to estimate anew, from the mass learned so far
_MAKES_THE_ESTIMATE = (
    "bus", "dbc", "signals", "sampling", "vehicle", "effects", "filter", "gates", "estimator",
)  # fmt: skip


@dataclass(frozen=True)
class Renewed:
    """The config in force from now on, and what it makes anew: None for what goes on as it is."""

    config: Config
    pipeline: Pipeline | None
    joined: tuple[Receiver, Node] | None


def renew(
    old: Config, read: Callable[[], Config], pipeline: Pipeline, listener: Listener, doors: Doors | None
) -> Renewed:
    """Read a config and build what it asks for beside what runs; the doors follow it, if there are any.

    old, pipeline: what runs now. listener: of a new pipeline.
    Errors: whatever is wrong with the config, of any type; everything is as it was then.
    """
    config = read()
    changed = {part for part in Config.model_fields if getattr(config, part) != getattr(old, part)}
    if databases_of(config) != pipeline.decoder.databases:  # a file of the same name with other content
        changed.add("dbc")
    following = None
    if not changed.isdisjoint(_MAKES_THE_ESTIMATE):
        following = Pipeline(config, listener=listener)
    joined = None
    if not changed.isdisjoint(_MAKES_THE_BUS):
        joined = join(config, (following or pipeline).decoder.can_filters())
    try:
        if doors is not None:
            doors.follow(config)
    except Exception:
        if joined is not None:
            joined[0].close()
        raise
    return Renewed(config, following, joined)
