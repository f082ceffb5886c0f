"""The pipeline's left end: wanted frames (or table rows) in, monotone stretches of decoded samples out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from canest.config.schema import Config, Source
from canest.core.frames import FloatColumn, FrameBlock, IntColumn
from canest.core.roles import LASTING, ROLES
from canest.grid.clock import Clock, Stretch
from canest.grid.grid import FOREVER_US, Channel, Feed, Grid
from canest.pipeline.signal_map import decoder_for
from canest.vehicle.model import effects_of
from canest.vehicle.range_rate_check import DOUBT_S, JUMP, MOTION_JUMP, Screen, limits_of
from canest.vehicle.role_sources import motion_roles

#: roles that the effect `torque_delay` finds late
TORQUE_ROLES = ("engine_torque_pct", "engine_torque", "engine_friction_pct", "retarder_torque_pct")
#: staleness limit of a signal that only an effect knows
EFFECT_SIGNAL_STALE_S = 5.0


class Intake:
    """Selects, puts in time order, decodes, refuses jumps; carries the state of all that."""

    def __init__(self, config: Config) -> None:
        self.decoder = decoder_for(config)
        self.clock = Clock(hold_us(config), round(config.sampling.max_backward_s * 1e6))
        self.screen = Screen(limits_of(config), motion_roles(config))
        self.heard: set[str] = set()  #: roles that have had a value

    def frames(self, block: FrameBlock) -> Iterator[Feed]:
        """Yield the stretches of a block of frames."""
        for stretch in self.clock.split(self.decoder.select(block)):
            t_us = stretch.frames.t_us
            samples = self.decoder.decode(stretch.frames).samples
            yield self._feed(samples, stretch, t_us)

    def table(self, samples: Mapping[str, tuple[IntColumn, FloatColumn]], t_us: IntColumn) -> Iterator[Feed]:
        """Yield the stretches of table rows: ``t_us`` of every row, and one value per row and role."""
        nothing = np.zeros(len(t_us), np.uint32)
        rows = FrameBlock(t_us, nothing, nothing.astype(np.uint8), np.arange(len(t_us), dtype=np.uint64))
        for stretch in self.clock.split(rows):
            stamps, at = stretch.frames.t_us, stretch.frames.data.astype(np.int64)
            # minus zero becomes zero: equal values are then equal bits, which the grid relies on
            part = {role: (stamps, value[at] + 0.0) for role, (_, value) in samples.items()}
            yield self._feed(part, stretch, stamps)

    def _feed(
        self, samples: Mapping[str, tuple[IntColumn, FloatColumn]], stretch: Stretch, t_us: IntColumn
    ) -> Feed:
        if stretch.jump == "back":
            self.screen.restart()
        kept = self.screen.apply(samples)
        self.heard.update(r for r in kept.keys() - self.heard if np.isfinite(kept[r][1]).any())
        for role in LASTING & kept.keys():
            stamps, values = kept[role]
            known = np.isfinite(values)
            if not known.all():
                kept[role] = stamps[known], values[known]
        return Feed(kept, stretch.jump, stretch.before_us, int(t_us[0]), int(t_us[-1]))


def hold_us(config: Config) -> int:
    """Return how long ticks go on after the last wanted frame."""
    return round(config.sampling.hold_s * 1e6)


def stale_limit_s(role: str, source: Source) -> float:
    """Return how old a sample of a role may be."""
    if source.stale_s is not None:
        return source.stale_s
    return ROLES[role].stale_s if role in ROLES else EFFECT_SIGNAL_STALE_S


def grid_for(config: Config) -> Grid:
    """Return the grid of a config: the signal map with its delays and staleness limits."""
    late_s = sum(float(getattr(e, "delay_s", 0.0)) for e in effects_of(config) if e.stage == "sampling")
    channels = []
    for role, source in config.signals.items():
        stale_us = round(min(stale_limit_s(role, source) * 1e6, FOREVER_US))
        delay_s = source.delay_s + (late_s if role in TORQUE_ROLES else 0.0)
        channels.append(Channel(role, round(delay_s * 1e6), stale_us))
    channels += [Channel(name, 0, round(DOUBT_S * 1e6)) for name in (JUMP, MOTION_JUMP)]
    return Grid(channels, hold_us(config))
