"""Runs code in an interpreter of its own, where nothing has been imported yet."""

from __future__ import annotations

import subprocess
import sys


def output_of(code: str) -> str:
    """Return what the code prints; it must end with success within a minute."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
