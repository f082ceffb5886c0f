"""Reports in a real browser: the cursor's numbers, all samples on zoom, axes, themes, who can use them."""

from __future__ import annotations

import csv
import json
import lzma
import math
import re
from functools import cache
from pathlib import Path

import pytest
import yaml

from canest.demo import DRIVE, TRUTH
from canest.system.shipped_files import shipped
from tests.serve.browser import BROWSER, Browser

pytest.importorskip("jinja2")
pytest.importorskip("plotly")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no Chromium here")]

AXE = Path(__file__).parents[1] / "serve" / "axe.min.js"
#: of the first figure of a page
FIGURE, DRAWN = "canest.figures[0]", "document.documentElement.dataset.drawn === 'yes'"


def with_positions(folder: Path) -> tuple[Path, Path]:
    """Return the bundled drive with a position per second, and a config that has the roles of one."""
    lines, second = [], 0
    with lzma.open(DRIVE, "rt") as drive:
        for line in drive.read().splitlines():
            t_s = float(line[1 : line.index(")")])
            while t_s - 1.7e9 >= second:
                degrees = 47.5 + 0.004 * math.sin(second / 40), 8.25 + 1e-4 * second
                raw = b"".join(round((d + 210) * 1e7).to_bytes(4, "little") for d in degrees)
                lines.append(f"({t_s:.6f}) can0 18FEF317#{raw.hex().upper()}")
                second += 1
            lines.append(line)
    log, config = folder / "drive.log", folder / "truck.yaml"
    log.write_text("\n".join(lines))
    content = yaml.safe_load((shipped("configs") / "class8.yaml").read_text())
    for role in ("latitude", "longitude"):
        content["signals"][role] = {"message": "VP1", "signal": role.title(), "optional": True}
    config.write_text(yaml.safe_dump(content))
    return log, config


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with replay.html, compare.html and est.csv of the bundled drive."""
    from canest.cli.main import run

    folder = tmp_path_factory.mktemp("reports")
    log, config = with_positions(folder)
    replay = ["replay", log, "-c", config, "--truth", TRUTH, "--report", folder / "replay.html"]
    assert (
        run([str(a) for a in [*replay, "-o", folder / "est.csv", "--columns", "speed_mps,distance_m"]]) == 0
    )
    compare = ["compare", log, "-c", config, "--truth", TRUTH, "--only", "canest-0.1,dgo", "--interpreted"]
    assert run([str(a) for a in [*compare, "--report", folder / "compare.html"]]) == 0
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def page(browser, folder):
    return opened(browser, folder / "replay.html")


@pytest.fixture(scope="module")
def comparison(browser, folder):
    return opened(browser, folder / "compare.html")


def opened(browser, path):
    tab = browser.page(f"file://{path}")
    tab.wait(DRAWN, 30)
    return tab


def seen_as(tab, scheme, width=1280, media=""):
    """Let a page be seen in another scheme of colours, width or medium."""
    tab.call(
        "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=width < 600
    )
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    tab.call("Emulation.setEmulatedMedia", media=media, features=features)


@cache
def estimates(folder):
    with (folder / "est.csv").open() as file:
        return list(csv.DictReader(file))


def shown(tab, t_s):
    """Return what the cursor shows at a time since the start: name -> text."""
    tab.run(f"{FIGURE}.cursor.move({t_s})")
    items = "[...document.querySelectorAll('.readout dd')].map(d => [d.dataset.item, d.textContent])"
    return dict(tab.run(items))


def figures_in(text):
    return [float(n) for n in re.findall(r"-?[0-9.]+", text.replace(",", "").replace("−", "-"))]


def violations(tab):
    tab.run(AXE.read_text() + ";0")
    return tab.run("axe.run().then(r => r.violations.map(v => [v.id, v.nodes.map(n => n.html)]))")


@pytest.mark.parametrize("at", [7, 1403, 5555, 8998])
def test_the_cursor_shows_the_numbers_of_est_csv_at_that_time(page, folder, at):
    rows = estimates(folder)
    row, t_s = rows[at], float(rows[at]["t_s"]) - float(rows[0]["t_s"])
    found = shown(page, t_s)
    assert figures_in(found["time"])[0] == pytest.approx(t_s, abs=0.006)
    assert found["status"] == row["status"]
    assert found["gate"].partition(":")[0] == (row["gate"] or "open")
    assert figures_in(found["speed"]) == [pytest.approx(3.6 * float(row["speed_mps"]), abs=0.06)]
    assert figures_in(found["distance"]) == [pytest.approx(float(row["distance_m"]) / 1e3, abs=0.005)]
    if not row["mass_kg"]:
        assert found["mass"] == "–"
        return
    mass, grade = (
        [float(row[n]) for n in ("mass_kg", "mass_std_kg")],
        [float(row[n]) for n in ("grade", "grade_std")],
    )
    assert figures_in(found["mass"]) == [pytest.approx(n, abs=0.56) for n in mass]
    assert figures_in(found["grade"]) == [pytest.approx(100 * n, abs=0.0056) for n in grade]


def test_the_pointer_and_the_arrow_keys_move_the_cursor(page):
    page.run(f"{FIGURE}.show(...{FIGURE}.whole)")
    box = page.run(
        "(r => [r.left, r.top, r.width])(document.querySelector('.figure').getBoundingClientRect())"
    )
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=box[0] + box[2] / 2, y=box[1] + 100)
    page.wait(f"Math.abs({FIGURE}.cursor.t - 90) < 12")
    before = page.run(f"{FIGURE}.cursor.t")
    page.run("document.querySelector('.slide input').focus()")
    page.press("ArrowRight", "ArrowRight", 39)
    assert 0.1 < page.run(f"{FIGURE}.cursor.t") - before < 1.0
    page.wait("/mass [0-9,]+ ± [0-9,]+ kg/.test(document.querySelector('.slide input').ariaValueText"
              " ?? document.querySelector('.slide input').getAttribute('aria-valuetext'))")  # fmt: skip


def test_a_zoom_shows_every_sample_and_fits_the_axes(page, folder):
    page.run(f"{FIGURE}.show(60, 70)")
    grade = f"{FIGURE}.plot.data.find(t => t.name === 'grade' && !t.fill)"
    x, y = page.run(f"(t => [t.x, t.y])({grade})")
    seen = [(a, b) for a, b in zip(x, y, strict=True) if a is not None and 60 <= a <= 70]
    assert len(seen) in (500, 501)
    rows = {
        round(float(r["t_s"]) - float(estimates(folder)[0]["t_s"]), 2): r
        for r in estimates(folder)[2900:3600]
    }
    assert all(abs(100 * float(rows[round(a, 2)]["grade"]) - b) < 0.0011 for a, b in seen)
    low, high = page.run(f"{FIGURE}.plot.layout.yaxis2.range")
    assert low < min(b for _, b in seen) and max(b for _, b in seen) < high
    assert high - low < 5
    page.run(f"{FIGURE}.show(...{FIGURE}.whole)")
    # the first seconds have a band of many per cent: the road has -1.5 to 3 %
    low, high = page.run(f"{FIGURE}.plot.layout.yaxis2.range")
    assert -4.5 < low < -1.5
    assert 3 < high < 6


def test_a_drag_zooms_and_a_button_goes_back(page):
    page.run(f"{FIGURE}.show(...{FIGURE}.whole)")
    left, top, width = page.run(
        "(r => [r.left, r.top, r.width])(document.querySelector('.figure').getBoundingClientRect())"
    )
    for kind, share in (("mousePressed", 0.4), ("mouseMoved", 0.5), ("mouseReleased", 0.5)):
        page.call(
            "Input.dispatchMouseEvent", type=kind, x=left + share * width, y=top + 80, button="left",
            buttons=1, clickCount=1,
        )  # fmt: skip
    page.wait(f"{FIGURE}.view[1] - {FIGURE}.view[0] < 40", 5)
    page.run("[...document.querySelectorAll('.tools button')].at(-1).click()")
    page.wait(f"{FIGURE}.view[1] - {FIGURE}.view[0] > 170", 5)


def test_the_distance_is_the_other_axis(page, folder):
    page.run(
        "[...document.querySelectorAll('.tools button')].find(b => b.textContent === 'distance').click()"
    )
    km = float(estimates(folder)[-1]["distance_m"]) / 1e3
    page.wait(f"Math.abs({FIGURE}.plot.layout.xaxis.range[1] - {km}) < 0.02", 5)
    assert "km" in page.run(f"{FIGURE}.plot.layout.xaxis7.title.text")
    x = page.run(f"{FIGURE}.plot.data.find(t => t.name === 'speed').x.filter(v => v !== null)")
    assert x == sorted(x)
    assert x[-1] == pytest.approx(km, abs=0.02)
    found = shown(page, 100.0)
    at = page.run(f"{FIGURE}.toAxis(100.0)")
    assert figures_in(found["distance"])[0] == pytest.approx(at, abs=0.01)
    page.run(f"{FIGURE}.setAxis('time')")


def test_the_map_marks_the_cursor_and_colours_the_track(page):
    shown(page, 40.0)
    track = "document.querySelector('.map')"
    page.wait(f"{track}.data[2].x[0] !== null")
    first = page.run(f"{track}.data[2].x[0]")
    shown(page, 140.0)
    assert page.run(f"{track}.data[2].x[0]") - first == pytest.approx(100 * 1e-4 * 75.2, rel=0.02)
    page.run(
        "(s => { s.value = 'mass'; s.dispatchEvent(new Event('change')); })(document.querySelector('select'))"
    )
    page.wait(f"Math.max(...{track}.data[1].marker.color) > 15")


@pytest.mark.parametrize(
    ("kind", "scheme", "width"),
    [("page", "light", 1280), ("page", "dark", 390), ("comparison", "dark", 1280)],
)
def test_an_accessibility_audit_finds_nothing(request, kind, scheme, width):
    tab = request.getfixturevalue(kind)
    seen_as(tab, scheme, width)
    tab.run("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    assert violations(tab) == []
    assert tab.errors() == []
    ground = tab.run("getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", ground)[:3])) < 200) == (scheme == "dark")
    tab.wait("document.documentElement.scrollWidth <= innerWidth", 5)
    if kind == "page":
        colour = tab.run(f"{FIGURE}.plot.data.find(t => t.name === 'mass' && !t.fill).line.color")
        assert colour == {"light": "#0072b2", "dark": "#56b4e9"}[scheme]
    seen_as(tab, "light")


def test_the_button_changes_the_theme_and_print_is_light(page):
    paper = f"{FIGURE}.plot.layout.paper_bgcolor"
    seen_as(page, "dark")
    page.wait(f"{paper} !== '#ffffff'")
    seen_as(page, "dark", media="print")
    page.wait(f"{paper} === '#ffffff'")
    assert page.run("getComputedStyle(document.querySelector('.tools')).display") == "none"
    assert page.run("[...document.querySelectorAll('details')].every(d => d.open)")
    seen_as(page, "dark")
    page.wait(f"{paper} !== '#ffffff'")
    page.run("document.getElementById('theme').click(); document.getElementById('theme').click()")
    assert page.text("theme") == "Theme: light"
    page.wait(f"{paper} === '#ffffff'")
    page.run("document.getElementById('theme').click()")
    seen_as(page, "light")


def test_the_curves_of_a_comparison_have_a_cursor_and_buttons(comparison):
    tab = comparison
    found = shown(tab, 120.0)
    assert {"canest-0.1", "truth", "speed"} <= set(found)
    assert figures_in(found["truth"])[0] == pytest.approx(21.0)
    button = "[...document.querySelectorAll('.legend button')].find(b => b.textContent === 'canest-0.1')"
    tab.run(f"{button}.click()")
    tab.wait(f"{button}.getAttribute('aria-pressed') === 'false'")
    assert "canest-0.1" not in shown(tab, 121.0)


def test_config_and_version_are_on_the_page(folder):
    html = (folder / "replay.html").read_text()
    assert "<pre" in html
    listing = yaml.safe_load(
        re.search(r"<pre[^>]*>(.*?)</pre>", html, re.S)[1].replace("&#39;", "'").replace("&#34;", '"')
    )
    assert listing["vehicle"]["name"] == "class8"
    assert "Used by canest" in html
    data = json.loads(re.search(r'id="data1">(.*?)</script>', html, re.S)[1])
    packed = sum(len(chunk["data"]) for chunk in data["linked"]["detail"]["chunks"])
    assert packed < 30 * 9000  # bytes per sample
