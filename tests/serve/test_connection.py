"""The page's connection in a real browser: slow, refused, cut short, or to a daemon of another version."""

from __future__ import annotations

import contextlib
import time

import pytest

from canest.serve.hub import MOST_PAGES
from canest.telemetry.live_protocol import COLUMNS
from tests.serve.browser import BROWSER
from tests.serve.rig import Command, EventReader, Stream, free_port, is_up, wait_for
from tests.serve.slow_link import SlowLink

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no Chromium here")]

HAS_MASS = "/[0-9] kg/.test(document.getElementById('mass').textContent)"
PROBLEM = "document.getElementById('problem').textContent"


def test_a_slow_link_shows_no_old_numbers_as_current(browser, server, stream):
    with SlowLink(server.port, 20_000) as link:
        tab = browser.page(f"http://127.0.0.1:{link.port}/")
        tab.wait(f"{PROBLEM}.includes('behind') || {HAS_MASS}", 60)
        begin_s, seen = time.monotonic(), []
        while (since_s := time.monotonic() - begin_s) < 15:
            stream.mass_kg = 20_000.0 + 100 * since_s
            shown = tab.text("mass").split(" ")[0].replace(",", "")
            if shown.isdecimal() and since_s > 3:
                assert float(shown) > stream.mass_kg - 250, "more than 2 s old, and shown as current"
            seen.append(tab.text("problem"))
            browser.pump(0.1)
        assert any("The connection is slow. What arrives is" in problem for problem in seen)
        stream.close()
        tab.wait(f"{PROBLEM}.includes('No data')", 8)


def test_a_history_that_is_long_on_its_way_is_no_problem(browser, server):
    tab = browser.page()
    tab.call("Fetch.enable", patterns=[{"urlPattern": "*/history"}])
    tab.open(f"http://127.0.0.1:{server.port}/")
    tab.wait("document.getElementById('status') !== null")
    for _ in range(30):
        assert tab.run(PROBLEM) == ""
        assert tab.text("status") == "connecting"
        browser.pump(0.1)
    tab.call("Fetch.disable")  # lets it go on
    tab.wait(f"{HAS_MASS} && !{PROBLEM}")


def test_lateness_is_measured_whatever_the_clocks_say(browser, server):
    tab = browser.page(f"http://127.0.0.1:{server.port}/")
    tab.wait(HAS_MASS)
    late = tab.run(
        """
        import('/connection.js').then(async ({ ServerClock }) => {
          const clock = new ServerClock(), late = [];
          const hear = (sent) => { clock.hear(sent); late.push(clock.late); };
          hear(1e9);
          await new Promise((done) => setTimeout(done, 500));
          hear(1e9 + 0.1); // sent 0.1 s later, here 0.5 s later
          hear(1e9 + 60); // what came before was late, too
          hear(7); // another machine
          return late;
        })
        """
    )
    assert late == pytest.approx([0.0, 0.4, 0.0, 0.0], abs=0.1)


def test_a_history_that_cannot_be_read_once_is_asked_for_again(browser, server):
    tab = browser.page()
    tab.call("Network.setBlockedURLs", urls=["*/history"])
    tab.open(f"http://127.0.0.1:{server.port}/")
    tab.wait(f"{PROBLEM}.includes('The history cannot be read: Failed to fetch. Trying again.')")
    tab.call("Network.setBlockedURLs", urls=[])
    tab.wait(HAS_MASS, 10)
    assert tab.run(PROBLEM) == ""


def test_a_page_beyond_the_limit_shows_why_and_opens_when_another_one_is_closed(browser, server):
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_PAGES):
            assert stack.enter_context(EventReader(server.port)).read(b"retry:")
        tab = browser.page(f"http://127.0.0.1:{server.port}/")
        tab.wait(f"{PROBLEM} === 'canest serve says: 16 pages are open already: close one.'")
    tab.wait(f"{HAS_MASS} && !{PROBLEM}", 10)


def test_a_page_that_is_open_says_that_a_token_is_needed_now(browser, tmp_path, stream):
    port = free_port()
    options = ["serve", "--socket", stream.status_socket, "--port", port]
    with Command(tmp_path, *options):
        assert wait_for(lambda: is_up(port), 20)
        tab = browser.page(f"http://127.0.0.1:{port}/")
        tab.wait(HAS_MASS)
    (tmp_path / "token").write_text("0123456789abcdef")
    with Command(tmp_path, *options, "--token-file", tmp_path / "token"):
        tab.wait(f"{PROBLEM}.includes('This page needs its token: open /?token=TOKEN once')", 20)


def test_an_open_page_follows_a_daemon_with_other_columns(browser, tmp_path, server, stream, monkeypatch):
    tab = browser.page(f"http://127.0.0.1:{server.port}/")
    tab.wait(HAS_MASS)
    stream.close()
    tab.wait(f"{PROBLEM}.includes('No data')")
    columns = ("t_s", "speed_mps", *(name for name in COLUMNS[1:] if name != "speed_mps"))
    monkeypatch.setattr("canest.telemetry.live_stream.COLUMNS", columns)
    again = Stream(tmp_path, columns)
    try:
        tab.wait(HAS_MASS)
        assert tab.text("mass").startswith("20,00") and tab.text("speed") == "72.0 km/h"
    finally:
        again.close()
