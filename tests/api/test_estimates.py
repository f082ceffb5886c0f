"""The functions give the bits of the command line, from logs, tables and frames alike."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import canest
from canest.cli.main import run

KENWORTH = Path(__file__).parents[1] / "data" / "kenworth" / "normal.log.xz"
NUMBERS = ("t_s", "mass_kg", "mass_std_kg", "grade", "grade_std")
#: a config that maps columns of its own names
MAPPED = """
vehicle: {mass_min_kg: 7000, mass_max_kg: 40000, wheel_radius_m: 0.5, wheel_inertia_kgm2: 130,
          final_drive: 3.73, gear_ratios: {7: 1.90, 8: 1.38, 9: 1.00}, engine_inertia_kgm2: 3.2,
          reference_torque_Nm: 2100, drag_area_m2: 6.4, rolling_resistance: 0.006,
          torque_accuracy_pct: 2, wheel_radius_accuracy_pct: 0.5}
dbc: []
signals:
  engine_torque_pct: {column: torque}
  engine_speed: {column: rpm}
  vehicle_speed: {column: v_kmh, unit: km/h}
  gear: {column: gear, map: {g7: 7, g8: 8, g9: 9}}
"""


@pytest.fixture(scope="session")
def drive():
    return canest.demo_drive()


@pytest.fixture(scope="session")
def table(drive):
    """Return the demo's signals at 50 Hz."""
    return canest.read_signals(drive, drive.config).to_pandas()


@pytest.fixture
def mapped(table, tmp_path):
    """Return (table, config) whose columns have names of their own, and text for gears."""
    gear = table.gear.map({7.0: "g7", 8.0: "g8", 9.0: "g9"})
    ours = table[["t_s"]].assign(
        torque=table.engine_torque_pct, rpm=table.engine_speed, v_kmh=3.6 * table.vehicle_speed, gear=gear
    )
    (tmp_path / "mapped.yaml").write_text(MAPPED)
    return ours, canest.load_config(tmp_path / "mapped.yaml")


def assert_same(found, expected):
    assert len(found) == len(expected) > 0
    for name, column in expected.columns().items():
        np.testing.assert_array_equal(getattr(found, name), column, err_msg=name)


def without_time(summary):
    return {key: value for key, value in summary.items() if key != "wall_s"}


def test_replay_is_what_the_command_line_writes(tmp_path):
    import pandas as pd

    files = [tmp_path / name for name in ("est.csv", "est.parquet", "summary.json")]
    for output in files[:2]:
        assert (
            run(["replay", str(KENWORTH), "-c", "kenworth", "-o", str(output), "--json", str(files[2])]) == 0
        )
    result = canest.replay(KENWORTH, "kenworth", output=tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == files[0].read_bytes()
    written = pd.read_parquet(files[1])
    for name in NUMBERS:
        np.testing.assert_array_equal(getattr(result, name), written[name].to_numpy(), err_msg=name)
    ours = result.to_pandas()
    assert list(ours.columns) == list(written.columns) == list(pd.read_csv(files[0], nrows=1).columns)
    for name in ("status", "gate"):
        assert (ours[name].astype(str) == written[name].astype(str)).all()
    assert without_time(result.summary) == without_time(json.loads(files[2].read_text()))


def test_replay_writes_nothing_unless_asked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    canest.replay(KENWORTH, "kenworth")
    assert list(tmp_path.iterdir()) == []


def test_frames_in_memory_are_as_good_as_a_file(drive, tmp_path):
    files = drive.write(tmp_path)
    from_file = canest.replay(files[0], files[2], truth=files[1])
    assert_same(canest.replay(drive, drive.config), from_file)
    assert_same(canest.replay(drive.frames, drive.config), from_file)
    found = canest.replay(drive, drive.config, truth=drive.truth).summary["errors"]
    # the file has its truth rounded
    assert found["mass_rms_pct"] == pytest.approx(from_file.summary["errors"]["mass_rms_pct"])


def test_another_estimator_has_its_own_options(drive):
    config = canest.load_config(
        "class8", {"estimator.name": "rls", "estimator.options": {"forgetting": 0.99}}
    )
    result = canest.replay(drive, config, estimator="canest")
    assert result.config.estimator.options == {}
    assert_same(result, canest.replay(drive, drive.config))
    with pytest.raises(canest.ConfigError, match="found 'kanest', expected"):
        canest.replay(drive, config, estimator="kanest")


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_table_is_what_the_same_table_in_a_file_is(mapped, tmp_path, suffix):
    table, config = mapped
    file = tmp_path / f"table.{suffix}"
    table.to_csv(file, index=False) if suffix == "csv" else table.to_parquet(file)
    expected = canest.replay(file, config)
    found = canest.estimate(table, config)
    assert_same(found, expected)
    assert (found.status == canest.Status.VALID).any()
    assert without_time(found.summary) == without_time(expected.summary)


def test_columns_named_by_role_need_a_vehicle_only(table, tmp_path):
    config = canest.load_config("class8")
    found = canest.estimate(table, canest.Vehicle(**config.vehicle.model_dump()))
    assert found.summary["status"] == "valid"
    assert set(found.config.signals) == set(table.columns) - {"t_s"}
    assert found.config.vehicle == config.vehicle
    table.to_parquet(tmp_path / "table.parquet")
    assert_same(found, canest.replay(tmp_path / "table.parquet", found.config))
    assert_same(canest.estimate(table, "class8"), found)


@pytest.mark.parametrize("every", [1, 2, 5, 10, 25, 50])
def test_slow_tables(table, every):
    slow = {name: table[name].to_numpy()[::every] for name in table.columns}
    result = canest.estimate(slow, "class8", mass_kg=21000.0)
    assert result.summary["errors"]["mass_rms_pct"] < 3.0
    # at one row a second a shift closes what lies before its first row and behind its last one
    assert result.summary["updated"] > (5900 if every == 50 else 6000)


@pytest.mark.parametrize("rate_hz", [100, 333, 1000])
def test_fast_tables(table, rate_hz):
    t_s = np.arange(table.t_s.iloc[0], table.t_s.iloc[-1], 1.0 / rate_hz)
    rows = np.searchsorted(table.t_s, t_s + 1e-6, side="right") - 1
    fast = {name: table[name].to_numpy()[rows] for name in table.columns} | {"t_s": t_s}
    assert canest.estimate(fast, "class8", mass_kg=21000.0).summary["errors"]["mass_rms_pct"] < 2.0


def test_units_are_converted(table):
    vehicle = canest.load_config("class8").vehicle
    in_kmh = table.assign(vehicle_speed=3.6 * table.vehicle_speed)
    found = canest.estimate(in_kmh, vehicle, units={"vehicle_speed": "km/h"})
    expected = canest.estimate(table, vehicle)
    np.testing.assert_allclose(found.mass_kg, expected.mass_kg, rtol=1e-6)
    with pytest.raises(canest.ConfigError, match="unit does not fit the role, found 'bar'"):
        canest.estimate(table, vehicle, units={"vehicle_speed": "bar"})
    with pytest.raises(canest.ConfigError, match="units: unknown column, found 'speed'"):
        canest.estimate(table, vehicle, units={"speed": "km/h"})


def test_config_of_an_estimate_keeps_the_effects_signals(table):
    config = canest.load_config("class8", {"effects": [
        {"effect": "switched_load", "signal": "fan_speed", "power_kW": 0.0}]})  # fmt: skip
    assert canest.estimate(table, config).config.effects == config.effects


def test_compare_takes_tables_and_drives(drive, table):
    names = ["canest", "rls"]
    of_drive = canest.compare(drive, drive.config, truth=drive.truth, estimators=names)
    of_table = canest.compare(table, drive.config.vehicle, truth=drive.truth, estimators=names)
    for found in (of_drive, of_table):
        assert list(found.to_pandas().index) == names
        assert found.true_mass_kg[-1] == 21000.0
    assert_same(of_drive.estimates["canest"], canest.replay(drive, drive.config))
    with pytest.raises(canest.ConfigError, match="estimators: unknown estimator"):
        canest.compare(drive, drive.config, estimators=["best"])


def test_pipeline_gives_the_same_however_frames_are_cut(drive):
    pipeline = canest.Pipeline(drive.config)
    parts = [pipeline.push(drive.frames[i : i + 4567]) for i in range(0, len(drive.frames), 4567)]
    parts += [pipeline.advance_to(drive.frames.t_us[-1] / 1e6), pipeline.finish()]
    expected = canest.replay(drive, drive.config)
    for name, column in expected.columns().items():
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), column)
    assert pipeline.samples == len(expected)
    assert pipeline.gate_counts == expected.summary["gates"]
    assert pipeline.snapshot()["mass_kg"] == pytest.approx(expected.mass_kg[-1])


@pytest.mark.parametrize("estimator", ["canest", "canest-0.1", "rlsmf", "dgo"])
def test_a_pipeline_goes_on_from_what_another_has_saved(drive, estimator):
    config = canest.load_config("class8", {"estimator.name": estimator})
    first, then = canest.Pipeline(config), canest.Pipeline(config)
    assert first.snapshot() == {}
    first.push(drive.frames)
    saved = json.loads(json.dumps(first.snapshot()))
    assert list(saved) == ([] if estimator == "dgo" else ["mass_kg", "mass_std_kg"])
    if saved:
        then.restore(**saved)
        assert then.push(drive.frames[:500]).mass_kg[-1] == pytest.approx(saved["mass_kg"], rel=0.01)


def test_a_saved_mass_is_within_the_bounds_in_spite_of_rounding(drive):
    most_kg = 15002.0
    assert 1 / (1 / most_kg) > most_kg
    pipeline = canest.Pipeline(canest.load_config("class8", {"vehicle.mass_max_kg": most_kg}))
    pipeline.push(drive.frames)
    assert pipeline.snapshot()["mass_kg"] == most_kg
    pipeline.restore(**pipeline.snapshot())


@pytest.mark.slow
def test_the_recorded_demo_differs_from_the_simulated_one_by_little(drive):
    made = canest.simulate("demo")
    np.testing.assert_array_equal(drive.truth["t_s"], made.truth["t_s"])
    np.testing.assert_array_equal(drive.truth["mass_kg"], made.truth["mass_kg"])
    np.testing.assert_allclose(drive.truth["distance_m"], made.truth["distance_m"], atol=1.0)
    assert len(drive.frames) < len(made.frames)


def test_overrides_are_values():
    overrides = {
        "vehicle.gear_ratios": {1: 3.0, 2: 1.0},
        "filter.cutoff_hz": np.float64(1.5),
        "signals.altitude": None,
    }
    config = canest.load_config("class8", overrides)
    assert config.vehicle.gear_ratios == {1: 3.0, 2: 1.0}
    assert config.filter.cutoff_hz == 1.5
    assert "altitude" not in config.signals
    with pytest.raises(
        canest.ConfigError, match=r"--set: vehicle.mass_min_kg, found 1, expected greater than 50"
    ):
        canest.load_config("class8", {"vehicle.mass_min_kg": 1})


@pytest.mark.slow
def test_diagnosis_of_a_drive_too_short_is_an_object_too():
    scenario = {
        "duration_s": 60, "vehicle": "class8", "mass_kg": 21250, "road": {"kind": "highway"},
        "driver": {"kind": "pulses"}, "bus": {"traffic": False},
    }  # fmt: skip
    drive = canest.simulate(scenario, seed=1)
    found = canest.diagnose([drive, drive], drive.config, truth=[drive.truth, None], mass_kg=21250.0)
    assert found.verdict in ("nothing-to-explain", "unexplained", "explained", "partly")
    assert found.document["finding"] == found.finding
    assert len(found.before) == len(found.after) == 2
    assert found.config.vehicle == drive.config.vehicle
    with pytest.raises(canest.UsageError, match="logs and truths differ"):
        canest.diagnose([drive, drive], drive.config, truth=[drive.truth])


class NoEstimator:
    pass


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda d: canest.compare(d, d.config, estimators=[]), "no estimators"),
        (lambda d: canest.compare(d, d.config, estimators=[NoEstimator]), "found 'NoEstimator'.*extending"),
        (lambda d: canest.replay(d, d.config, estimator=NoEstimator), "found 'NoEstimator'.*extending"),
        (lambda d: canest.diagnose([], d.config), "no logs"),
        (lambda d: canest.load_config("class8", "a"), "no overrides.*a mapping"),
        (lambda d: canest.simulate("demo", seed=-1), "seed: no seed"),
        (lambda d: canest.simulate("demo", seed="a"), "seed: no seed"),
        (lambda d: canest.FrameBlock.from_messages(5), "no messages"),
        (lambda d: canest.FrameBlock.from_messages([5]), "no messages"),
        (lambda d: canest.Pipeline(d.config).restore(float("nan"), 3.0), "mass_kg: no such number"),
        (lambda d: canest.Pipeline(d.config).restore(2e4, -3.0), "mass_std_kg: no such number"),
        (lambda d: canest.Pipeline(d.config).restore(2e4, 0.0), "mass_std_kg: no such number"),
        (lambda d: canest.Pipeline(d.config).restore(2e4, 300.0, -5.0), "unseen_s: no such number"),
        (lambda d: canest.Pipeline(d.config).restore(60.0, 3.0), "found 60.0, expected 7000 to 40000 kg$"),
        (
            lambda d: canest.Pipeline(d.config).restore(1e9, 3.0),
            "mass_kg: no such number, found 1000000000.0, ex",
        ),
        (lambda d: canest.Pipeline(d.config).advance_to("x"), "t_s: no such number"),
        (lambda d: canest.Pipeline(d.config).advance_to(None), "t_s: no such number"),
        (lambda d: canest.Pipeline(d.config).restore(None, 3.0), "mass_kg: no such number"),
    ],
)
def test_arguments_that_mean_nothing_are_one_plain_error(drive, call, text):
    with pytest.raises(canest.UsageError, match=text):
        call(drive)


def test_a_table_of_a_comparison_has_numbers_in_its_columns(drive):
    pytest.importorskip("pandas")
    table = canest.compare(drive, drive.config, estimators=["rls", "canest"]).to_pandas()
    assert {name: str(table[name].dtype) for name in table.columns if name != "note"} == dict.fromkeys(
        (name for name in table.columns if name != "note"), "float64"
    )
