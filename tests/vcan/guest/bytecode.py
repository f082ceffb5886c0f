"""The bytecode of what a guest imports, written here: compiling it there takes most of a minute per process.

Written whatever ``PYTHONDONTWRITEBYTECODE`` asks for, since what a guest writes is gone with it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

#: A command that imports what the daemon takes from other packages.
_IMPORTS = ("-m", "canest", "replay", "tests/data/kenworth/normal.log.xz", "-c", "kenworth")
_OWN = ("-m", "compileall", "-q", "canest", "tests/vcan")
_COLLECTS = ("-m", "pytest", "-qq", "--collect-only", "-p", "no:cacheprovider", "tests/vcan")


def write_bytecode(root: Path, inside: str) -> None:
    """Compile canest, what it imports and the tests. inside: the variable that a pytest in a guest has."""
    with tempfile.TemporaryDirectory() as folder:
        env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        env |= {inside: "1", "GUEST_OUT": folder, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
        for arguments in (_IMPORTS, _OWN, _COLLECTS):
            subprocess.run([sys.executable, *arguments], cwd=root, env=env, capture_output=True, check=False)
