"""Under pytest-xdist, tests that share something run in one worker, whatever the command line says."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canest.core import jit


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give all tests of a module to one worker, and all of one guest machine (see `vcan/conftest.py`).

    So a module's fixtures, drives and diagnoses of many seconds among them, are made once and not once per
    worker. By module: xdist's own groups travel in test ids, where pytest 9.2 no longer lets it write them.
    """
    from xdist.scheduler import LoadScopeScheduling

    class OneModuleOneWorker(LoadScopeScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            module = nodeid.partition("::")[0]
            if "vcan/" not in module or module.endswith("/test_debian_package.py"):
                return str(module)  # that one has a guest of its own, and measures nothing against the clock
            other_half = module.endswith(("/test_minute.py", "/test_service.py"))
            return "guest-2" if other_half else "guest-1"

    config.option.loadscopereorder = False  # the order below, not the number of tests
    return OneModuleOneWorker(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Under xdist, put modules with slow tests first and those of a guest machine last.

    A guest measures a daemon against the clock, in emulation: it may not share its processor with the rest.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    guests = {item.path for item in items if item.get_closest_marker("vcan")}
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: 2 if item.path in guests else 0 if item.path in slow else 1)


@pytest.fixture(scope="module")
def compiled() -> Iterator[None]:
    """Run kernels compiled, where numba is installed: the same bits at a twentieth of the time.

    That they are the same is tested in tests/estimators and tests/pipeline (test_any_cut).
    """
    jit.enable()
    yield
    jit.enable(False)


@pytest.fixture
def stream(tmp_path: Path) -> Iterator[Any]:
    """A stream of estimates as a daemon gives it, for those who follow one."""
    from tests.serve.rig import Stream

    stream = Stream(tmp_path)
    yield stream
    stream.close()
