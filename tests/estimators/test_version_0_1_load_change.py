"""After a long stop: mostly the same load, sometimes another; the likelier one is reported."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.canest_0_1 import states as at
from canest.estimators.canest_0_1.recall import ANOTHER, LITTLE, compare, give_mass, refute, remember

from .momentum import flat, hills, pulses, trip
from .test_version_0_1_drives import run

ANY = 3e-5  # std of the inverse mass when nothing is known


def memory_of(u, std, **slots):
    memory = [0.0] * at.MEMORY
    memory[at.HELD_U], memory[at.GIVEN_VAR], memory[at.LEARNED] = u, std**2, 1.0
    memory[at.EFFORT] = 100.0
    for name, value in slots.items():
        memory[getattr(at, name)] = value
    return memory


def compared(before, before_std, u, std):
    """Return what is given out (mean, std) where `before` was known and `u` has been found since."""
    memory = memory_of(before, before_std)
    remember(memory)
    memory[at.HELD_U] = u  # as `blend` does
    row = [0.0] * at.OUTPUTS
    row[at.OUT_U_VAR] = std**2
    memory[at.EFFORT] = 1e9  # all is told
    give_mass(memory, row, u, True, ANY**2)
    return row[at.OUT_U], np.sqrt(row[at.OUT_U_VAR])


def by_numbers(before, before_std, u, std):
    """The same by brute force: posterior odds, and the mean if the load is the same, on a grid."""
    x = np.linspace(-20e-5, 30e-5, 400_001)

    def normal(mean, s):
        return np.exp(-0.5 * ((x - mean) / s) ** 2) / s

    same_std = np.hypot(before_std, LITTLE * before)
    found = normal(u, std)  # since the stop, when nothing was known
    another = normal(before, np.hypot(min(ANY, ANOTHER * before), same_std)) * found
    same = normal(before, same_std) * found
    return same.sum() / another.sum(), (x * same).sum() / same.sum()


@pytest.mark.parametrize("std", [0.4e-6, 1e-6, 3e-6, 8e-6])
@pytest.mark.parametrize("apart", [0.0, 1e-6, -4e-6, 9e-6, -2e-5])
def test_the_likelier_load_is_reported(std, apart):
    before, before_std = 5e-5, 1e-6
    odds, joint = by_numbers(before, before_std, before + apart, std)
    given, given_std = compared(before, before_std, before + apart, std)
    expected = [joint] if odds > 1.1 else [before + apart] if odds < 0.9 else [joint, before + apart]
    assert any(given == pytest.approx(mean, rel=1e-3) for mean in expected)
    # the truth may be either: both lie within what is in doubt
    for mean, share in ((joint, odds / (1 + odds)), (before + apart, 1 / (1 + odds))):
        assert given_std**2 >= 0.9 * share * (mean - given) ** 2


@pytest.mark.parametrize("std", [1e-7, 1e-5, 5e-4, 1e-2])
@pytest.mark.parametrize("u", [1 / 60_000, 1 / 700, 1 / 2])
def test_of_a_vehicle_of_any_weight_it_gives_a_number(u, std):
    """Found far from the load before, with less known of it than of any load."""
    given, given_std = compared(1 / 38_000, 3e-7, u, std)
    assert min(u, 1 / 38_000) <= given <= max(u, 1 / 38_000)
    assert 0.0 < given_std <= 2.0 * np.hypot(std, abs(u - 1 / 38_000))


def test_without_an_earlier_load_nothing_is_compared():
    memory = memory_of(5e-5, 1e-6, LEARNED=0.0, LEFT=1.0)
    remember(memory)
    compare(memory, 6e-5, 1e-12, ANY**2)
    assert memory[at.HELD_U] == 5e-5
    memory = memory_of(5e-5, 1e-6)
    remember(memory)
    refute(memory)
    compare(memory, 6e-5, 1e-12, ANY**2)
    assert memory[at.HELD_U] == 5e-5
    assert memory[at.LEFT] == 1.0


def test_a_second_stop_before_any_driving_leaves_the_load_as_it_was_known():
    memory = memory_of(5e-5, 1e-6)
    remember(memory)
    known = memory[at.SAME_VAR]
    memory[at.GIVEN_VAR] = 1e-9  # the filter has opened it
    remember(memory)
    assert memory[at.SAME_VAR] == known


STOP = [(70.0, 110.0)]


@pytest.mark.parametrize(
    ("road", "load_kg"),
    [(flat, 9_000.0), (flat, 21_000.0), (flat, 36_000.0), (hills, 9_000.0), (hills, 15_000.0)],
)
def test_the_same_load_is_soon_known_again(road, load_kg):
    drive = trip(170, mass_kg=load_kg, road=road, throttle=pulses, stops=STOP)
    _, e = run(drive)
    standing = slice(105 * 50, 110 * 50)
    assert (e.status[standing] == Status.CONVERGING).all()
    moving = drive.block.speed_mps > 2.0
    again = np.flatnonzero((e.status == Status.VALID) & (np.arange(len(moving)) > 110 * 50))
    assert len(again)
    assert np.count_nonzero(moving[110 * 50 : again[0]]) < 25 * 50
    assert np.abs(drive.error(e)[110 * 50 :]).max() < 0.1
    assert (np.abs(drive.error(e) * drive.mass_kg)[again] < 3 * e.mass_std_kg[again]).all()


@pytest.mark.parametrize("before_kg", [12_000.0, 28_000.0])
@pytest.mark.parametrize("ratio", [0.6, 0.93, 1.08, 1.3])
def test_another_load_is_found_and_never_valid_while_wrong(before_kg, ratio):
    after_kg = before_kg * ratio
    drive = trip(230, mass_kg=[(0.0, before_kg), (90.0, after_kg)], stops=STOP)
    _, e = run(drive)
    later = np.arange(len(e.status)) > 110 * 50
    wrong = np.abs(drive.error(e)) > 0.08
    assert not (wrong & later & (e.status == Status.VALID)).any()
    assert np.abs(drive.error(e)[220 * 50 :]).max() < 0.03


def test_a_stop_at_a_crossing_changes_nothing():
    _, e = run(trip(120, road=flat, stops=[(70.0, 85.0)]))
    moving = slice(90 * 50, None)
    assert (e.status[moving] == Status.VALID).all()
