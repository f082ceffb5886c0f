"""Every estimator on one log: the table and the estimates behind it."""

from __future__ import annotations

import numpy as np
import pytest

from canest.config import load_config
from canest.core.errors import ConfigError
from canest.core.samples import STEP_US
from canest.estimators.registry import BUILT_IN
from canest.logs.truth import Truth
from canest.offline.compare import compare, time_to
from canest.offline.scoring import Reference
from canest.simulation.run import simulate

COLUMNS = {
    "mass_end_pct", "mass_rms_pct", "mass_max_pct", "grade_rms_deg", "to_5pct_s", "ns_per_sample", "note",
}  # fmt: skip


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    scenario = {
        "seed": 5,
        "duration_s": 80,
        "vehicle": "class8",
        "mass_kg": 18_000,
        "road": {"kind": "highway", "grade_max": 0.03},
        "driver": {"kind": "pulses"},
        "bus": {"traffic": False},
    }
    directory = tmp_path_factory.mktemp("compare")
    simulated = simulate(scenario)
    simulated.write(directory)
    t = simulated.truth
    return next(directory.glob("*.log")), Truth(
        np.round(t["t_s"] * 1e6).astype(np.int64), t["grade"], t["mass_kg"]
    )


def test_every_name_has_a_row_with_the_contracts_columns(drive):
    log, truth = drive
    result = compare(
        load_config("class8.yaml"), log, reference=Reference(truth, after_s=20.0), compiled=False
    )
    rows = result.table["estimators"]
    assert list(rows) == list(BUILT_IN)
    assert result.table["default"] == load_config("class8.yaml").estimator.name
    for name, row in rows.items():
        assert set(row) == COLUMNS
        assert row["grade_rms_deg"] is not None, name
        assert row["ns_per_sample"] > 0
        assert (row["mass_rms_pct"] is None) == (name == "dgo")
        assert len(result.estimates[name]) == len(result.speed_mps) == len(result.true_grade)


def test_an_estimator_without_its_signal_has_a_reason_instead_of_a_number(drive):
    log, truth = drive
    config = load_config("class8.yaml")
    signals = {k: v for k, v in config.signals.items() if k != "longitudinal_accel"}
    blind = config.model_copy(update={"signals": signals})
    rows = compare(
        blind, log, reference=Reference(truth), names=["pmg", "resistance4", "rls"], compiled=False
    ).table
    for name in ("pmg", "resistance4"):
        row = rows["estimators"][name]
        assert "accelerometer" in row["note"]
        assert row["mass_rms_pct"] is None
        assert row["mass_end_pct"] is None
    assert rows["estimators"]["rls"]["mass_rms_pct"] is not None


def test_estimates_are_those_of_a_replay(drive, tmp_path):
    from canest.offline.log_run import LogRun

    log, _ = drive
    config = load_config("class8.yaml", ["estimator.name=rlsmf"])
    replayed = list(LogRun(log, config).estimates())
    compared = compare(config, log, names=["rlsmf"], compiled=False).estimates["rlsmf"]
    np.testing.assert_array_equal(compared.mass_kg, np.concatenate([e.mass_kg for e in replayed]))
    np.testing.assert_array_equal(compared.gate, np.concatenate([e.gate for e in replayed]))


def test_without_truth_there_are_no_errors(drive):
    log, _ = drive
    row = compare(load_config("class8.yaml"), log, names=["ekf"], compiled=False).table["estimators"]["ekf"]
    assert row["mass_rms_pct"] is None
    assert row["to_5pct_s"] is None
    assert row["ns_per_sample"] > 0


def test_an_unknown_name_is_refused(drive):
    with pytest.raises(ConfigError, match="unknown estimator"):
        compare(load_config("class8.yaml"), drive[0], names=["kalman"])


@pytest.mark.parametrize(
    ("error_pct", "expected"),
    [
        (np.full(1000, 3.0), 0.0),
        (np.full(1000, 9.0), None),
        (np.r_[np.full(100, 9.0), np.full(900, 1.0)], 2.0),
        (np.r_[np.full(100, 1.0), np.full(900, 9.0)], None),
        (np.r_[np.full(600, 1.0), np.full(400, 9.0)], 0.0),
        (np.r_[np.full(900, np.nan), np.full(100, 1.0)], 18.0),
        (np.empty(0), None),
    ],
)
def test_time_to_within_five_percent(error_pct, expected):
    assert time_to(error_pct, STEP_US * np.arange(len(error_pct))) == expected


def test_a_silence_counts_as_time():
    t_us = np.concatenate((STEP_US * np.arange(100), 600_000_000 + STEP_US * np.arange(900)))
    error_pct = np.concatenate((np.full(200, 9.0), np.zeros(800)))
    assert time_to(error_pct, t_us) == pytest.approx(602.0)


def test_a_log_that_teaches_nothing_has_no_mass_errors(tmp_path):
    parked = simulate(
        {
            "duration_s": 20,
            "vehicle": "class8",
            "mass_kg": 18_000,
            "driver": {"kind": "given", "at_s": [0, 20], "speed_mps": [0, 0]},
            "bus": {"traffic": False},
        }
    )
    parked.write(tmp_path)
    log = next(tmp_path.glob("*.log"))
    result = compare(
        load_config("class8.yaml"), log, reference=Reference(mass_kg=18_000.0, after_s=0.0), names=["ekf"]
    )
    row = result.table["estimators"]["ekf"]
    assert row["note"] == "never learned from this log"
    assert row["mass_rms_pct"] is None
    assert row["mass_end_pct"] is None
