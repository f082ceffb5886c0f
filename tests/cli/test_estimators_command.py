"""`canest estimators show`: the constants of a method, once in code, for people and for programs."""

from __future__ import annotations

import json

from canest.estimators.default.constants import CONSTANTS


def test_show_prints_every_constant_of_the_default(canest):
    done = canest("estimators", "show", "canest")
    assert done.code == 0
    heading = next(line for line in done.out.splitlines() if "symbol" in line)
    assert heading.split() == ["symbol", "constant", "value", "unit", "source"]
    for name, value in CONSTANTS._asdict().items():
        (line,) = [line for line in done.out.splitlines() if f" {name} " in line]
        assert f" {value:g} " in line


def test_json_has_them_under_constants(canest):
    done = canest("estimators", "show", "canest", "--json")
    found = json.loads(done.out)["constants"]
    assert {row["name"]: row["value"] for row in found} == CONSTANTS._asdict()
    for row in found:
        assert set(row) == {"name", "symbol", "value", "unit", "source"}
        assert row["symbol"], row
        assert row["unit"], row
        assert row["source"], row
    symbols = [row["symbol"] for row in found]
    assert len(set(symbols)) == len(symbols)


def test_a_method_without_constants_has_none(canest):
    assert json.loads(canest("estimators", "show", "rls", "--json").out)["constants"] == []
    assert "symbol" not in canest("estimators", "show", "rls").out
