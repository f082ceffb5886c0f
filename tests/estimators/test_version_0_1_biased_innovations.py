"""Innovations with a bias move no mass."""

from __future__ import annotations

import pytest

from canest.estimators.canest_0_1 import states as k
from canest.estimators.registry import create

from .momentum import FACTS, trip

#: 20 s, then one window
HEARD, MORE = 1000, 1010


def known(estimator):
    """Inverse mass, its variance and the grade of both filters."""
    return [(x[k.U], P[k.U][k.U], x[k.GRADE]) for x, P in zip(estimator._X, estimator._PP, strict=True)]


def around_a_window(bias: float):
    """What both filters know before and after a window in which torque moves; bias: so far they lean."""
    block = trip(30).block
    assert block.traction_N[MORE - 1] > 0.0
    estimator = create("canest-0.1", FACTS)
    estimator.update(block[:HEARD])
    estimator._memory[k.BIASED] = bias
    before = known(estimator)
    estimator.update(block[HEARD:MORE])
    return zip(before, known(estimator), strict=True)


@pytest.mark.parametrize("bias", [0.51, -0.51, 1.4])
def test_innovations_with_a_bias_move_the_grade_and_no_mass(bias):
    for (u, u_var, grade), (u_after, u_var_after, grade_after) in around_a_window(bias):
        assert u_after == u
        assert u_var_after >= u_var  # less a drift of the load by the metre
        assert grade_after != grade


def test_others_move_the_mass():
    for (u, u_var, _), (u_after, u_var_after, _) in around_a_window(0.49):
        assert u_after != u
        assert u_var_after < u_var
