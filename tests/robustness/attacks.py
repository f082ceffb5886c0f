"""Attack frames, and a drive to mix them into."""

from __future__ import annotations

import numpy as np

from canest.core.frames import EXTENDED, FrameBlock
from canest.core.samples import Status
from canest.decode import j1939
from canest.logs.format_detection import open_log
from canest.pipeline.pipeline import Pipeline

#: full load of a 500 kbit/s bus, with frames that carry few bytes
FULL_LOAD_PER_S = 8000
MINUTE_S = 60.0


def merged(*blocks: FrameBlock) -> FrameBlock:
    """Join blocks in order of time; of equal stamps the earlier block's come first."""
    all_frames = FrameBlock.concatenate(list(blocks))
    return all_frames[np.argsort(all_frames.t_us, kind="stable")]


def noise(rng, ids, count, begin_us, seconds=MINUTE_S) -> FrameBlock:
    """Random payloads under the given identifiers (flags included), at random times."""
    t_us = np.sort(rng.integers(begin_us, begin_us + round(seconds * 1e6), count))
    length = rng.choice(np.array([8, 8, 8, 8, 8, 0, 3, 7], np.uint8), count)
    mask = np.array([(1 << 8 * n) - 1 for n in range(9)], np.uint64)
    data = rng.integers(0, 1 << 64, count, dtype=np.uint64) & mask[length]
    return FrameBlock(t_us, rng.choice(np.asarray(ids, np.uint32), count), length, data)


def identifiers(pipeline: Pipeline, frames: FrameBlock) -> tuple[list[int], list[int]]:
    """Return the identifiers on the bus that the config uses, and their groups from every other address."""
    pipeline.push(frames[: len(frames) // 10])
    senders = {key for key, s in pipeline.decoder.counters.senders.items() if s.used}
    addresses = {source for _, source in senders}
    senders |= {(pgn, source) for pgn in (j1939.TP_CM_PGN, j1939.TP_DT_PGN) for source in addresses}
    right = [i for i in np.unique(frames.can_id).tolist() if (j1939.pgn_of(i), j1939.source_of(i)) in senders]
    used = {(j1939.pgn_of(i), j1939.source_of(i)) for i in right}
    wrong = [
        (i & ~0xFF) | source for i in right for source in range(255) if (j1939.pgn_of(i), source) not in used
    ]
    return right, wrong


def attack_frames(path, pgn: int, begin_us: int) -> FrameBlock:
    """Return the frames of one group of a real log, moved to another time."""
    frames = FrameBlock.concatenate(list(open_log(path)))
    rows = [j1939.pgn_of(i) == pgn and bool(i & EXTENDED) for i in frames.can_id.tolist()]
    found = frames[np.array(rows)]
    return FrameBlock(found.t_us - frames.t_us[0] + begin_us, found.can_id, found.length, found.data)


def estimated(config, frames: FrameBlock):
    """Return the pipeline after all frames, and its estimates."""
    pipeline = Pipeline(config)
    return pipeline, pipeline.push(frames)


def deviation_pct(clean, attacked) -> float:
    """Return the largest change of a valid mass in per cent; both must have the same ticks."""
    assert np.array_equal(clean.t_us, attacked.t_us)
    valid = clean.status == Status.VALID
    assert valid.any()
    return float(np.abs(attacked.mass_kg[valid] / clean.mass_kg[valid] - 1.0).max() * 100.0)


def assert_sane(config, estimates) -> None:
    """No estimate that no vehicle can have."""
    numbers = ("mass_kg", "mass_std_kg", "grade", "grade_std")
    valid = estimates.status == Status.VALID
    for name in numbers:
        assert np.isfinite(getattr(estimates, name)[valid]).all(), name
    mass = estimates.mass_kg[np.isfinite(estimates.mass_kg)]
    low, high = config.vehicle.mass_min_kg, config.vehicle.mass_max_kg
    assert ((mass >= low * (1 - 1e-9)) & (mass <= high * (1 + 1e-9))).all()
    assert not (estimates.mass_std_kg < 0).any()
    assert not (estimates.grade_std < 0).any()
