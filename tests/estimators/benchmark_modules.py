"""Fixtures that import a module of `benchmarks/`."""

from __future__ import annotations

from typing import Any

import pytest


def benchmark(name: str) -> Any:
    """Return a fixture: the module of that name, for the tests of one file."""

    @pytest.fixture(scope="module")
    def module(benchmark_module: Any) -> Any:
        return benchmark_module(name)

    return module
