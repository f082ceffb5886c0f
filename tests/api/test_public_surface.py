"""What `import canest` offers is a contract: a change here is a change for everybody's notebooks."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import canest

ROOT = Path(__file__).resolve().parents[2]
SURFACE = Path(__file__).with_name("public_surface.txt")
TOOL = runpy.run_path(str(ROOT / "tools" / "api_page.py"))


def surface() -> list[str]:
    """Return every public name with its signature, fields and methods, sorted."""
    lines = []
    for name in canest.__all__:
        value = getattr(canest, name)
        if inspect.isfunction(value):
            lines.append(TOOL["signature"](name, value))
        elif inspect.isclass(value):
            lines.append(TOOL["signature"](name, value) if value is canest.Pipeline else name)
            if dataclasses.is_dataclass(value):
                public = [f.name for f in dataclasses.fields(value) if not f.name.startswith("_")]
                lines += [f"{name}.{field}" for field in public]
            if value is canest.Vehicle:
                lines += [f"{name}.{field}" for field in value.model_fields]
            if name not in ("Config", "Vehicle") and not issubclass(value, Exception | int):
                lines += [_member(name, *member) for member in TOOL["members"](value)]
        else:
            lines.append(name)
    return sorted(lines)


def _member(name: str, member: str, value: object) -> str:
    if isinstance(value, property):
        return f"{name}.{member}"
    return f"{name}." + TOOL["signature"](member, value)


def test_public_surface_is_as_it_was():
    """Write it anew with `python tests/api/test_public_surface.py`, and say so in the changelog."""
    assert surface() == SURFACE.read_text().splitlines()


def test_api_page_is_made_from_the_docstrings():
    assert TOOL["PAGE"].read_text() == TOOL["page"](), "python tools/api_page.py --write"


def test_names_of_package_and_api_are_the_same():
    from canest import api

    assert sorted(set(canest.__all__) - {"estimators"}) == sorted(api.__all__)


def test_a_type_checker_sees_the_names_that_there_are():
    stub = ast.parse((ROOT / "canest" / "__init__.pyi").read_text())
    imported = {a.name for n in stub.body if isinstance(n, ast.ImportFrom) for a in n.names}
    listed = next(n.value for n in stub.body if isinstance(n, ast.Assign))
    assert ast.literal_eval(listed) == canest.__all__
    assert imported == set(canest.__all__)
    assert dir(canest) == sorted([*canest.__all__, "__version__"])


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'replai'"):
        _ = canest.replai
    with pytest.raises(ImportError):
        exec("from canest import replai")


def test_no_subpackage_carries_the_name_of_a_public_function():
    packages = {path.name.removesuffix(".py") for path in (ROOT / "canest").iterdir()}
    assert packages & set(canest.__all__) == {"estimators"}


def test_top_of_the_package_holds_nothing_else():
    files = {path.name for path in (ROOT / "canest").iterdir() if path.is_file()}
    assert files == {"__init__.py", "__init__.pyi", "__main__.py", "api.py", "py.typed"}


@pytest.mark.parametrize("statement", ["import canest", "import canest; dir(canest); canest.__version__"])
def test_importing_canest_imports_nothing_else(statement):
    code = f"import sys; before = set(sys.modules); {statement}; print(sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "['canest']"


def test_importing_the_api_leaves_heavy_packages_alone():
    code = "import sys, canest; canest.replay; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    heavy = {"pandas", "polars", "pyarrow", "numba", "can", "cantools", "scipy", "matplotlib", "plotly"}
    ours = {"canest.simulation.run", "canest.diagnosis.run", "canest.offline.replay", "canest.cli"}
    assert set(done.stdout.split()) & (heavy | ours) == set()


def test_a_type_checker_sees_every_name():
    """`typed_use.py` is checked with the rest by mypy (`tests/test_quality.py`)."""
    text = (ROOT / "tests" / "api" / "typed_use.py").read_text()
    assert [name for name in canest.__all__ if f"canest.{name}" not in text] == []


if __name__ == "__main__":
    SURFACE.write_text("\n".join(surface()) + "\n")
