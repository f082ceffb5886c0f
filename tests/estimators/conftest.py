"""What tests of the benchmarks share."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark_module():
    """Return what imports a module of `benchmarks/` by name; afterwards none of them is left."""
    before, known = list(sys.path), set(sys.modules)
    sys.path.insert(0, str(BENCHMARKS))
    try:
        yield import_module
    finally:
        sys.path[:] = before
        for name in set(sys.modules) - known:
            if Path(getattr(sys.modules[name], "__file__", None) or ".").parent == BENCHMARKS:
                del sys.modules[name]
