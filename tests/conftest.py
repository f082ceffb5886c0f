"""Under pytest-xdist, tests that must share a worker do, without another word on the command line."""

from __future__ import annotations

from typing import Any

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Let a worker append each test's group to its id: the scheduler goes by nothing else."""
    if hasattr(config, "workerinput"):
        config.option.loadgroup = True


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Schedule by ``xdist_group``: all tests of one guest machine in one worker."""
    from xdist.scheduler import LoadGroupScheduling

    return LoadGroupScheduling(config, log)
