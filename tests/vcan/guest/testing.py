"""One pytest inside a guest for the pytest outside: tests go in by node id, reports come out one by one."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import pytest

from guest.bytecode import write_bytecode
from guest.machine import Guest, GuestError

#: From boot to the end of the last test; the guest is killed past it.
GUEST_TIMEOUT_S = 900.0
_REPORTS = "reports.jsonl"
_INSIDE = "CANEST_INSIDE_GUEST"


def inside() -> bool:
    """Whether this process runs in the guest."""
    return _INSIDE in os.environ


class ReportWriter:
    """Pytest plugin for the inside: hands each report out as soon as it exists."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._path = Path(os.environ["GUEST_OUT"], _REPORTS)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        with self._path.open("a") as lines:
            lines.write(json.dumps(data) + "\n")


class GuestRun:
    """The one guest of a test session: booted when the first test's reports are asked for."""

    def __init__(self, config: pytest.Config, node_ids: Sequence[str]) -> None:
        self._config, self._node_ids = config, list(node_ids)
        self._guest: Guest | None = None
        self._failed: GuestError | None = None
        self._reports: dict[str, list[pytest.TestReport]] = {}
        self._lines_read = 0

    def reports(self, item: pytest.Item) -> list[pytest.TestReport]:
        """Wait for one test's reports; where the guest cannot give them, a failed one that says why."""
        try:
            self._wait_for(item.nodeid)
        except GuestError as error:
            # The first test says it all, those after it only that they had no guest.
            self._failed = GuestError(f"no guest any more: {str(error).splitlines()[0]}")
            keywords: dict[str, Literal[1]] = dict.fromkeys(item.keywords, 1)
            failure = pytest.TestReport(item.nodeid, item.location, keywords, "failed", str(error), "call")
            return [*self._reports.get(item.nodeid, []), failure]
        return self._reports[item.nodeid]

    def _wait_for(self, node_id: str) -> None:
        guest = self._booted()
        for _ in guest.follow(GUEST_TIMEOUT_S):
            if self._is_complete(guest, node_id):
                return
        if not self._is_complete(guest, node_id):
            raise GuestError(f"guest ended before this test did\n{guest.last_words()}")

    def _booted(self) -> Guest:
        if self._failed:
            raise self._failed
        if self._guest is None:
            write_bytecode(self._config.rootpath, _INSIDE)
            command = [sys.executable, "-m", "pytest", "-v", "-o", "addopts=", "--strict-markers"]
            command += ["-p", "no:cacheprovider", "-o", "faulthandler_timeout=90", *self._node_ids]
            # No plugin of the host's environment is needed, and importing one costs seconds in emulation.
            env = {_INSIDE: "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
            self._guest = Guest(command, init="systemd", cwd=self._config.rootpath, env=env).__enter__()
        return self._guest

    def _is_complete(self, guest: Guest, node_id: str) -> bool:
        path = guest.out / _REPORTS
        whole_lines = path.read_text().split("\n")[:-1] if path.exists() else []
        for line in whole_lines[self._lines_read :]:
            report = self._config.hook.pytest_report_from_serializable(
                config=self._config, data=json.loads(line)
            )
            self._reports.setdefault(report.nodeid, []).append(report)
        self._lines_read = len(whole_lines)
        return any(report.when == "teardown" for report in self._reports.get(node_id, []))

    def close(self) -> None:
        """Switch the guest off."""
        if self._guest is not None:
            self._guest.__exit__(None, None, None)
