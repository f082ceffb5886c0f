"""The curves and the cursor in a real browser: where nothing is known, nothing is drawn and nothing read."""

from __future__ import annotations

import re
import time

import pytest

from canest.telemetry.live_protocol import COLUMNS
from tests.serve.browser import BROWSER
from tests.serve.rig import history, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no Chromium here")]

HAS_MASS = "/[0-9] kg/.test(document.getElementById('mass').textContent)"
NOTHING = "nothing is known of this time"
#: pixels in the colour of the mass between two fractions of the plot's width
INK = """
window.ink = (from, to) => {
  const plot = document.getElementById('plot-mass_kg'), over = plot.querySelector('.u-over');
  const left = Math.floor(over.offsetLeft + from * over.clientWidth);
  const width = Math.ceil((to - from) * over.clientWidth);
  const data = plot.querySelector('canvas').getContext('2d')
    .getImageData(left, over.offsetTop, width, over.clientHeight).data;
  let found = 0;
  for (let at = 0; at < data.length; at += 4) {
    if (data[at + 3] > 20 && data[at + 2] > data[at] + 60) found += 1;
  }
  return found;
}
"""
#: where the cursor is, as a fraction of the width; null where it is off
LINE = """(() => {
  const over = document.querySelector('#plot-mass_kg .u-over'), line = over.querySelector('.u-cursor-x');
  const left = Number(/translate\\(([-0-9.]+)px/.exec(line.style.transform)[1]);
  return left < 0 ? null : left / over.clientWidth;
})()"""


def remember(server, stream, ages_s):
    """Send rows of the past, so many seconds old, and let the stream go on."""
    values = {"mass_kg": 20_000.0, "mass_std_kg": 200.0, "status": 2, "gate": 0, "speed_mps": 20.0}
    stream.sends_rows = False
    time.sleep(0.3)
    now_s = time.time()
    rows = [
        [round(now_s - age_s, 2), *(values.get(name, 0.0) for name in COLUMNS[1:])] for age_s in (*ages_s, 0)
    ]
    for at in range(0, len(rows), 100):
        quiet_s = time.time() - rows[-1][0]  # a busy machine takes its time: the bus clock is not shifted
        stream.live.send_rows(rows[at : at + 100], rows[-1], quiet_s)
        time.sleep(0.005)
    assert wait_for(lambda: history(server.port)["recent"][-1][0] == rows[-1][0], 10)
    stream.sends_rows = True


def opened(browser, server):
    tab = browser.page(f"http://127.0.0.1:{server.port}/")
    tab.wait(HAS_MASS)
    tab.run(INK)
    browser.pump(0.5)
    return tab


def slide(tab, value):
    tab.run(
        f"(slider => {{ slider.value = {value}; slider.dispatchEvent(new Event('input')); }})"
        "(document.getElementById('cursor'))"
    )
    tab.browser.pump(0.05)


def show_day(tab):
    tab.run("document.getElementById('show-day').click()")
    tab.wait("document.getElementById('gates').textContent.includes('of the minute')")
    tab.browser.pump(0.3)


def seconds_of_day(text):
    hours, minutes, seconds = map(int, re.search(r"(\d\d):(\d\d):(\d\d)", text).groups())
    return 3600 * hours + 60 * minutes + seconds


def test_no_curve_is_drawn_where_rows_are_missing_and_none_is_read(browser, server, stream):
    remember(server, stream, [age / 10 for age in (*range(6000, 3500, -1), *range(1500, 1, -1))])
    tab = opened(browser, server)
    assert tab.run("ink(0.2, 0.35)") > 0 and tab.run("ink(0.8, 0.95)") > 0
    assert tab.run("ink(0.45, 0.7)") == 0
    slide(tab, 350)
    assert tab.text("readout").endswith(NOTHING)
    slide(tab, 100)
    assert "mass 20,000 ± 200 kg" in tab.text("readout")


def test_the_day_has_gaps_too_and_reads_what_each_minute_had(browser, server, stream):
    hour = 3600
    remember(server, stream, [*range(10 * hour, 6 * hour, -30), *range(3 * hour, 0, -30)])
    tab = opened(browser, server)
    slide(tab, 590)
    show_day(tab)
    assert tab.text("readout") == "move the cursor to read values", "that of the ten minutes is gone"
    assert tab.run("ink(0.1, 0.35)") > 0 and tab.run("ink(0.75, 0.95)") > 0
    assert tab.run("ink(0.42, 0.68)") == 0
    slide(tab, 86_400 - 5 * hour)
    assert tab.text("readout").endswith(NOTHING)
    slide(tab, 86_400 - 2 * hour)
    assert re.search(
        r"\d\d:\d\d, mass 20,000 kg, .*72.0 km/h, .*learning 100 % of the minute", tab.text("readout")
    )


def test_the_first_minute_of_a_day_is_drawn(browser, server):
    tab = opened(browser, server)
    tab.wait("Date.now() / 1000 % 60 > 15", 20)
    show_day(tab)
    assert tab.run("ink(0.98, 1)") > 0


def test_the_cursor_stays_at_its_time_while_the_curves_move_on(browser, server, stream):
    remember(server, stream, [age / 10 for age in range(6100, 1, -1)])
    tab = opened(browser, server)
    slide(tab, 590)
    browser.pump(0.5)
    begin_s = time.monotonic()
    before, line = tab.text("readout"), tab.run(LINE)
    browser.pump(8)
    assert tab.text("readout") == before
    moved_s = 600 * (line - tab.run(LINE))
    cursor_s = 590 - int(tab.run("document.getElementById('cursor').value"))
    passed_s = time.monotonic() - begin_s
    assert 7 < moved_s < passed_s + 2
    assert 7 <= cursor_s <= passed_s + 1
    tab.run("document.getElementById('cursor').focus()")
    tab.press("ArrowLeft", "ArrowLeft", 37)
    assert 0 <= seconds_of_day(before) - seconds_of_day(tab.text("readout")) <= 2


def test_the_pointer_reads_all_curves_and_its_cursor_stays_at_its_time_too(browser, server, stream):
    remember(server, stream, [age / 10 for age in range(6100, 1, -1)])
    tab = opened(browser, server)
    box = "(box => [box.x + box.width / 2, box.y + 20])"
    over = "document.querySelector('#plot-grade .u-over').getBoundingClientRect()"
    x, y = tab.run(f"{box}({over})")
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    browser.pump(0.3)
    before, line = tab.text("readout"), tab.run(LINE)
    assert "mass 20,000 ± 200 kg" in before and line == pytest.approx(0.5, abs=0.01)
    browser.pump(6)
    assert tab.text("readout") == before
    assert tab.run(LINE) < line - 5 / 600
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=0)
    browser.pump(0.3)
    assert tab.text("readout") == "move the cursor to read values" and tab.run(LINE) is None


def test_a_picture_that_is_paused_is_read_as_it_is(browser, server, stream):
    remember(server, stream, [age / 10 for age in range(6100, 1, -1)])
    tab = opened(browser, server)
    slide(tab, 600)
    tab.run("document.getElementById('pause').click()")
    at_pause = seconds_of_day(tab.text("readout"))
    browser.pump(12)
    slide(tab, 590)
    assert at_pause - seconds_of_day(tab.text("readout")) in (9, 10, 11)
    assert tab.run(LINE) == pytest.approx(590 / 600, abs=0.005)
    tab.run("document.getElementById('pause').click()")
    browser.pump(0.5)
    assert tab.run(LINE) < 582 / 600


def test_what_is_before_the_history_is_not_known_and_a_clock_that_is_set_back_loses_the_cursor(
    browser, server, stream
):
    tab = opened(browser, server)
    slide(tab, 100)
    assert tab.text("readout").endswith(NOTHING) and tab.run(LINE) is None
    slide(tab, 600)
    assert "mass 20,00" in tab.text("readout")
    stream.sends_rows = False
    browser.pump(0.5)
    back = "import('/live.js').then(({ take }) => take('rows', { rows: [row], newest: row, quiet_s: 0 }))"
    tab.run(f"(row => {back})([1e9, 2e4, 200, 0, 0, 2, 0, 0, 0, 0, 0])")
    tab.wait("document.getElementById('readout').textContent === 'move the cursor to read values'")
