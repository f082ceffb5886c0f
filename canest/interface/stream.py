"""The pipeline as a program that has frames of its own holds it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from canest.core.errors import UsageError
from canest.core.frames import FrameBlock
from canest.interface.estimates import Estimates, estimates_of
from canest.interface.inputs import config_of, require_number
from canest.pipeline import pipeline as inner

if TYPE_CHECKING:
    from canest.config import Config

#: the inverse of a smaller variance means nothing
_LEAST_STD_KG = 1e-3


class Pipeline:
    """Frames in, estimates out, for one vehicle: what `canest run` and `canest replay` are made of.

    It knows no socket, file, wall clock or thread. Blocks of any length give the same bits.

    Args:
        config: a config, its path, or the name of a shipped one.

    Errors: ConfigError.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> pipeline = canest.Pipeline(drive.config)
        >>> first = pipeline.push(drive.frames[:50_000])
        >>> rest = pipeline.push(drive.frames[50_000:])
        >>> len(first) + len(rest) + len(pipeline.finish()) == pipeline.samples
        True
        >>> again = canest.Pipeline(drive.config)
        >>> if saved := pipeline.snapshot():
        ...     again.restore(**saved)
    """

    def __init__(self, config: Config | str | Path) -> None:
        used = config_of(config)
        self._inner, self._vehicle = inner.Pipeline(used), used.vehicle

    @property
    def samples(self) -> int:
        """How many 50 Hz samples there were so far."""
        return self._inner.samples

    @property
    def gate_counts(self) -> dict[str, int]:
        """How many of them each gate refused, by the gate's name."""
        return self._inner.gate_counts

    def push(self, frames: FrameBlock) -> Estimates:
        """Take the next frames, in order of arrival; return the estimates that they complete (0 or more).

        Errors: UsageError for what is no `FrameBlock`; `FrameBlock.from_messages` takes python-can's.
        """
        if not isinstance(frames, FrameBlock):
            found, expected = type(frames).__name__, "a FrameBlock, as of FrameBlock.from_messages"
            raise UsageError("no frames", where="push", found=found, expected=expected)
        return estimates_of(self._inner.push(frames))

    def advance_to(self, t_s: float) -> Estimates:
        """Return the samples before a time of the frames' clock, in s, though the bus may be quiet.

        Errors: UsageError for what is no time.
        """
        require_number("t_s", t_s, -math.inf, "s ")
        return estimates_of(self._inner.advance_to(round(t_s * 1e6)))

    def finish(self) -> Estimates:
        """Return the samples that were waiting for a later frame, at the end of a log."""
        return estimates_of(self._inner.finish())

    def snapshot(self) -> dict[str, float]:
        """Return what `restore` takes after a restart: mass_kg and mass_std_kg; {} while no mass is known."""
        kept = self._inner.snapshot()
        if not kept or not kept.get("learned", True):
            return {}
        v = self._vehicle
        mass_kg = min(max(kept["mass_kg"], v.mass_min_kg), v.mass_max_kg)  # or rounding were beyond
        return {"mass_kg": mass_kg, "mass_std_kg": kept["mass_std_kg"]}

    def restore(self, mass_kg: float, mass_std_kg: float, unseen_s: float = 0.0) -> None:
        """Start from a saved mass and its standard deviation, both in kg.

        unseen_s: time since then in which the load may have changed and nobody saw it (0: none).
        Errors: UsageError for a mass beyond the vehicle's bounds, and what is no standard deviation or time.
        """
        require_number("mass_kg", mass_kg, self._vehicle.mass_min_kg, "kg ", self._vehicle.mass_max_kg)
        require_number("mass_std_kg", mass_std_kg, _LEAST_STD_KG, "kg ")
        require_number("unseen_s", unseen_s, 0.0, "s ")
        self._inner.restore(mass_kg, mass_std_kg, unseen_s)
