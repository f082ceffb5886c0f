"""The report of a fleet in a real browser: tables can be sorted and searched, figures are drawn."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest

from canest.fleet.lake import Lake
from canest.fleet.report import write_report
from tests.fleet.test_report import START, put
from tests.serve.browser import BROWSER, Browser

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no Chromium here")]
AXE = Path(__file__).parents[1] / "serve" / "axe.min.js"
DRAWN = "document.documentElement.dataset.drawn === 'yes'"
VEHICLES = "[...document.querySelector('table.sortable').rows].slice(1).filter(r => !r.hidden)"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The report of twenty vehicles, of which one has no valid mass."""
    folder = tmp_path_factory.mktemp("fleet")
    lake = Lake.create(str(folder / "lake"))
    for vehicle in range(20):
        for number in range(12):
            valid = vehicle != 3
            put(
                lake, f"truck-{vehicle}", 100 * vehicle + number, distance_m=1000.0 * (vehicle + 1),
                start=START + datetime.timedelta(days=3 * number), status="valid" if valid else "converging",
                mass_kg=9000.0 + 1000.0 * vehicle if valid else None, reason="" if valid else "no torque",
            )  # fmt: skip
    write_report(str(folder / "lake"), str(folder / "report"), lambda share: None)
    return folder / "report"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


def opened(browser, path):
    tab = browser.page(f"file://{path}")
    tab.wait(DRAWN, 30)
    return tab


def click(tab, title):
    buttons = "[...document.querySelectorAll('table.sortable .sort')]"
    tab.run(f"{buttons}.find(b => b.textContent === '{title}').click()")


def first_cells(tab):
    return tab.run(f"{VEHICLES}.map(r => r.cells[0].textContent)")


def test_a_click_on_a_title_sorts_numbers_from_the_largest_and_what_is_not_known_comes_last(browser, folder):
    tab = opened(browser, folder / "index.html")
    click(tab, "median mass, t")
    assert first_cells(tab)[:2] == ["truck-19", "truck-18"]
    assert first_cells(tab)[-1] == "truck-3"
    assert tab.run("document.querySelector('th[aria-sort]').textContent") == "median mass, t"
    click(tab, "median mass, t")
    assert first_cells(tab)[:2] == ["truck-0", "truck-1"]
    assert first_cells(tab)[-1] == "truck-3"
    click(tab, "vehicle")
    assert first_cells(tab)[:3] == ["truck-0", "truck-1", "truck-10"]


def test_a_search_leaves_the_rows_that_have_the_words(browser, folder):
    tab = opened(browser, folder / "index.html")
    tab.run("var i = document.querySelector('input[type=search]'); i.value = 'TRUCK-1'; 0")
    tab.run("i.dispatchEvent(new Event('input'))")
    assert len(first_cells(tab)) == 11
    assert tab.run("document.querySelector('.search [role=status]').textContent") == "11 of 20"


def test_the_index_leads_to_a_vehicle_and_back(browser, folder):
    tab = opened(browser, folder / "index.html")
    there = tab.run("[...document.querySelectorAll('td a')].find(a => a.textContent === 'truck-7').href")
    page = opened(browser, there.removeprefix("file://"))
    assert page.run("document.querySelector('h1').textContent") == "truck-7: 12 trips, 96 km"
    assert page.run("document.querySelectorAll('.figure .scatterlayer .point').length") > 12
    assert page.run("document.querySelector('.kicker a').href").endswith("/report/index.html")


@pytest.mark.parametrize("name", ["index.html", "vehicles/vehicle-truck-7.html"])
def test_everybody_can_use_the_pages(browser, folder, name):
    tab = opened(browser, folder / name)
    tab.run(AXE.read_text() + ";0")
    found = tab.run("axe.run().then(r => r.violations.map(v => [v.id, v.nodes.map(n => n.html)]))")
    assert found == []
    assert tab.run("document.documentElement.scrollWidth <= innerWidth")
