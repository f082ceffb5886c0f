"""The examples of docstrings, of the notebook page and of the README run as they stand."""

from __future__ import annotations

import doctest
import inspect
import re
from pathlib import Path

import pytest

import canest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


def examples():
    """Yield (name, doctest) of every public docstring that has an example."""
    finder = doctest.DocTestFinder(recurse=False)
    for name in canest.__all__:
        value = getattr(canest, name)
        owned = [(name, value)]
        if inspect.isclass(value):
            owned += [(f"{name}.{m}", getattr(value, m)) for m in vars(value) if not m.startswith("_")]
        for shown, item in owned:
            if callable(item) and (item.__module__ or "").startswith("canest"):
                yield from ((shown, test) for test in finder.find(item, shown, globs={}) if test.examples)


EXAMPLES = [
    pytest.param(
        test, id=name, marks=[pytest.mark.slow] if name in ("diagnose", "Diagnosis", "simulate") else []
    )
    for name, test in examples()
]


def test_every_function_and_result_has_an_example():
    shown = {param.id for param in EXAMPLES}
    for name in canest.__all__:
        value = getattr(canest, name)
        small = inspect.isclass(value) and issubclass(value, Exception | int)
        if callable(value) and not small and name not in ("Config", "FrameBlock"):
            assert name in shown


@pytest.mark.parametrize("example", EXAMPLES)
def test_example_of_a_docstring_shows_no_number_of_numpy(example):
    """numpy 1 and 2 write them differently: 3.0, np.float64(3.0)."""
    assert not any("np." in shown.want for shown in example.examples)


@pytest.mark.parametrize("example", EXAMPLES)
def test_example_of_a_docstring_runs(example):
    failed = []
    doctest.DocTestRunner(verbose=False).run(example, out=failed.append)
    assert failed == []


def code_of(page: str) -> list[str]:
    return BLOCK.findall((ROOT / page).read_text())


@pytest.mark.slow
def test_notebook_page_runs_from_top_to_bottom(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib").use("Agg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = code_of("docs/notebook.md")
    assert len(blocks) >= 12
    for block in blocks:
        if "estimators.RLS(" in block and not hasattr(canest.estimators, "RLS"):
            continue
        exec(compile(block, "docs/notebook.md", "exec"), names)
    assert (tmp_path / "mass.png").stat().st_size > 10_000
    assert [p.name for p in tmp_path.iterdir()] == ["mass.png"]
    errors = [names[found].summary["errors"]["mass_rms_pct"] for found in ("result", "from_table", "better")]
    assert max(errors) < 5.0
    assert errors[2] < 0.5
    assert names["before"].summary["errors"]["mass_rms_pct"] > 2.5  # by as much as the radius is off


def test_python_in_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = code_of("README.md")
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    assert "valid" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
