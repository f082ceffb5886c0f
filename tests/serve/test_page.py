"""The page in a real browser: its numbers, what is lost, what it costs, and who can use it."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest

from canest.bus.link import open_link
from canest.config.bus import Bus
from canest.decode import j1939
from canest.node.estimate_frame import decode
from canest.telemetry.status_socket import read_status
from tests.serve.browser import BROWSER
from tests.serve.rig import Command, Stream, Vehicle, free_port, has_multicast, is_up, wait_for

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here"),
    pytest.mark.skipif(not has_multicast(), reason="no multicast on this machine"),
]

AXE = Path(__file__).with_name("axe.min.js")
PGN = 0xFF5A
HAS_MASS = "/[0-9] kg/.test(document.getElementById('mass').textContent)"
PROBLEM = "document.getElementById('problem').textContent"
LOST_S = 4.0  #: it takes less than 2 on a machine with time to spare (benchmarks/page_cost.py)


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    return Vehicle(tmp_path_factory.mktemp("vehicle"), "239.74.163.21")


@pytest.fixture(scope="module")
def driving(vehicle):
    """The bundled drive, again and again for an hour, beside a daemon that estimates and has a page."""
    port = free_port()
    with vehicle.daemon("--serve", port) as daemon:
        assert wait_for(lambda: is_up(port), 30), daemon.output
        with vehicle.drive(times=20) as drive:
            drive.port = port
            yield drive


@pytest.fixture
def page(browser, driving):
    tab = browser.page(f"http://127.0.0.1:{driving.port}/")
    tab.wait(HAS_MASS, 90)
    return tab


@pytest.fixture
def alone(browser, tmp_path):
    """A page whose daemon has sent one row and then nothing: what it takes comes from the test."""
    stream, port = Stream(tmp_path), free_port()
    with Command(tmp_path, "serve", "--socket", stream.status_socket, "--port", port) as server:
        assert wait_for(lambda: is_up(port), 30), server.output
        assert wait_for(lambda: stream.sent > 0, 10)
        stream.pause_s = 0.5
        tab = browser.page(f"http://127.0.0.1:{port}/")
        tab.wait(HAS_MASS, 40)
        stream.close()
        tab.wait(f"{PROBLEM}.includes('No data')", 10)
        yield tab


class Broadcasts:
    """What the bus carries of our broadcast, as any other node would receive it.

    Read in a thread of its own: the buffer of a socket does not hold the traffic of a busy moment.
    """

    def __init__(self, group):
        self._receiver, _ = open_link(
            Bus(interface="udp_multicast", channel=group), [j1939.kernel_filter(PGN)], transmit=False
        )
        self.received = []
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self):
        while not self._closing.wait(0.02):
            frames = self._receiver.drain().frames
            decoded = [
                decode(word.to_bytes(8, "little"), can_id)
                for can_id, word in zip(frames.can_id.tolist(), frames.data.tolist(), strict=True)
                if j1939.pgn_of(can_id) == PGN
            ]
            self.received += [r for r in decoded if r is not None and r.intact]

    def has(self, mass_kg, grade_pct, newest=20):
        """Return whether one of the newest broadcasts is this, or one that was lost between two of them."""
        received = self.received[-newest:]
        return any(
            _is_between(a.mass_kg, mass_kg, b.mass_kg, 1.6)
            and _is_between(100 * a.grade, grade_pct, 100 * b.grade, 0.011)
            for a, b in _neighbours(received)
        )

    def close(self):
        self._closing.set()
        self._thread.join()
        self._receiver.close()


def _neighbours(received):
    """Return the estimates, each with itself, and with the next one where the counter shows a loss."""
    lost = [(a.estimate, b.estimate) for a, b in pairwise(received) if (b.counter - a.counter) % 16 != 1]
    return [(r.estimate, r.estimate) for r in received] + lost


def _is_between(a, value, b, tolerance):
    return min(a, b) - tolerance <= value <= max(a, b) + tolerance


def violations(tab):
    tab.run(AXE.read_text() + ";0")
    found = "axe.run().then(r => r.violations.map(v => [v.id, v.nodes.map(n => n.html)]))"
    return tab.run(found)


def shown_number(text):
    return float(re.sub(r"[^0-9.\-]", "", text.replace("−", "-")))


def test_the_numbers_on_the_page_are_those_of_the_broadcast_and_the_status(page, vehicle):
    compared = 0
    with contextlib.closing(Broadcasts(vehicle.group)) as broadcasts:
        for _ in range(40):
            mass, grade, known = page.run(
                "[document.getElementById('mass').textContent, document.getElementById('grade').textContent,"
                "document.getElementById('status').textContent]"
            )
            page.browser.pump(0.2)
            if len(broadcasts.received) < 12 or known not in ("valid", "converging"):
                continue
            # steps of 2 kg and 0.01 %, a half of each, and the rounding of the text
            shown = shown_number(mass), shown_number(grade)
            assert wait_for(lambda shown=shown: broadcasts.has(*shown), 1), (shown, broadcasts.received[-30:])
            compared += 1
    assert compared > 20
    # either may be a second older than the other
    assert wait_for(
        lambda: page.text("status").strip() == read_status(vehicle.status_socket)["estimate"]["status"], 5
    )
    status = read_status(vehicle.status_socket)
    assert abs(status["estimate"]["mass_kg"] / shown_number(page.text("mass")) - 1) < 0.02
    senders = page.text("senders-table")
    assert all(sender.replace("pgn_", "PGN ").replace("_", " ") in senders for sender in status["senders"])


def test_nothing_fails_is_blocked_or_comes_from_elsewhere(page, driving):
    page.browser.pump(1.0)
    assert page.errors() == []
    assert all(url.startswith(f"http://127.0.0.1:{driving.port}/") for url in page.requested())
    sizes = page.run("performance.getEntriesByType('resource').map(e => [e.name, e.decodedBodySize])")
    assets = sum(size for name, size in sizes if not re.search("history|events", name))
    assert assets < 300_000


def test_curves_bands_and_gates_are_drawn(page):
    canvases = page.run("document.querySelectorAll('.plot canvas').length")
    assert canvases == 6
    inked = (
        "[...document.querySelectorAll('.plot canvas')].map(c => c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data.some(v => v > 0))"
    )
    assert page.run(inked) == [True] * 6
    page.wait("document.querySelectorAll('#gates li').length > 0")
    assert "shift" in page.text("gates") or "low speed" in page.text("gates")


def test_a_page_that_opens_later_has_the_minutes_before(browser, driving, page):
    page.wait("import('/live.js').then(() => true)")
    late = browser.page(f"http://127.0.0.1:{driving.port}/")
    late.wait(HAS_MASS)
    label = "document.getElementById('plot-speed_mps').getAttribute('aria-label')"
    late.wait(f"/to .* in the last ten minutes/.test({label})")
    most = float(re.search(r"to ([0-9.]+) in", late.run(label))[1])
    assert most > 5


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 380)])
def test_an_accessibility_audit_finds_nothing(browser, driving, scheme, width):
    tab = browser.page(f"http://127.0.0.1:{driving.port}/", width=width, prefers_color_scheme=scheme)
    tab.wait(HAS_MASS, 40)
    assert violations(tab) == []
    tab.run("document.getElementById('show-day').click()")
    browser.pump(0.5)
    assert violations(tab) == []
    assert tab.run("document.documentElement.scrollWidth") <= width
    ground = tab.run("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") == (scheme == "light")


def test_everything_can_be_done_by_keyboard_and_is_announced_in_words(page):
    page.browser.pump(3.0)
    page.press("Tab", "Tab", 9)
    assert page.run("document.activeElement.textContent") == "Skip to the numbers"
    reached = []
    for _ in range(12):
        page.press("Tab", "Tab", 9)
        reached.append(page.run("document.activeElement.id"))
    assert {"theme", "show-recent", "show-day", "pause", "cursor"} <= set(reached)
    page.run("document.getElementById('cursor').focus()")
    page.press("ArrowLeft", "ArrowLeft", 37)
    words = page.run("document.getElementById('cursor').getAttribute('aria-valuetext')")
    assert re.search(r"\d\d:\d\d:\d\d, .*km/h", words), words
    assert page.text("readout") == words
    assert page.text("announce").startswith("Status: ")
    assert page.run("document.getElementById('plot-mass_kg').getAttribute('aria-label')").startswith(
        "Mass, kg: "
    )


def test_the_road_ahead_shows_when_the_status_has_one(alone):
    assert alone.run("document.getElementById('road').hidden")
    road = {"distance_m": [0, 500, 1000], "grade": [0.01, 0.03, -0.02]}
    status = json.dumps({"vehicle": "x", "bus": {"state": "up"}, "road_ahead": road})
    alone.run(f"import('/live.js').then(m => m.take('status', {status}))")
    assert not alone.run("document.getElementById('road').hidden")
    label = alone.run("document.getElementById('road-chart').getAttribute('aria-label')")
    assert label == "Grade of the next 1000 m: -2.0 to 3.0 %"
    unknown = status.replace("[0.01, 0.03, -0.02]", "[null, null, null]")
    alone.run(f"import('/live.js').then(m => m.take('status', {unknown}))")
    label = alone.run("document.getElementById('road-chart').getAttribute('aria-label')")
    assert label == "Grade of the next 1000 m: not known"


def test_long_numbers_fit_into_their_tiles(alone):
    """With and without a standard deviation: what is below does not move."""
    measure = (
        "((mass, std) => { document.getElementById('mass').textContent = mass;"
        "document.getElementById('mass-std').textContent = std;"
        "const tile = document.querySelector('.numbers .big');"
        "return [tile.clientHeight, tile.scrollWidth <= tile.clientWidth]; })"
    )
    heights = [
        alone.run(f"{measure}({mass!r}, {std!r})")
        for mass, std in (("–", ""), ("29,980 kg", "± 317 kg"), ("129,980 kg", "± 13,170 kg"))
    ]
    assert heights == [[heights[0][0], True]] * 3


def test_what_a_daemon_said_of_itself_has_a_time_when_it_has_ended(alone):
    as_of = "document.querySelector('header .as-of').textContent"
    assert re.fullmatch(r"as of \d\d:\d\d:\d\d", alone.run(as_of))
    assert re.fullmatch(r"Senders as of \d\d:\d\d:\d\d", alone.text("senders-title"))
    assert violations(alone) == []
    later = alone.browser.page(alone.run("location.href"))
    later.wait(f"{as_of} !== ''")
    assert later.run(as_of) == alone.run(as_of), "a page that opens later has the same time"
    style = "getComputedStyle(document.getElementById('bus')).fontStyle"
    assert alone.run(style) == "italic"
    shown = alone.run(  # at once: the server goes on to say that there is no daemon
        f"""
        import('/live.js').then((module) => {{
          module.take('source', {{problem: '', source: 'x', now_s: 1e9}});
          module.take('status', {{vehicle: 'x', bus: {{state: 'up'}}}});
          return [{as_of}, {style}];
        }})
        """
    )
    assert shown == ["", "normal"]


def test_eight_hours_do_not_grow_the_page(alone):
    """28,800 seconds of rows and statuses, as fast as the page takes them."""
    alone.run(
        """
        import('/live.js').then((module) => {
          let time = Date.now() / 1000 + 1000, second = 0;
          window.hour = () => {
            for (let end = second + 3600; second < end; second += 1) {
              const rows = [];
              for (let k = 0; k < 10; k += 1, time += 0.1) {
                const gate = second % 40 < 5 ? 6 : 0;
                const mass = 2e4 + 50 * Math.sin(time), residual = gate ? null : 80;
                rows.push([time, mass, 200, 0.01, 0.001, 2, gate, 20, 900, 9, residual]);
              }
              module.take("rows", { rows, newest: rows[9], quiet_s: 0 });
              const senders = { pgn_1_from_0x00: { frames: second } };
              module.take("status", { vehicle: "x", bus: { state: "up" }, senders });
              module.take("change", [time, second % 2 ? "status valid" : "status converging"]);
            }
            return second;
          };
        })
        """
    )
    alone.run("hour()")
    alone.browser.pump(1.0)
    heap, nodes = alone.heap_bytes(), alone.metric("Nodes")
    for hours in range(2, 9):
        assert alone.run("hour()") == 3600 * hours
        alone.browser.pump(0.3)
    alone.browser.pump(1.0)
    assert alone.heap_bytes() - heap < 1_000_000
    assert alone.metric("Nodes") - nodes < 100


def test_a_lost_bus_shows_and_the_last_mass_stays_with_its_age(page, driving, vehicle):
    driving.send(signal.SIGSTOP)
    try:
        page.wait(f"{PROBLEM}.includes('No frame on the bus')", LOST_S)
        assert page.text("status").strip() == "no estimate of now"
        assert page.text("mass").strip() == "–"
        known = "document.getElementById('known').textContent"
        page.wait(f"/Last known mass: [0-9,]+ ± [0-9,]+ kg, [0-9]+ s ago/.test({known})")
        assert violations(page) == []
    finally:
        driving.send(signal.SIGCONT)
    page.wait(HAS_MASS, 30)
    page.wait(f"!{PROBLEM}")


def test_a_daemon_that_hangs_or_ends_shows_and_one_that_comes_back_is_followed(browser, tmp_path_factory):
    vehicle, port = Vehicle(tmp_path_factory.mktemp("v"), "239.74.163.22"), free_port()
    with contextlib.ExitStack() as stack:
        daemon = stack.enter_context(vehicle.daemon())
        stack.enter_context(vehicle.page(port))
        stack.enter_context(vehicle.drive())
        assert wait_for(lambda: is_up(port), 30)
        tab = browser.page(f"http://127.0.0.1:{port}/")
        tab.wait("/[0-9] km.h/.test(document.getElementById('speed').textContent)", 90)
        daemon.send(signal.SIGSTOP)
        tab.wait(f"{PROBLEM}.includes('has sent nothing for')", LOST_S)
        daemon.send(signal.SIGCONT)
        tab.wait(f"!{PROBLEM}")
        daemon.end()
        tab.wait(f"{PROBLEM}.includes('No data')", LOST_S)
        stack.enter_context(vehicle.daemon())
        tab.wait("/[0-9] km.h/.test(document.getElementById('speed').textContent)", 90)
        newest_first = tab.run("[...document.querySelectorAll('#changes span')].map(e => e.textContent)")
        assert sum(line.startswith("no data: ") for line in newest_first) >= 2
        assert sum(line == "the source answers" for line in newest_first) >= 2
        later = browser.page(f"http://127.0.0.1:{port}/")
        later.wait("document.getElementById('changes').children.length >= 4")
        assert violations(later) == []


def test_a_page_reconnects_by_itself_and_shows_it_meanwhile(browser, driving, vehicle):
    port = free_port()
    with vehicle.page(port) as server:
        assert wait_for(lambda: is_up(port), 20)
        tab = browser.page(f"http://127.0.0.1:{port}/")
        tab.wait(HAS_MASS, 30)
        server.end(signal.SIGKILL)
        tab.wait(f"{PROBLEM}.includes('No connection to canest serve')", LOST_S)
    with vehicle.page(port):
        tab.wait(f"!{PROBLEM}", 20)
        tab.wait(HAS_MASS)


def test_a_page_of_the_broadcast_alone_shows_the_same_mass(browser, driving, vehicle, page):
    port = free_port()
    with Command(vehicle.folder, "serve", "-c", vehicle.config(), "--broadcast", "--port", port) as server:
        assert wait_for(lambda: is_up(port), 20), server.output
        tab = browser.page(f"http://127.0.0.1:{port}/")
        tab.wait(HAS_MASS, 90)
        time.sleep(0.5)
        assert abs(shown_number(tab.text("mass")) / shown_number(page.text("mass")) - 1) < 0.02
        assert tab.text("speed").strip() == "–"
        assert tab.errors() == []


def test_killing_the_page_leaves_the_daemon_as_it_was_and_a_dead_daemon_takes_it_along(tmp_path_factory):
    vehicle, port = Vehicle(tmp_path_factory.mktemp("v"), "239.74.163.23"), free_port()
    with vehicle.daemon("--serve", port) as daemon:
        assert wait_for(lambda: is_up(port), 30)
        [child] = Path(f"/proc/{daemon.process.pid}/task/{daemon.process.pid}/children").read_text().split()
        os.kill(int(child), signal.SIGKILL)
        assert wait_for(lambda: "page-ended" in daemon.output)
        assert read_status(vehicle.status_socket)["failures"] == 0
    with vehicle.daemon("--serve", port) as daemon:
        assert wait_for(lambda: is_up(port), 30)
        daemon.end(signal.SIGKILL)
        assert wait_for(lambda: not is_up(port))
