"""Runs the ``vcan`` tests where a real SocketCAN is: here if this kernel has one, else in a guest machine.

The guest is booted once, when the first such test is due, and one pytest in it runs them all; every report
comes back as that test's own result. Under xdist there are two guests, each for half of the work. Tests also
marked ``guest`` (they set clocks, mount file systems or need systemd as process 1) run in it on every host.

Under CI nothing is skipped: a guest that cannot start fails every test that it should have run.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest
from guest import missing_tools, testing

_RUNS = pytest.StashKey[dict[str, testing.GuestRun]]()
_ABROAD = pytest.StashKey[str]()
#: The modules whose tests take half of the time; `tests/conftest.py` gives them to another worker.
_OTHER_HALF = ("test_minute", "test_service")
_NUMBERS = itertools.count()


def _own_kernel_has_vcan() -> bool:
    """Whether this process may make a vcan interface, tried by making one."""
    name = f"vp{os.getpid()}"
    try:
        made = subprocess.run(["ip", "link", "add", name, "type", "vcan"], capture_output=True, check=False)
    except OSError:
        return False
    if made.returncode == 0:
        subprocess.run(["ip", "link", "delete", name], capture_output=True, check=False)
    return made.returncode == 0


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers", "guest: sets clocks, mounts or needs systemd: runs in the guest on any host"
    )
    if testing.inside():
        # python-can would import it for log formats that no test here reads: half a minute in emulation
        sys.modules["asammdf"] = None  # type: ignore[assignment]
        config.pluginmanager.register(testing.ReportWriter(config))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Decide, once for all vcan tests, where they run."""
    vcan = [item for item in items if item.get_closest_marker("vcan")]
    if not vcan or testing.inside():
        return
    native = _own_kernel_has_vcan()
    abroad = [item for item in vcan if not native or item.get_closest_marker("guest")]
    missing = missing_tools("systemd")
    if missing and "CI" not in os.environ:
        skip = pytest.mark.skip(reason=f"needs a guest machine: apt-get install {' '.join(missing)}")
        for item in abroad:
            item.add_marker(skip)
        return
    shared = "PYTEST_XDIST_WORKER" in os.environ
    guests: dict[str, list[str]] = {}
    for item in abroad:
        guest = "guest-2" if shared and item.path.stem in _OTHER_HALF else "guest-1"
        item.stash[_ABROAD] = guest
        guests.setdefault(guest, []).append(item.nodeid)
    config.stash[_RUNS] = {guest: testing.GuestRun(config, ids) for guest, ids in guests.items()}


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> bool | None:
    """Take a test's reports from the guest instead of running it here."""
    if _ABROAD not in item.stash:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in item.config.stash[_RUNS][item.stash[_ABROAD]].reports(item):
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_unconfigure(config: pytest.Config) -> None:
    for run in config.stash.get(_RUNS, {}).values():
        run.close()


@pytest.fixture
def vcan() -> Iterator[str]:
    """A fresh vcan interface of the test's own, up."""
    name = f"vt{next(_NUMBERS)}"
    subprocess.run(["ip", "link", "add", name, "type", "vcan"], check=True)
    subprocess.run(["ip", "link", "set", name, "up"], check=True)
    yield name
    subprocess.run(
        ["ip", "link", "delete", name], check=False, capture_output=True
    )  # a test may have done so
