"""What stands on what, and how large a part may be: docs/architecture.md cannot go stale unnoticed.

What is not met yet is listed here by name. The lists may only shrink: an entry that nothing needs any more
fails the test until it is removed.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "canest"

MOST_LINES_OF_A_FILE, MOST_LINES_OF_A_FUNCTION, MOST_ARGUMENTS = 300, 60, 8
#: all that may lie at the top of canest/
PUBLIC = {"__init__.py", "__init__.pyi", "__main__.py", "api.py", "py.typed"}

VERSION_0_1 = "kernels of the default estimator, whose state is given one by one"
DEFAULT = "the compiled loop of the default, and kernels that take vectors and matrices one by one"
RECURSION = "one loop over one documented recursion: a call per sample costs more than its work"

LARGE_FILES = {
    "estimators/canest_0_1/kernel.py": VERSION_0_1,
}
LONG_FUNCTIONS = {
    "estimators/canest_0_1/filter.py: settle": VERSION_0_1,
    "estimators/canest_0_1/kernel.py: run": VERSION_0_1,
    "estimators/default/kernel.py: run": DEFAULT,
    "estimators/papers/kidambi2014/ekf_filter.py: ekf_steps": RECURSION,
    "estimators/papers/vahidi2005/rls.py: matrix_rls": RECURSION,
}
MANY_ARGUMENTS = {
    "estimators/canest_0_1/axle.py: slip_seen": VERSION_0_1,
    "estimators/canest_0_1/coarse.py: coarse_grade": VERSION_0_1,
    "estimators/canest_0_1/filter.py: correct": VERSION_0_1,
    "estimators/canest_0_1/filter.py: start": VERSION_0_1,
    "estimators/canest_0_1/kernel.py: run": VERSION_0_1,
    "estimators/canest_0_1/senses.py: feel": VERSION_0_1,
    "estimators/canest_0_1/senses.py: retard": VERSION_0_1,
    "estimators/default/hypotheses.py: exchange": DEFAULT,
    "estimators/default/kernel.py: run": DEFAULT,
    "estimators/default/load.py: new_density": DEFAULT,
    "estimators/default/load.py: open_load": DEFAULT,
    "estimators/default/sensors.py: accelerometer": DEFAULT,
    "estimators/default/update.py: condition_all_but_mass": DEFAULT,
}


def test_imports_go_down_and_never_in_circles() -> None:
    """The contracts stand in pyproject.toml under tool.importlinter."""
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_room_has_its_floor() -> None:
    """Nothing lies loose beside the rooms, and each room is a package that says what it is for."""
    loose = {path.name for path in PACKAGE.iterdir() if path.is_file()}
    assert loose <= PUBLIC
    for init in PACKAGE.rglob("__init__.py"):
        assert ast.get_docstring(ast.parse(init.read_text(encoding="utf-8"))), init


def test_the_page_lists_the_packages_in_the_order_of_the_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    page = (ROOT / "docs" / "architecture.md").read_text().partition("## What stands on what")[2]
    listed = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert listed == [name for layer in layers if (name := layer.strip("()")) in rooms]
    assert set(listed) == rooms


def _sources() -> Iterator[tuple[str, str]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path.relative_to(PACKAGE).as_posix(), path.read_text(encoding="utf-8")


def _functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    for name, text in _sources():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{name}: {node.name}", node


def _arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    every = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return sum(argument.arg not in ("self", "cls") for argument in every)


def _too_large(what: str) -> set[str]:
    if what == "files":
        return {n for n, text in _sources() if len(text.splitlines()) > MOST_LINES_OF_A_FILE}
    if what == "functions":
        lines = ((name, (f.end_lineno or f.lineno) - f.lineno + 1) for name, f in _functions())
        return {name for name, count in lines if count > MOST_LINES_OF_A_FUNCTION}
    return {name for name, f in _functions() if _arguments(f) > MOST_ARGUMENTS}


@pytest.mark.parametrize(
    ("what", "listed"),
    [("files", LARGE_FILES), ("functions", LONG_FUNCTIONS), ("arguments", MANY_ARGUMENTS)],
)
def test_nothing_grows_too_large(what: str, listed: dict[str, str]) -> None:
    found = _too_large(what)
    assert not found - listed.keys(), "too large: cut it"
    assert not listed.keys() - found, "no longer too large: remove the entry"
