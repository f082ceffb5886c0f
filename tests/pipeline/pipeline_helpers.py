"""Shared by the pipeline's tests: a small bus with chosen signals, streams with faults, results as bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from canest.config.database_files import read_database
from canest.core.estimates import Estimates
from canest.core.frames import EXTENDED, FrameBlock
from canest.logs import open_log
from canest.pipeline.pipeline import Pipeline
from canest.system.shipped_files import shipped

DATA = Path(__file__).resolve().parents[1] / "data"

#: message -> (source address, period in ms); what a class-8 truck sends (configs/class8.yaml)
SCHEDULE = {
    "EEC1": (0x00, 20),
    "ETC1": (0x03, 10),
    "VDC2": (0x0B, 20),
    "EEC2": (0x00, 50),
    "CCVS1": (0x00, 100),
    "EBC1": (0x0B, 100),
    "EBC2": (0x0B, 100),
    "ETC2": (0x03, 100),
    "ERC1": (0x0F, 100),
    "EEC3": (0x00, 250),
    "AMB": (0x00, 1000),
}
Value = float | Callable[[float], float | None] | None


@cache
def bundled(name: str) -> FrameBlock:
    return FrameBlock.concatenate([b for b in open_log(DATA / name) if isinstance(b, FrameBlock)])


def bus(
    seconds: float, signals: dict[str, Value], start_s: float = 1000.0, silent: Iterable[str] = ()
) -> FrameBlock:
    """Frames of `SCHEDULE`; a signal is a number or a function of time, all others say "not available".

    Names in ``silent`` are not sent. Encoded here, bit by bit, from the DBC's start, length, scale, offset.
    """
    database = read_database(shipped("dbc") / "j1939.dbc")
    frames = []
    for name, (source, period_ms) in SCHEDULE.items():
        if name in silent:
            continue
        message = database.get_message_by_name(name)
        can_id = (message.frame_id & 0x1FFFFF00) | source | EXTENDED
        for k in range(round(seconds * 1000 / period_ms)):
            now = k * period_ms / 1000
            word = (1 << 64) - 1
            for s in message.signals:
                value = signals.get(s.name)
                value = value(now) if callable(value) else value
                if value is not None:
                    raw = round((value - s.offset) / s.scale)
                    word = word & ~(((1 << s.length) - 1) << s.start) | raw << s.start
            # every message has its own phase, so that no two frames share a stamp
            stamp = round((start_s + now) * 1e6) + 137 * len(name) + 11 * source + period_ms
            frames.append((stamp, can_id, word.to_bytes(8, "little")))
    return FrameBlock.from_frames(sorted(frames))


class Recorder:
    """A listener that keeps everything the pipeline says, to the bit."""

    def __init__(self) -> None:
        self.parts: list[tuple[object, object]] = []

    def __call__(self, samples: object, estimates: object) -> None:
        self.parts.append((samples, estimates))

    def columns(self) -> dict[str, bytes]:
        kept = {}
        for side in (0, 1):
            for f in fields(self.parts[0][side]) if self.parts else ():  # type: ignore[arg-type]
                columns = [getattr(p[side], f.name) for p in self.parts]
                # None: a column of a road map, without one
                whole = b"" if columns[0] is None else np.concatenate(columns).tobytes()
                kept[f"{side} {f.name}"] = whole
        return kept


def everything(pipeline: Pipeline, recorder: Recorder, estimates: list[Estimates]) -> dict[str, object]:
    """What a run gave: model samples, estimates, gates, counters."""
    joined = Estimates.concatenate(estimates)
    results: dict[str, object] = {f.name: getattr(joined, f.name).tobytes() for f in fields(Estimates)}
    results |= recorder.columns()
    results |= {
        "gates": pipeline.gate_counts,
        "samples": pipeline.samples,
        "clock": pipeline.clock.counters,
        "snapshot": repr(pipeline.snapshot()),
    }
    return results


def run(config: object, frames: FrameBlock, cuts: Iterable[int] = ()) -> dict[str, object]:
    """Push frames cut at ``cuts`` (indices)."""
    recorder = Recorder()
    pipeline = Pipeline(config, listener=recorder)  # type: ignore[arg-type]
    edges = [0, *sorted(cuts), len(frames)]
    done = [pipeline.push(frames[a:b]) for a, b in pairwise(edges)]
    return everything(pipeline, recorder, [*done, pipeline.finish()])


def differences(one: dict[str, object], other: dict[str, object]) -> list[str]:
    assert one.keys() == other.keys()
    return [name for name in one if one[name] != other[name]]
