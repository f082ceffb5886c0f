"""Distance-based outlier detection and its recursive moments."""

from __future__ import annotations

import numpy as np
import pytest

from canest.estimators.papers.outliers import OutlierOptions, OutlierStage, RunningMoments, outliers
from canest.estimators.registry import create

from .synthetic import FACTS, drive, with_columns


def test_recursive_moments_are_numpys_and_centred():
    """2013, eq. 13 as printed averages Z'Z; for data far from zero that is no variance."""
    rows = np.random.default_rng(0).normal(100.0, 2.0, (500, 3))
    moments = RunningMoments(3)
    for row in rows:
        moments.add(row)
    np.testing.assert_allclose(moments.mean, rows.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(moments.std, rows.std(axis=0), rtol=1e-9)
    assert np.all(np.mean(rows**2, axis=0) > 1000 * moments.std**2)


def test_the_nested_loop_by_hand():
    rng = np.random.default_rng(1)
    scores = rng.normal(0, 1, (30, 2))
    expected = []
    for i in range(30):
        near = sum(np.hypot(*(scores[i] - scores[j])) <= 1.0 for j in range(30) if j != i)
        expected.append(near < 3)
    np.testing.assert_array_equal(outliers(scores, 1.0, 3), expected)


def test_spikes_are_dropped_and_good_rows_kept():
    rng = np.random.default_rng(2)
    rows = rng.normal(0.0, 1.0, (500, 2))
    spikes = rng.choice(500, 20, replace=False)
    rows[spikes] += 15.0 * rng.choice([-1.0, 1.0], (20, 2)) * rng.uniform(1.0, 3.0, (20, 2))
    stage = OutlierStage(OutlierOptions(batch=25, distance=1.5, neighbours=2), 2)
    _, kept = stage(np.arange(500), rows)
    assert np.abs(kept).max() < 10.0
    assert 20 <= stage.dropped < 60


def test_rows_come_out_when_their_batch_is_full():
    stage = OutlierStage(OutlierOptions(batch=10), 1)
    at, _ = stage(np.arange(9), np.zeros((9, 1)))
    assert len(at) == 0
    at, rows = stage(np.array([4]), np.zeros((1, 1)))
    assert at.tolist() == [4] * 10
    assert len(rows) == 10


@pytest.mark.parametrize("name", ["rls", "rlsmf", "gtls"])
def test_detection_protects_an_estimator(name):
    d = drive(120.0, noise_mps2=0.01, pulse_s=1.0)
    rng = np.random.default_rng(3)
    spoiled = d.block.accel_mps2.copy()
    hit = rng.choice(len(spoiled), 120, replace=False)
    spoiled[hit] += rng.choice([-8.0, 8.0], 120)
    block = with_columns(d.block, accel_mps2=spoiled)
    plain = create(name, FACTS, {}).update(block)
    guarded = create(name, FACTS, {"outliers": {"batch": 25, "distance": 1.0, "neighbours": 2}}).update(block)
    error = [np.sqrt(np.mean((r.mass_kg[2000:] / d.mass_kg - 1) ** 2)) for r in (plain, guarded)]
    assert error[1] < 0.6 * error[0]
