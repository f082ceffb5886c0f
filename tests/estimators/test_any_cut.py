"""Every estimator: the same bits however the samples are cut, interpreted or compiled, and restored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core import jit
from canest.core.gates import Gate
from canest.core.samples import Status
from canest.estimators.registry import BUILT_IN, create

from .synthetic import FACTS, cut, drive, join, with_columns

PAPERS = [name for name in BUILT_IN if not name.startswith("canest")]
CASES = [(name, {}) for name in PAPERS] + [
    ("rlsmf", {"regression": "integrated"}),
    ("rls", {"start": "batch", "outliers": {"batch": 20}}),
    ("gtls", {"regression": "integrated", "window_s": 0.5}),
    ("resistance4", {"outliers": {}}),
]


def rough_block():
    d = drive(40.0, grade=lambda t: 0.03 * np.sin(t / 7), noise_mps2=0.05, gaps=True)
    accel = d.block.accel_mps2.copy()
    accel[[300, 301, 900]] = np.nan  # not usable, though no gate says so
    ax_ok = np.ones(len(accel), bool)
    ax_ok[100:140] = False
    return with_columns(d.block, accel_mps2=accel, ax_ok=ax_ok)


BLOCK = rough_block()
WHOLE = {}


def whole(name, options, compiled):
    key = (name, str(options), compiled)
    if key not in WHOLE:
        jit.enable(compiled)
        try:
            WHOLE[key] = join([create(name, FACTS, options).update(BLOCK)])
        finally:
            jit.enable(False)
    return WHOLE[key]


def same(a, b):
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@pytest.mark.parametrize(("name", "options"), CASES)
@settings(max_examples=6, deadline=None)
@given(edges=st.lists(st.integers(0, len(BLOCK)), max_size=12))
def test_any_cut_gives_the_same_bits(name, options, edges):
    method = create(name, FACTS, options)
    same(join([method.update(part) for part in cut(BLOCK, edges)]), whole(name, options, False))


@pytest.mark.parametrize(("name", "options"), CASES)
def test_live_sized_blocks_give_the_same_bits(name, options):
    method = create(name, FACTS, options)
    parts = [method.update(BLOCK[k : k + 1]) for k in range(1000)]
    expected = {key: column[:1000] for key, column in whole(name, options, False).items()}
    same(join(parts), expected)


@pytest.mark.skipif(not jit.available(), reason="numba is an extra")
@pytest.mark.parametrize(("name", "options"), CASES)
def test_compiled_and_interpreted_give_the_same_bits(name, options):
    same(whole(name, options, True), whole(name, options, False))


@pytest.mark.skipif(not jit.available(), reason="numba is an extra")
@pytest.mark.parametrize(("name", "options"), CASES)
def test_compiled_any_cut_gives_the_same_bits(name, options):
    jit.enable(True)
    try:
        method = create(name, FACTS, options)
        parts = [method.update(part) for part in cut(BLOCK, [1, 199, 200, 201, 640, 999, 1300])]
    finally:
        jit.enable(False)
    same(join(parts), whole(name, options, False))


@pytest.mark.parametrize("name", PAPERS)
def test_gated_samples_change_nothing_that_is_learned(name):
    gate = BLOCK.gate.copy()
    gate[700:1200] = Gate.BRAKE
    spoiled = {
        column: np.where(gate != 0, 1e5, getattr(BLOCK, column))
        for column in ("force_N", "accel_mps2", "speed_mps")
    }
    restart = BLOCK.restart.copy()
    restart[1:] |= gate[:-1] != 0
    base = with_columns(BLOCK, gate=gate, restart=restart, ax_ok=BLOCK.ax_ok & (gate == 0))
    bad = with_columns(base, **spoiled)
    one, two = create(name, FACTS, {}).update(base), create(name, FACTS, {}).update(bad)
    np.testing.assert_array_equal(one.mass_kg, two.mass_kg)
    np.testing.assert_array_equal(one.grade, two.grade)


@pytest.mark.parametrize("name", PAPERS)
def test_an_empty_block_gives_an_empty_estimate(name):
    method = create(name, FACTS, {})
    assert len(method.update(BLOCK[:0])) == 0
    assert len(method.update(BLOCK[:5])) == 5
    assert len(method.update(BLOCK[:0])) == 0


@pytest.mark.parametrize("name", PAPERS)
def test_a_restored_mass_is_where_it_starts(name):
    method = create(name, FACTS, {})
    method.restore(31_000.0, 500.0)
    r = method.update(BLOCK[:1])
    assert r.mass_kg[0] == pytest.approx(31_000.0, rel=0.05)


@pytest.mark.parametrize("name", [n for n in PAPERS if n != "dgo"])
def test_a_snapshot_holds_what_was_learned(name):
    method = create(name, FACTS, {})
    assert method.snapshot() == {}
    r = method.update(BLOCK)
    assert method.snapshot() == {"mass_kg": r.mass_kg[-1], "mass_std_kg": r.mass_std_kg[-1]}


@pytest.mark.parametrize("name", PAPERS)
def test_a_start_value_nobody_confirmed_is_unestimated(name):
    facts = replace(FACTS, initial_mass_kg=20_000.0)
    gate = np.full(50, Gate.STALE, np.uint8)
    r = create(name, facts, {}).update(with_columns(BLOCK[:50], gate=gate))
    assert (r.status == Status.UNESTIMATED).all()
    assert (r.mass_kg == r.mass_kg[0]).all()
