"""The force residual of a leg: means over seconds without a closed gate, whatever the cut of the blocks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from canest.core.samples import GRAVITY_MPS2
from canest.fleet.recording import OPEN_SECONDS, _OpenSeconds


class Columns:
    """Columns of samples and estimates, as the pipeline hands them on."""

    def __init__(self, **columns: np.ndarray) -> None:
        self.__dict__.update(columns)

    def part(self, first: int, end: int) -> Columns:
        return Columns(**{name: column[first:end] for name, column in self.__dict__.items()})


def drive(seconds: int = 30, start_us: int = 1_700_000_000_480_000) -> Columns:
    """Return a drive whose force comes 0.2 s after the torque that is reported; 10 t, no losses."""
    n = 50 * seconds
    t_us = start_us + 20_000 * np.arange(n)
    t = np.arange(n) / 50
    force = 20_000 * np.sin(2 * np.pi * t / 1.7) + 20_000
    return Columns(
        t_us=t_us, traction_N=force, force_N=force, accel_mps2=np.roll(force, 10) / 10_000,
        mu=np.zeros(n), grade=np.zeros(n), gate=np.zeros(n, np.uint8),
    )  # fmt: skip


def means(columns: Columns, cuts: list[int]) -> dict[str, np.ndarray]:
    taken = _OpenSeconds()
    edges = [0, *cuts, len(columns.t_us)]
    for first, end in pairwise(edges):
        taken.add(columns.part(first, end), columns.part(first, end))
    return {name: np.concatenate(taken.rows[name]) for name in OPEN_SECONDS}


@pytest.mark.parametrize("cuts", [[1], [7, 8, 9, 60], [50], [26, 76], list(range(1, 1500))])
def test_the_cut_of_the_blocks_changes_no_bit(cuts):
    whole, cut = means(drive(), []), means(drive(), cuts)
    for name in OPEN_SECONDS:
        assert np.array_equal(whole[name], cut[name], equal_nan=True)


def test_only_whole_seconds_count_and_those_with_a_closed_gate_are_unknown():
    columns = drive()
    columns.gate[100] = 3
    found = means(columns, [])
    assert len(found["passed_us"]) == 29  # it begins 0.48 s after a second, and the last one is not over
    assert np.array_equal(found["passed_us"] % 1_000_000, np.full(29, 980_000))
    assert np.flatnonzero(np.isnan(found["force_N"])).tolist() == [1]


def share(needed_mps2: np.ndarray, force_N: np.ndarray) -> float:
    """Return the share of the force that the motion of 10 t shows too much."""
    return (10_000 * needed_mps2 - force_N) @ force_N / (force_N @ force_N)


def test_a_delay_of_the_torque_is_hardly_missing_traction():
    columns, found = drive(60), means(drive(60), [])
    single = share(columns.accel_mps2[26::50], columns.force_N[26::50])
    assert single < -0.07
    assert single / 2 < share(found["needed_mps2"], found["force_N"]) < 0.0


def test_the_slope_counts_as_the_mass_that_it_takes():
    columns = drive()
    columns.grade[:] = 0.05
    flat, steep = means(drive(), []), means(columns, [])
    assert steep["needed_mps2"] - flat["needed_mps2"] == pytest.approx(
        GRAVITY_MPS2 * 0.05 / np.sqrt(1 + 0.05**2)
    )
