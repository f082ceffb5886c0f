"""Options of estimators: presets of the papers, and one clear line for what is wrong."""

from __future__ import annotations

import pytest

from canest.core.errors import ConfigError
from canest.estimators.registry import BUILT_IN, create

from .synthetic import FACTS

PAPERS = [name for name in BUILT_IN if not name.startswith("canest")]


@pytest.mark.parametrize("name", PAPERS)
def test_an_unknown_option_is_named(name):
    with pytest.raises(ConfigError, match=r"estimator\.options\.forgeting: unknown option") as error:
        create(name, FACTS, {"forgeting": 0.9})
    assert error.value.exit_code == 2


@pytest.mark.parametrize("name", PAPERS)
def test_an_unknown_preset_lists_the_known_ones(name):
    with pytest.raises(ConfigError, match=r"estimator\.options\.preset: unknown preset"):
        create(name, FACTS, {"preset": "1999"})


@pytest.mark.parametrize("preset", [2014, "2014"])
def test_a_preset_that_is_a_year_may_be_written_as_a_number(preset):
    assert create("ekf", FACTS, {"preset": preset}) is not None
    with pytest.raises(ConfigError, match=r"estimator\.options\.preset: unknown preset"):
        create("ekf", FACTS, {"preset": [preset]})


@pytest.mark.parametrize(
    ("name", "options", "key"),
    [
        ("rlsmf", {"forgetting_mass": 1.5}, "forgetting_mass"),
        ("rlsmf", {"regression": "both"}, "regression"),
        ("rls", {"forgetting": "much"}, "forgetting"),
        ("rls", {"outliers": {"batch": 1}}, "outliers.batch"),
        ("ekf", {"q": [1.0, -1.0, 0.0]}, "q"),
        ("ekf", {"r": 0}, "r"),
        ("ekf-select", {"filters": 1}, "filters"),
        ("gtls", {"noise_correlation": 1.0}, "noise_correlation"),
        ("resistance4", {"forgetting": [1.0, 1.0, 2.0, 1.0]}, "forgetting"),
        ("pmg", {"forgetting": float("nan")}, "forgetting"),
    ],
)
def test_a_wrong_value_is_named_with_what_was_found(name, options, key):
    with pytest.raises(ConfigError) as error:
        create(name, FACTS, options)
    assert error.value.where == f"estimator.options.{key}"
    assert error.value.found is not None


@pytest.mark.parametrize(
    ("name", "preset", "expected"),
    [
        ("rlsmf", "2005-simulation", {"forgetting_mass": 1.0, "forgetting_grade": 0.8}),
        ("rlsmf", "2005-experiment", {"forgetting_mass": 0.95, "forgetting_grade": 0.4}),
        ("rlsmf", "2014", {"forgetting_mass": 0.995, "forgetting_grade": 0.95, "p0": (0.001, 10.0)}),
        ("rlsmf-n", "2005-experiment", {"forgetting_mass": 0.95, "forgetting_grade": 0.4}),
        ("rls", "2013", {"forgetting": 0.997}),
        ("rgtls", "2013", {"forgetting": 0.997**2}),
        ("ekf", "2014", {"q": (0.1, 1e-5, 25.0), "r": 100.0, "rate_hz": 30.0}),
        ("ekf-select", "2014", {"every_s": 5.0, "variation": 0.01}),
    ],
)
def test_presets_are_the_papers_tunings(name, preset, expected):
    options = create(name, FACTS, {"preset": preset}).options
    for key, value in expected.items():
        assert getattr(options, key) == value


def test_an_explicit_key_wins_over_the_preset():
    options = create("rlsmf", FACTS, {"preset": "2014", "forgetting_grade": 0.9}).options
    assert options.forgetting_grade == 0.9
    assert options.forgetting_mass == 0.995


def test_every_contract_name_is_served():
    assert set(PAPERS) == {
        "batch-ls",
        "rls",
        "rls-vector",
        "rlsmf",
        "rlsmf-n",
        "resistance4",
        "tls",
        "gtls",
        "rtls",
        "rgtls",
        "ekf",
        "ekf-select",
        "dgo",
        "pmg",
    }
    for name in PAPERS:
        assert create(name, FACTS).name == name
