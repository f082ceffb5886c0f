"""What the live page costs: the daemon with and without three open pages, the server, and the browser.

    python benchmarks/page_cost.py [--seconds 20] [--rounds 2] [--rate 1000] [--broadcast-hz 10]

The daemon runs as in benchmarks/live_cost.py (whose stand-in for the bus it uses where the kernel has no
SocketCAN). Beside it run `canest serve` and three pages in headless Chromium, in turns on the daemon and on
a stand-in that sends as many rows: the machine has the same load, and the daemon's own share is what differs.
The browsers have the lowest priority: on a vehicle they run on another machine. Then the time to the first
paint, the size of the page, and how long it takes until a bus that falls silent shows. JSON lines follow.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import live_cost  # noqa: E402

from tests.live.rig import free_port, wait_for  # noqa: E402
from tests.serve.browser import BROWSER, Browser, Tab  # noqa: E402
from tests.serve.rig import Stream, Vehicle, has_multicast, is_up  # noqa: E402

STATE = Path("/tmp/canest-live-cost")  # that of live_cost.py
PAGES = 3
PROBLEM = "document.getElementById('problem')?.textContent"
HAS_MASS = "/[0-9] kg/.test(document.getElementById('mass')?.textContent)"


class Server:
    """`canest serve` beside the daemon of live_cost.py."""

    def __init__(self, status_socket: Path) -> None:
        self.port = free_port()
        command = ["serve", "--socket", str(status_socket), "--port", str(self.port)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "canest", *command], stdout=subprocess.DEVNULL
        )
        assert wait_for(lambda: is_up(self.port), 20)

    def cpu_s(self) -> float:
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def peak_mb(self) -> float:
        text = Path(f"/proc/{self._process.pid}/status").read_text()
        return round(int(text.split("VmHWM:")[1].split()[0]) / 1024, 1)

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(10)


def measure_daemon(rate: float, seconds: float, broadcast_hz: float) -> dict[str, Any]:
    given = ("kenworth", seconds, broadcast_hz)
    return live_cost.beside_a_sender(live_cost.daemon, given, rate, seconds, filtered=True)


def with_pages(
    rate: float, seconds: float, broadcast_hz: float, folder: Path, watched: bool
) -> dict[str, Any]:
    """Measure the daemon while pages are open, on the daemon itself or on the stand-in."""
    stand_in = Stream(folder)
    server = Server(STATE / "status-vcan0.sock" if watched else stand_in.status_socket)
    (folder / "profile").mkdir()
    try:
        with Browser(folder / "profile", nice=19) as browser:
            tabs = [browser.page(f"http://127.0.0.1:{server.port}/") for _ in range(PAGES)]
            begin_s, cpu_s = time.monotonic(), server.cpu_s()
            row = measure_daemon(rate, seconds, broadcast_hz)
            row["server_core_pct"] = round(100 * (server.cpu_s() - cpu_s) / (time.monotonic() - begin_s), 2)
            row["server_peak_mb"] = server.peak_mb()
            row["points_received"] = [tab.run("import('/live.js').then(m => m.points())") for tab in tabs]
        return row
    finally:
        server.close()
        stand_in.close()


def paints(tab: Tab) -> dict[str, float]:
    entries = tab.run("performance.getEntriesByType('paint').map(p => [p.name, p.startTime])")
    return {name.replace("-", "_") + "_ms": round(value) for name, value in entries}


def measure_page(folder: Path) -> dict[str, Any]:
    """Measure the first paint, the page's size, and the time until a silent bus shows."""
    vehicle, port = Vehicle(folder, "239.74.163.24"), free_port()
    (folder / "profile").mkdir()
    with vehicle.daemon("--serve", port), vehicle.drive() as drive, Browser(folder / "profile") as browser:
        assert wait_for(lambda: is_up(port), 90)
        rows = []
        for _ in range(5):
            tab = browser.page(f"http://127.0.0.1:{port}/")
            tab.wait(HAS_MASS, 90)
            tab.wait("performance.getEntriesByType('paint').length > 1")
            rows.append(paints(tab))
        sizes = tab.run("performance.getEntriesByType('resource').map(e => [e.name, e.decodedBodySize])")
        assets = sum(size for name, size in sizes if "history" not in name and "events" not in name)
        drive.send(signal.SIGSTOP)
        lost_s = tab.wait(f"({PROBLEM}).includes('No frame on the bus')", 20)
        drive.send(signal.SIGCONT)
        paint_ms = sorted(row["first_contentful_paint_ms"] for row in rows)
        return {"first_paint_ms": paint_ms, "assets_bytes": assets, "lost_bus_shows_s": round(lost_s, 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--broadcast-hz", type=float, default=10.0, help="estimations a second")
    arguments = parser.parse_args()
    if BROWSER is None or not has_multicast():
        sys.exit("needs Chromium and multicast on the loopback")
    print(
        f"load {os.getloadavg()[0]:.2f}; {arguments.rate:g} frames/s, "
        f"estimated at {arguments.broadcast_hz:g} Hz; {arguments.seconds:g} s each"
    )
    rows = []
    for number in range(arguments.rounds):
        for watched in (False, True) if number % 2 == 0 else (True, False):
            with tempfile.TemporaryDirectory() as folder:
                given = arguments.rate, arguments.seconds, arguments.broadcast_hz
                measured = with_pages(*given, Path(folder), watched)
            rows.append({"round": number, "watched": watched} | measured)
            print(
                f"{PAGES} pages on the {'daemon:  ' if watched else 'stand-in:'} daemon "
                f"{measured['core_pct']:5.2f} % of a core, {measured['within_half_ms_pct']:.2f} % of ticks "
                f"within 0.5 ms, {measured['missed']} missed; server {measured['server_core_pct']:.2f} %, "
                f"{measured['server_peak_mb']:.0f} MB",
                flush=True,
            )
    middle = [
        median(row["core_pct"] for row in rows if row["watched"] is watched) for watched in (False, True)
    ]
    print(f"median share of the daemon: {middle[0]:.2f} % and {middle[1]:.2f} %")
    print("\n".join(json.dumps(row) for row in rows), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        page = measure_page(Path(folder))
    print(
        f"first paint {page['first_paint_ms']} ms, page {page['assets_bytes'] / 1000:.0f} kB, "
        f"a silent bus shows after {page['lost_bus_shows_s']:.2f} s"
    )
    print(json.dumps(page))


if __name__ == "__main__":
    main()
