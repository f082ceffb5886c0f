"""The site builds without a warning and has every page; the generated files are current."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.serve.browser import BROWSER, Browser

ROOT = Path(__file__).resolve().parents[2]
AXE = ROOT / "tests" / "serve" / "axe.min.js"
LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"(https?:)?//", re.I)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("built") / "site"
    command = [sys.executable, str(ROOT / "tools" / "build_site.py"), "-o", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return output


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_loads_nothing_from_elsewhere(site):
    pages = list(site.rglob("*.html"))
    assert not [page for page in pages if LOADED.search(page.read_text(encoding="utf-8"))]
    for page in (ROOT / "docs").rglob("*.md"):
        if page != ROOT / "docs" / "README.md":
            assert (site / page.relative_to(ROOT / "docs")).with_suffix(".html").exists(), page
    assert '"tutorials/newcomer"' in (site / "searchindex.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if BROWSER is None:
        pytest.skip("no Chromium here")
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.mark.slow
def test_the_search_finds_a_page_without_a_network(site, browser):
    tab = browser.page(f"file://{site}/search.html?q=headwind")
    tab.wait("document.querySelectorAll('ul.search li').length >= 3")
    found = tab.run(
        "[...document.querySelectorAll('ul.search li a')].map(a => a.getAttribute('href')).join()"
    )
    assert "diagnosis.html" in found
    assert all(url.startswith(("file:", "data:")) for url in tab.requested())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "width", "scheme"),
    [
        ("index", 1280, "light"),
        ("outputs", 390, "dark"),
        ("config", 390, "light"),
        ("measured/papers", 390, "dark"),
    ],
)
def test_an_accessibility_audit_of_the_site_finds_nothing(site, browser, page, width, scheme):
    tab = browser.page(f"file://{site}/{page}.html", width=width, prefers_color_scheme=scheme)
    tab.wait("true")
    browser.pump(1.0)
    assert tab.run("document.documentElement.scrollWidth") <= width
    assert tab.errors() == []
    tab.run(AXE.read_text())
    rules = "{ runOnly: ['wcag2a', 'wcag2aa'] }"
    found = f"axe.run({rules}).then(r => r.violations.map(v => [v.id, v.nodes[0].html.slice(0, 200)]))"
    assert tab.run(found) == []


def test_commands_page_man_pages_and_completion_are_current():
    # in a process of its own: a command that a test has called alone keeps the options that it had there
    done = subprocess.run([sys.executable, "tools/commands_page.py"], cwd=ROOT, check=False)
    assert done.returncode == 0, "python tools/commands_page.py --write"


def test_every_command_has_a_man_page_without_faults_of_form():
    from canest.cli.main import COMMANDS

    folder = ROOT / "shell" / "man"
    for name in COMMANDS:
        page = (folder / f"canest-{name}.1").read_text(encoding="utf-8")
        assert page.startswith(".TH ") and ".SH OPTIONS" in page and ".SH EXIT STATUS" in page
