"""Replays of recorded logs give what they gave before (see golden.py)."""

from __future__ import annotations

import json

import golden
import numpy as np
import pytest


@pytest.mark.parametrize("name", sorted(golden.CASES))
def test_replay_is_as_it_was(name):
    expected = json.loads(golden.FILE.read_text())[name]
    found = golden.digest(golden.replayed(*golden.CASES[name]))
    hint = "python tests/replay/golden.py --write, and say why in the commit"
    assert found["samples"] == expected["samples"], hint
    assert found["t_us"] == expected["t_us"], hint
    assert found["gates"] == expected["gates"], hint
    assert found["status"] == expected["status"], hint
    for column, tolerance in (("mass_kg", 1e-6), ("mass_std_kg", 1e-5), ("grade", 1e-6)):
        np.testing.assert_allclose(
            np.array(found[column], float), np.array(expected[column], float), rtol=tolerance, atol=1e-9,
            err_msg=f"{column}: {hint}",
        )  # fmt: skip
