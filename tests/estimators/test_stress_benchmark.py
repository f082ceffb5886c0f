"""The drives of `benchmarks/stress.py` are what their rows say."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.frames import FrameBlock
from canest.core.samples import EstimateBlock, Status
from canest.simulation import load_scenario, simulate

from .benchmark_modules import benchmark

rows = benchmark("stress_rows")
judging = benchmark("judging")


def scenario(rows, name, seed=1):
    return load_scenario(rows.BY_NAME[name].scenarios(seed)[0])


def test_every_row_has_a_name_of_its_own_and_is_a_scenario(rows):
    assert len(rows.BY_NAME) == len(rows.ROWS) > 25
    for row in rows.ROWS:
        if row.name == "driver looks ahead":
            continue  # it drives once to know its road
        for seed in (1, 2):
            for found in row.scenarios(seed):
                assert load_scenario(found).duration_s <= 700.0


def test_loads_change_in_motion_both_ways(rows):
    for name, sign in (("loaded in motion", 1), ("unloaded in motion", -1)):
        before, after = scenario(rows, name).mass_kg
        assert after.moving
        assert sign * (after.mass_kg - before.mass_kg) > 5000.0
    assert scenario(rows, "spreader 14 kg/s, town").mass_kg[0].rate_kgps == -14.0


def test_torque_zeros_hit_this_share_of_the_torque_samples_and_nothing_else(rows):
    frames = simulate({"duration_s": 30, "vehicle": "class8", "mass_kg": 2e4, "driver": {"kind": "pulses"}})
    frames = frames.frames
    found = rows.BY_NAME["torque zeros 5 %"].edit_frames(frames)
    changed = found.data != frames.data
    eec1 = (frames.can_id & 0x1FFFFFFF) == 0x0CF00400
    assert not (changed & ~eec1).any()
    assert changed.sum() / eec1.sum() == pytest.approx(0.05, abs=0.02)
    torque_byte = np.uint64(0xFF0000)
    assert np.all((found.data[changed] & torque_byte) >> np.uint64(16) == 125)
    assert np.all(found.data & ~torque_byte == frames.data & ~torque_byte)
    assert isinstance(found, FrameBlock)


def test_the_manoeuvre_is_168_m_in_each_phase(rows):
    begun = []
    for phase in (0, 4, 8):
        found = rows.BY_NAME["one manoeuvre of 168 m"].scenarios(phase)[0]
        history = simulate(found).history
        first, last = found["driver"]["at_s"][2], found["driver"]["at_s"][-1]
        start, end = np.interp([first, last], history["t_s"], history["distance_m"])
        begun.append(start)
        assert end - start == pytest.approx(168.0, abs=5.0)
    assert begun[2] - begun[0] == pytest.approx(8 / 9 * 200.0, rel=0.02)


def test_the_night_is_eight_hours_and_only_its_end_is_judged(rows, judging):
    row = rows.BY_NAME["first 10 s after eight hours"]
    drive = judging.prepare(*row.scenarios(1))
    kept = drive.between(*row.judged_s)
    part = drive.part(kept)
    assert 8.0 < len(part.samples) / 50.0 <= 10.1
    assert part.samples.t_us[0] - drive.samples.t_us[~kept][0] > 8 * 3600e6
    assert len(np.unique(part.mass_kg)) == 1
    assert part.mass_kg[0] > drive.mass_kg[0] + 5000.0


def test_a_judge_counts_valid_samples_that_are_wrong(rows, judging):
    drive = judging.prepare(rows.truck(1, duration_s=130))
    n = len(drive.samples)
    mass = drive.mass_kg * np.where(np.arange(n) < n // 4, 1.10, 1.03)
    status = np.full(n, Status.VALID, np.uint8)
    estimates = EstimateBlock(mass, 0.008 * mass, drive.grade, np.full(n, 0.01), status)
    found = judging.judge(drive, estimates)
    assert found["valid_wrong"] == pytest.approx(25.0, abs=0.1)
    assert found["valid_beyond"] == pytest.approx(100.0)
    assert found["bias"] == pytest.approx(3.0)
    nothing = np.full(n, np.nan)
    unknown = judging.judge(drive, EstimateBlock(nothing, nothing, nothing, nothing, 0 * status))
    assert (unknown["valid"], unknown["valid_wrong"]) == (0.0, 0.0)
    assert np.isnan(unknown["rms_120"])


def test_a_drifting_load_counts_as_settled_and_a_change_does_not(rows, judging):
    drifting = judging.prepare(rows.truck(3, duration_s=150, mass_kg=[load(24e3, -14.0)]))
    assert judging.settled(drifting)[-1]
    changed = [load(24e3), {"t_s": 100, "mass_kg": 20e3, "moving": True}]
    assert not judging.settled(judging.prepare(rows.truck(3, duration_s=150, mass_kg=changed)))[-1]


def load(mass_kg, rate_kgps=0.0):
    return {"t_s": 0, "mass_kg": mass_kg, "rate_kgps": rate_kgps}
