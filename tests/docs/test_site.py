"""The site builds without a warning and has every page; the generated files are current."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"(https?:)?//", re.I)


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_loads_nothing_from_elsewhere(tmp_path):
    output = tmp_path / "site"
    command = [sys.executable, str(ROOT / "tools" / "build_site.py"), "-o", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = list(output.rglob("*.html"))
    assert not [page for page in pages if LOADED.search(page.read_text(encoding="utf-8"))]
    for page in (ROOT / "docs").rglob("*.md"):
        if page != ROOT / "docs" / "README.md":
            assert (output / page.relative_to(ROOT / "docs")).with_suffix(".html").exists(), page
    assert '"tutorials/newcomer"' in (output / "searchindex.js").read_text(encoding="utf-8")


def test_commands_page_man_pages_and_completion_are_current():
    tool = runpy.run_path(str(ROOT / "tools" / "commands_page.py"))
    assert tool["main"]([]) == 0, "python tools/commands_page.py --write"


def test_every_command_has_a_man_page_without_faults_of_form():
    from canest.cli.main import COMMANDS

    folder = ROOT / "shell" / "man"
    for name in COMMANDS:
        page = (folder / f"canest-{name}.1").read_text(encoding="utf-8")
        assert page.startswith(".TH ") and ".SH OPTIONS" in page and ".SH EXIT STATUS" in page
