"""Load legs: where a drive is cut, what is merged, and what is reported of each."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import canest
from canest.cli.summary import many_lines, result_lines
from canest.core.estimates import Estimates
from canest.core.samples import Status
from canest.offline.leg import Leg, load_legs
from canest.offline.leg_text import headline, mass_text
from canest.offline.legs import Legs
from canest.offline.replay import ReplayResult
from canest.offline.scoring import Score

ZTBUS = Path(__file__).parents[1] / "data" / "ztbus" / "three-loads.csv.xz"
U, C, V = Status.UNESTIMATED, Status.CONVERGING, Status.VALID


def drive(*stretches, start_s=0.0):
    """Return estimates and speeds of stretches (seconds, speed, mass, std, status)."""
    columns = []
    for seconds, speed, mass, std, status in stretches:
        columns.append(np.tile([speed, mass, std, status], (round(seconds * 50), 1)))
    speed, mass, std, status = np.concatenate(columns).T
    n = len(speed)
    t_us = np.arange(n, dtype=np.int64) * 20_000 + round(start_s * 1e6)
    grade = np.full(n, 0.03)
    codes = status.astype(np.uint8)
    return Estimates(t_us, mass, std, grade, np.full(n, 0.01), codes, np.zeros(n, np.uint8)), speed


def legs_of(estimates, speed, block=None):
    found, settled = Legs(), []
    step = block or max(len(speed), 1)
    for at in range(0, len(speed), step):
        part = slice(at, at + step)
        columns = (getattr(estimates, name)[part] for name in Estimates.__slots__)
        settled.append(found.add(Estimates(*columns), speed[part]))
    return found, np.concatenate(settled)


THREE = (
    (30, 0.0, math.nan, math.nan, U),
    (40, 10.0, 19_500, 900, C),
    (60, 15.0, 19_100, 200, V),
    (90, 0.0, 19_100, 5_000, C),  # loaded
    (30, 10.0, 28_000, 2_000, C),
    (90, 15.0, 31_200, 300, V),
    (20, 0.0, 31_200, 900, C),  # a red light
    (60, 15.0, 31_350, 250, V),
    (60, 0.0, 31_350, 5_000, C),  # parked
)


class TestWhereADriveIsCut:
    def test_a_long_stop_cuts_and_legs_of_one_mass_are_merged(self):
        found, settled = legs_of(*drive(*THREE))
        first, second = found.legs()
        assert (first.load, first.mass_kg, first.mass_std_kg) == (1, 19_100, 200)
        assert (second.load, second.mass_kg, second.mass_std_kg) == (2, 31_350, 250)
        assert first.from_s == 30.0 and first.to_s == pytest.approx(129.98)
        assert second.from_s == 220.0 and second.stops == 1
        assert first.valid_share == pytest.approx(0.6)
        assert first.distance_m == pytest.approx(1_300) and first.climb_m == pytest.approx(39, abs=2.1)
        # settled: from the first valid sample of a leg on, and only while it moves
        assert np.count_nonzero(settled) == 50 * (60 + 90 + 60)

    def test_the_drive_ends_parked_and_the_last_valid_mass_is_kept(self):
        found, _ = legs_of(*drive(*THREE))
        assert found.last_valid == (pytest.approx(419.98), 31_350, 250)
        assert found.valid_share == pytest.approx(210 / 280)

    @pytest.mark.parametrize("block", [1, 7, 977])
    def test_however_the_stream_is_cut_the_legs_are_the_same(self, block):
        estimates, speed = drive(*((s / 4, *rest) for s, *rest in THREE))
        whole, settled = legs_of(estimates, speed)
        cut, settled_too = legs_of(estimates, speed, block)
        for a, b in zip(whole.legs(), cut.legs(), strict=True):
            assert a.to_json() == b.to_json()
        assert (settled == settled_too).all() and whole.last_valid == cut.last_valid

    def test_a_silent_bus_and_a_clock_set_back(self):
        estimates, speed = drive((60, 10.0, 20_000, 200, V), (60, 10.0, 30_000, 300, V))
        t_us = estimates.t_us.copy()
        t_us[3000:] += 3_600_000_000  # the ignition was off for an hour
        columns = {name: getattr(estimates, name) for name in Estimates.__slots__}
        found, _ = legs_of(Estimates(**{**columns, "t_us": t_us}), speed)
        assert [leg.mass_kg for leg in found.legs()] == [20_000, 30_000]
        t_us[3000:] -= 7_200_000_000  # no time passes where the clock is set back
        found, _ = legs_of(Estimates(**{**columns, "t_us": t_us}), speed)
        assert [leg.mass_kg for leg in found.legs()] == [30_000]

    def test_a_speed_that_is_not_known_is_no_driving(self):
        found, _ = legs_of(*drive((60, 10.0, 20_000, 200, V), (60, math.nan, 20_000, 200, V)))
        (leg,) = found.legs()
        assert leg.driving_s == pytest.approx(60) and leg.to_s == pytest.approx(59.98)

    def test_moving_a_few_metres_at_the_dock_is_part_of_the_stop(self):
        dock = (30, 0.0, 20_000, 900, C), (10, 1.0, 20_000, 900, C), (30, 0.0, 20_000, 900, C)
        found, _ = legs_of(*drive((60, 10.0, 20_000, 200, V), *dock, (60, 10.0, 26_000, 200, V)))
        assert [leg.mass_kg for leg in found.legs()] == [20_000, 26_000]

    def test_nothing_moves(self):
        found, settled = legs_of(*drive((60, 0.0, math.nan, math.nan, U)))
        assert not found.legs() and found.valid_share == 0.0 and found.last_valid is None
        assert not settled.any()


def leg(mass_kg, std_kg, status="valid", at=0):
    return Leg(
        at, at + 100.0, mass_kg, std_kg, 1.0 if status == "valid" else 0.0, driving_s=100.0, status=status
    )


class TestWhichLegsAreOneLoad:
    def test_masses_that_agree_within_their_stds(self):
        assert len(load_legs([leg(20_000, 300), leg(20_400, 300)])) == 1
        assert len(load_legs([leg(20_000, 300), leg(20_500, 300)])) == 2

    def test_a_short_leg_without_a_known_mass_joins_what_agrees_on_both_sides(self):
        nothing = leg(24_000, 6_000, "converging")
        (one,) = load_legs([leg(20_000, 300), nothing, leg(20_100, 300)])
        assert one.load == 1 and one.driving_s == 300 and one.valid_share == pytest.approx(2 / 3)
        three = load_legs([leg(20_000, 300), nothing, leg(26_000, 300)])
        assert [part.load for part in three] == [1, None, 2]

    def test_a_leg_not_yet_valid_joins_the_load_that_it_agrees_with(self):
        parts = load_legs([leg(31_500, 400), leg(13_200, 300, "converging"), leg(13_100, 200)])
        assert [(part.load, part.mass_kg) for part in parts] == [(1, 31_500), (2, 13_100)]

    def test_no_mass_at_all_is_no_load(self):
        (only,) = load_legs([leg(None, None, "unestimated")])
        assert only.load is None and json.dumps(only.to_json())


class TestWhatIsSaid:
    @pytest.fixture
    def result(self):
        estimates, speed = drive(*THREE)
        found, settled = legs_of(estimates, speed)
        score = Score(None, 31_000.0)
        score.add(estimates, settled)
        last = found.last_valid
        summary = {
            "frames": 1, "skipped_lines": 0, "samples": len(speed), "updated": 9, "gates": {},
            "estimator": "canest", "mass_kg": 31_350.0, "mass_std_kg": 5_000.0, "status": "converging",
            "last_valid": last._asdict(), "valid_share": found.valid_share, "driving_s": found.driving_s,
            "legs": [part.to_json() for part in score.with_truth(found.legs())], "errors": score.errors(),
            "reported_masses": [], "wall_s": 0.1,
        }  # fmt: skip
        return ReplayResult("drive.log", summary)

    def test_the_terminal_shows_the_last_valid_mass_and_every_load(self, result):
        shown = "\n".join(result_lines(result, []))
        assert "31,350 +- 250 kg, last valid at 420 s (75 % of the driving valid" in shown
        assert "at the end converging, 31,350 +- 5,000 kg" in shown
        assert (
            "load 1    19,100 +- 200 kg, 30 to 130 s, 1.3 km, 60 % valid, -38.4 % of the true 31,000" in shown
        )
        assert "over the settled legs (75 % of the driving)" in shown and "all samples, standing too" in shown

    def test_the_headline_has_how_many_loads_and_over_what_it_is_scored(self, result):
        shown = headline(result.summary)
        assert shown.startswith(
            "2 loads, 19,100 ± 200 kg and 31,350 ± 250 kg, valid for 75 % of the driving; "
        )
        assert "over the settled legs the mass is within" in shown

    def test_many_logs_show_the_last_valid_mass(self, result):
        pool = {"logs": [{"log": "drive.log", **result.summary}], "failed": 0, "frames": 1}
        header, row, *_ = many_lines(pool)
        assert header.split()[3:6] == ["%", "last", "valid"] and row.split()[3:7] == [
            "31,350",
            "250",
            "75",
            "2",
        ]

    def test_a_drive_that_never_became_valid_is_reported_so(self, result):
        never = {**result.summary, "last_valid": None, "legs": [], "valid_share": 0.0}
        assert "converging, never valid" in mass_text(never) and "never valid" in headline(never)


def test_errors_keep_their_meaning_and_settled_ones_stand_beside_them():
    estimates, speed = drive(
        (60, 0.0, 50_000, 9_000, C), (60, 10.0, 20_000, 900, C), (60, 10.0, 20_200, 200, V)
    )
    _, settled = legs_of(estimates, speed)
    plain, score = Score(None, 20_000.0, 0.0), Score(None, 20_000.0, 0.0)
    plain.add(estimates)
    score.add(estimates, settled)
    errors = score.errors()
    assert {**plain.errors(), "settled": errors["settled"]} == errors
    assert errors["mass_max_pct"] == pytest.approx(150) and errors["settled"]["samples"] == 3000
    assert errors["settled"]["mass_rms_pct"] == pytest.approx(1.0)


def test_a_measured_bus_weighs_more_with_more_passengers(tmp_path):
    """ZTBus (CC BY 4.0): 4 to 41 passengers in half an hour, counted at stops of some ten seconds."""
    pd = pytest.importorskip("pandas")
    table = pd.read_csv(ZTBUS)
    table["braking"] = (table["traction_brakePressure"] > 30_000).astype(float)  # Pa
    config = tmp_path / "bus.yaml"
    config.write_text(
        "vehicle: {name: bus, mass_min_kg: 18000, mass_max_kg: 33000, wheel_radius_m: 1.0, "
        "wheel_inertia_kgm2: 0, gear_ratios: {1: 1.0}, final_drive: 1.0, driveline_efficiency: 1.0, "
        "engine_inertia_kgm2: 0, "
        "drag_area_m2: 5.5, rolling_resistance: 0.008}\n"
        "dbc: []\nsampling: {time_column: time_unix}\nestimator: {name: canest}\n"
        "signals:\n"
        "  wheel_torque: {column: traction_tractionForce, unit: Nm, stale_s: 1.5}\n"
        "  vehicle_speed: {column: odometry_vehicleSpeed, unit: m/s, stale_s: 1.5}\n"
        "  brake_switch: {column: braking, stale_s: 1.5}\n"
    )
    result = canest.replay(table, config)
    loads = [part for part in result.summary["legs"] if part["load"] is not None]
    assert len(loads) >= 3
    assert 18_500 < min(part["mass_kg"] for part in loads) < 22_500
    # of the passengers counted at a stop, the last valid mass before the next count
    known = table.dropna(subset="itcs_numberOfPassengers")
    counted_s, passengers = known["time_unix"].to_numpy(), known["itcs_numberOfPassengers"].to_numpy()
    rows = result.to_pandas()
    t_s, mass_kg, valid = rows["t_s"].to_numpy(), rows["mass_kg"].to_numpy(), rows["status"] == "valid"
    pairs = []
    for count, begin, end in zip(passengers, counted_s, [*counted_s[1:], t_s[-1]], strict=True):
        leg = np.flatnonzero(valid & (t_s > begin) & (t_s < end - 1))
        if len(leg):
            pairs.append((count, mass_kg[leg[-1]]))
    assert len(pairs) >= 8
    assert np.corrcoef(np.array(pairs).T)[0, 1] > 0.7
    assert 55 < np.polyfit(*np.array(pairs).T, 1)[0] < 95  # kg per passenger
