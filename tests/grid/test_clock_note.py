"""What a user reads of a clock that was set back: how often, and how far."""

from __future__ import annotations

from canest.config import load_config
from canest.core.frames import EXTENDED, FrameBlock
from canest.doctor.warnings import stream_warnings
from canest.pipeline.pipeline import Pipeline


def test_a_clock_set_back_is_noted_with_how_far() -> None:
    """Two days in the wrong order are one step back by 24 hours."""
    pipeline = Pipeline(load_config("class8"))
    day_us = 86_400_000_000
    for start_us in (10 * day_us, 9 * day_us):
        pipeline.push(
            FrameBlock.from_frames(
                [(start_us + 10_000 * i, EXTENDED | 0x0CF00400, bytes(8)) for i in range(400)]
            )
        )
    (note,) = [each for each in stream_warnings(pipeline.intake) if each.startswith("time stamps")]
    assert "1 clock set back by 86,404.0 s at most: is it one log, in order?" in note
