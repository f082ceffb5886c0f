"""Under pytest-xdist, tests that must share a worker do, without another word on the command line."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give all tests of one guest machine to one worker (see `vcan/conftest.py`), any other test to anyone.

    By module: xdist's own groups travel in test ids, where pytest 9.2 no longer lets it write them.
    """
    from xdist.scheduler import LoadScopeScheduling

    class OneGuestOneWorker(LoadScopeScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            module = nodeid.partition("::")[0]
            if "vcan/" not in module:
                return nodeid
            return "guest-2" if module.endswith("/test_service.py") else "guest-1"

    return OneGuestOneWorker(config, log)
