"""Commands that run with what is installed in a folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from example_helpers import ROOT


@pytest.fixture
def canest_with(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Return a runner of `canest ARGUMENTS` that sees what is installed in a folder besides."""

    def call(target: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join((str(target), str(ROOT)))
        return subprocess.run(
            [sys.executable, "-m", "canest", *map(str, arguments)],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
            timeout=120, check=False,
        )  # fmt: skip

    return call
