"""The papers' experiments run as one command and write their page."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).resolve().parents[2] / "benchmarks" / "papers" / "run.py"


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="figures need matplotlib")
@pytest.mark.parametrize(("year", "figures"), [("2005", 8), ("2013", 4), ("2014", 6)])
def test_one_command_writes_figures_and_tables(tmp_path, year, figures):
    command = [sys.executable, str(RUN), "-o", str(tmp_path), "--only", year]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert page.count("<table>") >= 2
    assert len(list(tmp_path.glob("*.png"))) >= figures
    assert "nan" not in page.split("<style>")[1].split("</style>")[1].replace("finan", "")
