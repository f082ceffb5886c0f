"""Shared by the decoder's tests: the shipped databases, bundled logs as blocks, comparison of results."""

from __future__ import annotations

import itertools
import lzma
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from canest.config.database_files import read_database
from canest.core.frames import EXTENDED, FrameBlock
from canest.decode import Decoder, Want
from canest.system.shipped_files import shipped

DATA = Path(__file__).resolve().parents[1] / "data"
SCREEN = re.compile(r"\((\d+)\.(\d{6})\)\s+\S+\s+([0-9A-F]+)\s+\[\d+\]\s*([0-9A-F ]*)")
LOG = re.compile(r"\((\d+)\.(\d{6})\)\s+\S+\s+([0-9A-F]+)#([0-9A-F]*)")


def shipped_database(name: str = "j1939"):
    return read_database(shipped("dbc") / f"{name}.dbc")


@cache
def frames_of_log(name: str) -> tuple[tuple[int, int, bytes], ...]:
    """Frames of a bundled log, read by a few lines that share nothing with canest's reader."""
    frames = []
    with lzma.open(DATA / name, "rt") as file:
        for line in file:
            match = SCREEN.search(line) or LOG.search(line)
            if match:
                seconds, micros, can_id, payload = match.groups()
                flag = EXTENDED if len(can_id) == 8 else 0
                frames.append(
                    (int(seconds) * 1_000_000 + int(micros), int(can_id, 16) | flag, bytes.fromhex(payload))
                )
    return tuple(frames)


def block_of_log(name: str) -> FrameBlock:
    return FrameBlock.from_frames(list(frames_of_log(name)))


def wants(*entries: tuple) -> dict[str, Want]:
    """Build wants from (role, message, signal, source, validity) tuples; the last two may be missing."""
    return {e[0]: Want(*e) for e in entries}


def decoder(*entries: tuple, database: str = "j1939") -> Decoder:
    return Decoder(wants(*entries), [shipped_database(database)])


def push_cut(decoder: Decoder, block: FrameBlock, cuts: Iterable[int]):
    """Push a block in pieces; return role -> (stamps, values) joined over the pieces, and the last end."""
    edges = [0, *sorted(cuts), len(block)]
    parts: dict[str, list] = {}
    end_us = None
    for start, end in itertools.pairwise(edges):
        result = decoder.push(block[start:end])
        end_us = result.end_us if result.end_us is not None else end_us
        for role, columns in result.samples.items():
            parts.setdefault(role, []).append(columns)
    return {r: tuple(np.concatenate(c) for c in zip(*p, strict=True)) for r, p in parts.items()}, end_us


def assert_same_samples(one: Mapping, other: Mapping) -> None:
    """Equal to the last bit, NaN included."""
    assert one.keys() == other.keys()
    for role in one:
        assert one[role][0].dtype == other[role][0].dtype == np.int64
        assert one[role][1].dtype == other[role][1].dtype == np.float64
        assert np.array_equal(one[role][0], other[role][0]), role
        assert one[role][1].tobytes() == other[role][1].tobytes(), role
