"""The linters are part of the tests: what does not pass them does not pass."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CHECKS = {
    "ruff check": ["ruff", "check", "--no-cache", "."],
    "ruff format": ["ruff", "format", "--no-cache", "--check", "."],
    "mypy --strict": ["mypy", "--strict"],
    # The guest harness is a package of its own, run by hand too.
    "mypy --strict guest": ["mypy", "--strict", "--explicit-package-bases", "tests/vcan/guest"],
}


@pytest.mark.parametrize("check", CHECKS)
def test_source_passes(check: str) -> None:
    command = [sys.executable, "-m", *CHECKS[check]]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False,
        env=os.environ | {"MYPYPATH": str(ROOT / "tests" / "vcan")},
    )  # fmt: skip
    assert done.returncode == 0, f"{' '.join(command[2:])}\n{done.stdout}{done.stderr}"


@pytest.mark.parametrize(
    "script", sorted(p.relative_to(ROOT).as_posix() for p in (ROOT / "benchmarks").rglob("*.py"))
)
def test_benchmarks_ask_for_what_is_there(script: str) -> None:
    """They are run by hand, and their other imports may be missing."""
    for node in ast.walk(ast.parse((ROOT / script).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("canest"):
            exec(ast.unparse(node), {})
