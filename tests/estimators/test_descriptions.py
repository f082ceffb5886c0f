"""Each estimator is described once, at its class, and everything else is made from that."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest

from canest.core.errors import ConfigError
from canest.estimators import registry
from canest.estimators.description import option_rows
from tests.cli.conftest import canest  # noqa: F401 - a fixture

from .synthetic import FACTS

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", registry.BUILT_IN)
def test_the_index_leads_to_the_class_that_describes_the_name(name):
    estimator = registry.create(name, FACTS)
    assert estimator.name == name
    assert estimator.description is registry.describe(name)
    assert estimator.description.text
    assert estimator.description.source
    assert estimator.description.needs


def test_every_name_that_a_class_describes_is_in_the_index():
    classes = {registry.estimator_class(name) for name in registry.BUILT_IN}
    assert sorted(d.name for c in classes for d in c.descriptions) == sorted(registry.BUILT_IN)


@pytest.mark.parametrize("name", registry.BUILT_IN)
def test_every_option_has_a_meaning_and_its_allowed_values(name):
    for row in option_rows(registry.describe(name).options):
        assert row.text, row.name
        assert row.allowed, row.name
        if row.name.endswith(("_s", "_mps2", "_N", "_hz")):
            assert row.unit, row.name


def test_the_page_is_made_from_the_code():
    tool = runpy.run_path(str(ROOT / "tools" / "estimators_page.py"))
    text = tool["PAGE"].read_text(encoding="utf-8")
    assert tool["page"](text) == text, "python tools/estimators_page.py --write"


def test_list_names_every_estimator_with_its_source(canest):  # noqa: F811
    done = canest("estimators", "list")
    assert done.code == 0
    for name in registry.BUILT_IN:
        assert name in done.out
    listed = json.loads(canest("estimators", "list", "--json").out)
    assert [e["name"] for e in listed["estimators"]] == list(registry.BUILT_IN)
    assert set(listed["papers"]) == {"2005", "2013", "2014"}
    assert listed["skipped"] == {}


@pytest.mark.parametrize("name", registry.BUILT_IN)
def test_show_prints_every_option(canest, name):  # noqa: F811
    text, as_json = canest("estimators", "show", name), canest("estimators", "show", name, "--json")
    assert text.code == as_json.code == 0
    shown = json.loads(as_json.out)
    assert shown["name"] == name
    for option in shown["options"]:
        assert option["name"] in text.out
    assert set(shown["presets"]) == set(registry.describe(name).presets)


def test_show_json_gives_defaults_that_the_estimator_takes(canest):  # noqa: F811
    for name in registry.BUILT_IN:
        shown = json.loads(canest("estimators", "show", name, "--json").out)
        options = {o["name"]: o["default"] for o in shown["options"] if "." not in o["name"]}
        assert registry.create(name, FACTS, options).name == name


def test_an_unknown_name_is_refused_with_the_nearest(canest):  # noqa: F811
    done = canest("estimators", "show", "rlsm")
    assert done.code == 2
    assert "found 'rlsm', expected an estimator, perhaps rlsmf" in done.err
    with pytest.raises(ConfigError):
        registry.create("nothing", FACTS)
