"""What is compiled once and loaded later is what stands in the source now."""

from __future__ import annotations

import gc
import importlib
import sys
from collections import namedtuple
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from canest.core import jit
from canest.core.jit import borrowed
from canest.estimators.default.kernel import run

COMPILES = pytest.mark.skipif(not jit.available(), reason="numba is not installed")
CALLED = """import math

import numpy as np

from canest.core import jit

GAIN = {gain}


@jit.kernel
def scaled(x):
    return GAIN * math.{function}(x)
"""
INDEXED = """from canest.core import jit

FIRST, SECOND = 0, 1


@jit.kernel
def taken(x, i):
    return x[i]


@jit.kernel
def run(x):
    return taken(x, FIRST) + 10.0 * taken(x, SECOND)
"""
CALLER = """from canest.core import jit
from {called} import scaled


@jit.kernel
def run(x):
    return scaled(x) + 1.0
"""


@COMPILES
def test_a_change_in_a_kernel_that_another_file_calls_is_seen(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    called, caller = tmp_path / "called_kernel.py", tmp_path / "calling_kernel.py"
    caller.write_text(CALLER.format(called=called.stem))
    found = []
    for gain, function in (("2.0", "floor"), ("30.0", "floor"), ("30.0", "ceil"), ("np.float32(4)", "ceil")):
        called.write_text(CALLED.format(gain=gain, function=function))
        for name in (called.stem, caller.stem):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        run = importlib.import_module(caller.stem).run
        found.append((run.interpreted(1.5), run.compiled(1.5)))
    assert found == [(3.0, 3.0), (31.0, 31.0), (61.0, 61.0), (9.0, 9.0)]


@COMPILES
def test_a_kernel_called_with_other_constants_is_not_compiled_again(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "indexed_kernel.py").write_text(INDEXED)
    module = importlib.import_module("indexed_kernel")
    assert module.run.compiled(np.array([1.0, 2.0])) == 21.0
    assert len(module.taken.compiled.signatures) == 1


@COMPILES
def test_a_kernel_that_is_loaded_needs_no_dispatchers_for_those_it_calls(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "kept_kernel.py").write_text(INDEXED)

    def kept(*arrays):
        """Return the files of the kernels that calls compile or load, as in a process of their own."""
        sys.modules.pop("kept_kernel", None)
        run, before = importlib.import_module("kept_kernel").run, len(jit.kept_files())
        assert [run.compiled(array) for array in arrays] == [21.0] * len(arrays)
        return [Path(file) for file in jit.kept_files()[before:]]

    double, single = np.array([1.0, 2.0]), np.array([1.0, 2.0], np.float32)
    run, taken = kept(double)
    assert kept(double) == [run]
    assert kept(double, single) == [run, taken]  # compiled for another type: what it calls is as well
    taken.unlink()
    assert kept(double, single) == [run]
    run.unlink()
    assert kept(single) == [run, taken]
    assert taken.exists()


@COMPILES
def test_where_nothing_compiled_can_be_kept_kernels_run_interpreted(monkeypatch):
    """As in an installation that its user may not write to, with a home that is none."""
    from numba.core import caching

    was = jit.enabled()
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    try:
        assert not jit.enable()
    finally:
        monkeypatch.undo()
        assert jit.enable(was) == was


@COMPILES
def test_a_full_disk_costs_the_next_process_its_time_and_this_one_nothing(monkeypatch):
    from numba.core import caching

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "save", full)
    twice = jit.kernel(lambda x: 2.0 * x)
    assert twice.compiled(4.0) == 8.0


@COMPILES
def test_who_waits_is_told_once_that_kernels_are_compiled(monkeypatch, tmp_path):
    from numba.core import config

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    told = []

    def results():
        jit.before_compiling(lambda: told.append("compiling"))
        return [jit.kernel(lambda x: 3.0 * x).compiled(4.0), jit.kernel(lambda x: 5.0 * x).compiled(4.0)]

    assert results() == [12.0, 20.0] and told == ["compiling"]
    assert results() == [12.0, 20.0] and told == ["compiling"]  # both are kept


def test_another_layout_of_a_tuple_that_a_kernel_takes_is_another_kernel():
    """Compiled code takes a field by its place: what is kept is of no use where that is another's."""

    def content(fields):
        scope = {"Pair": namedtuple("Pair", fields)}
        exec("def first(p: 'Pair') -> float:\n    return p.a", scope)
        return jit.kernel(scope["first"]).content()

    assert content("a b") == content("a b") != content("b a")
    for within in ("first_noise_windows", "speed_first_mps", "unseen_s", "learned"):  # of what a loop takes
        assert repr(within) in run.content()


class Held(NamedTuple):
    """Arrays in a tuple, with a number beside them."""

    columns: tuple[Any, Any]
    table: Any
    number: float


@jit.kernel
def doubled(held, column):
    held, column = borrowed(held), borrowed(column)
    for i in range(len(column)):
        column[i] *= 2.0
        held.columns[1][i] += column[i]
        held.table[i, 0] = held.columns[0][i] * held.number
    return held.table[0, 0]


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILES)])
def test_borrowed_arrays_are_the_callers_own_and_outlive_the_call(compiled):
    jit.enable(compiled)
    try:
        for _ in range(3):  # an array whose users were counted wrongly would be freed
            held = Held((np.arange(4.0), np.zeros(4)), np.zeros((4, 2)), 3.0)
            column = np.ones(4)
            users = [sys.getrefcount(array) for array in (column, held.table, held.columns[0])]
            assert doubled(held, column) == 0.0
            gc.collect()
            assert column.tolist() == [2.0] * 4
            assert held.columns[1].tolist() == [2.0] * 4
            assert held.table[:, 0].tolist() == [0.0, 3.0, 6.0, 9.0]
            assert users == [sys.getrefcount(array) for array in (column, held.table, held.columns[0])]
    finally:
        jit.enable(False)
