"""What the daemon costs while it runs: CPU, memory, punctuality, at 1,000 and 4,000 frames/s.

    python benchmarks/live_cost.py [--seconds 20] [--rates 1000,4000] [--config kenworth] [--broadcast-hz 10]

The whole daemon runs in real time in a process of its own; another process sends the frames of the bundled
Kenworth drive, sped up to the rate. With SocketCAN in this kernel the bus is vcan0 (bring it up first) and
the kernel filters the frames. Without it a UDP socket on the loopback STANDS IN for the CAN socket: the same
drain (recvmmsg, kernel stamps) reads the same 16 bytes per frame, and the sender leaves out what the kernel's
filters would; the row "unfiltered" sends everything. The row "floor" is a loop that only sleeps and empties
the socket every 20 ms: what the machine itself asks for, and how late it wakes. JSON lines follow.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing as mp
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
LOG = ROOT / "tests/data/kenworth/normal.log.xz"
FRAME = struct.Struct("=IB3xQ")
BATCH_S = 0.002


def has_socketcan() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def load_frames() -> list[tuple[int, bytes]]:
    from canest.logs.format_detection import open_log

    packed = []
    for block in open_log(LOG):
        for can_id, length, data in zip(
            block.can_id.tolist(), block.length.tolist(), block.data.tolist(), strict=True
        ):
            packed.append((can_id, FRAME.pack(can_id, length, data)))
    return packed


def send(port: int, rate: float, seconds: float, filters: list[tuple[int, int]] | None) -> None:
    """Send the drive at ``rate`` frames/s (counted before filtering) for ``seconds``."""
    frames = load_frames()
    if has_socketcan():
        out = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        out.bind(("vcan0",))
        filters = None
    else:
        out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        out.connect(("127.0.0.1", port))
    if filters is not None:
        wanted = {i for i, _ in frames if any(i & m == f & m for f, m in filters)}
        frames = [(i, p if i in wanted else b"") for i, p in frames]
    begin, sent = time.monotonic(), 0
    while (now := time.monotonic() - begin) < seconds:
        due = int(now * rate)
        for k in range(sent, due):
            packet = frames[k % len(frames)][1]
            if packet:
                try:
                    out.send(packet)
                except OSError:  # the daemon has ended
                    return
        sent = due
        time.sleep(BATCH_S)


def daemon(
    config_name: str, seconds: float, broadcast_hz: float | None, port_to: object, result_to: object
) -> None:
    """Run the daemon in this process and report what it cost."""
    from canest.bus.kernel_drain import enable_timestamps
    from canest.bus.protocols import Filters, Receiver, Transmitter
    from canest.bus.socketcan import SocketCanReceiver, SocketCanTransmitter, enlarge_receive_buffer
    from canest.config import load_config
    from canest.live.daemon import Daemon
    from canest.node import node
    from canest.system.journal import Journal

    class UdpStandIn(SocketCanReceiver):
        def open_socket(self) -> socket.socket:
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
            enlarge_receive_buffer(sock)
            enable_timestamps(sock)
            sock.bind(("127.0.0.1", 0))
            self.sink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            return sock

        def interface_index(self) -> int:
            return 1

        def interface_is_up(self) -> bool:
            return True

    class UdpSender(SocketCanTransmitter):
        def send(self, can_id: int, payload: bytes) -> bool:
            frame = struct.pack("=IB3x8s", can_id, len(payload), payload)
            self._receiver.sink.sendto(frame, ("127.0.0.1", 9))  # type: ignore[attr-defined]
            self.counters["sent"] += 1
            return True

    def open_stand_in(bus: object, filters: Filters, *, transmit: bool) -> tuple[Receiver, Transmitter]:
        receiver = UdpStandIn("stand-in", filters)
        return receiver, UdpSender(receiver)

    changes = ["service.learn='off'", "broadcast.enabled=true", "service.state_dir=/tmp/canest-live-cost"]
    if broadcast_hz is not None:
        changes.append(f"broadcast.rate_hz={broadcast_hz}")
    if has_socketcan():
        changes += ["bus.interface=socketcan", "bus.channel=vcan0"]
    else:
        node.open_link = open_stand_in  # type: ignore[assignment]
    config = load_config(config_name, changes)
    with Path(os.devnull).open("w") as nowhere:
        running = Daemon(config, journal=Journal(nowhere))
    port = 0 if has_socketcan() else running.receiver.raw_socket.getsockname()[1]
    filters = sorted({*running.pipeline.decoder.can_filters(), *running.node.monitor.filters()})
    port_to.put((port, filters))
    marks: dict[str, float] = {}

    def measure() -> None:
        time.sleep(2.0)  # warm caches, the claim, the first allocations
        marks["cpu"], marks["wall"] = time.process_time(), time.monotonic()
        marks["ticks"], marks["frames"] = running.schedule.ticks, running.pipeline.decoder.counters.frames
        running.schedule.lateness_counts = [0] * len(running.schedule.lateness_counts)
        time.sleep(seconds)
        marks["cpu"], marks["wall"] = time.process_time() - marks["cpu"], time.monotonic() - marks["wall"]
        marks["ticks"] = running.schedule.ticks - marks["ticks"]
        marks["frames"] = running.pipeline.decoder.counters.frames - marks["frames"]
        running.stop()

    threading.Thread(target=measure, daemon=True).start()
    running.run(handle_signals=False)
    late = running.schedule.lateness_counts
    result_to.put(
        {
            "core_pct": round(100 * marks["cpu"] / marks["wall"], 2),
            "us_per_tick": round(1e6 * marks["cpu"] / marks["ticks"], 1),
            "frames_read_per_s": round(marks["frames"] / marks["wall"]),
            "samples": running.pipeline.samples,
            "within_half_ms_pct": round(100 * sum(late[:2]) / sum(late), 2),
            "missed": running.schedule.missed,
            "dropped": running.receiver.counters["dropped_by_kernel"],
            "rss_mb": round(
                int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024, 1
            ),
            "numba": "numba" in sys.modules,
        }
    )


def floor(seconds: float, port_to: object, result_to: object) -> None:
    """Only sleep and empty the socket, every 20 ms: what a loop costs here that does nothing."""
    from canest.bus.kernel_drain import KernelDrain, enable_timestamps
    from canest.live.schedule import Schedule

    if has_socketcan():
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
        sock.bind(("vcan0",))
    else:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        sock.bind(("127.0.0.1", 0))
    enable_timestamps(sock)
    drain, schedule = KernelDrain(sock), Schedule()
    port_to.put((0 if has_socketcan() else sock.getsockname()[1], None))
    end_s = time.monotonic() + 2.0
    while time.monotonic() < end_s:
        schedule.wait()
        drain.drain()
    cpu_s, wall_s = time.process_time(), time.monotonic()
    schedule.lateness_counts, schedule.ticks = [0] * len(schedule.lateness_counts), 0
    while time.monotonic() < wall_s + seconds:
        schedule.wait()
        drain.drain()
    cpu_s, wall_s = time.process_time() - cpu_s, time.monotonic() - wall_s
    within_pct = round(100 * schedule.share_within(0.5), 2)
    core_pct = round(100 * cpu_s / wall_s, 2)
    result_to.put({"core_pct": core_pct, "within_half_ms_pct": within_pct, "way": "sleep and drain only"})


def beside_a_sender(
    work: Callable[..., None], given: tuple[object, ...], rate: float, seconds: float, filtered: bool = False
) -> dict[str, object]:
    """Run ``work(*given, port_to, result_to)`` in a process while another sends to it; return its result."""
    context = mp.get_context("spawn")
    ports, results = context.Queue(), context.Queue()
    worker = context.Process(target=work, args=(*given, ports, results))
    worker.start()
    port, filters = ports.get(timeout=60)
    sender = context.Process(target=send, args=(port, rate, seconds + 4, filters if filtered else None))
    sender.start()
    result: dict[str, object] = results.get(timeout=seconds + 60)
    sender.join()
    worker.join()
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rates", default="1000,4000")
    parser.add_argument("--config", default="kenworth")
    parser.add_argument("--broadcast-hz", type=float, help="instead of the default rate of the config")
    arguments = parser.parse_args()
    way = "vcan0, kernel filters" if has_socketcan() else "UDP STAND-IN for the CAN socket"
    rows = []
    print(f"{way}; config {arguments.config}; {arguments.seconds:g} s each; load {os.getloadavg()[0]:.2f}")
    for rate in [float(r) for r in arguments.rates.split(",")]:
        row = {"rate": rate} | beside_a_sender(floor, (arguments.seconds,), rate, arguments.seconds)
        rows.append(row)
        print(
            f"{rate:6.0f} frames/s {'floor':15s} {row['core_pct']:5.2f} % of a core: sleep and drain only, "
            f"{row['within_half_ms_pct']:.2f} % within 0.5 ms"
        )
        for filtered in (True, False) if not has_socketcan() else (True,):
            row = {"rate": rate, "filtered": filtered, "way": way}
            given = (arguments.config, arguments.seconds, arguments.broadcast_hz)
            row |= beside_a_sender(daemon, given, rate, arguments.seconds, filtered)
            rows.append(row)
            print(
                f"{rate:6.0f} frames/s {'kernel-filtered' if filtered else 'unfiltered':15s} "
                f"{row['core_pct']:5.2f} % of a core, {row['us_per_tick']:6.1f} us/tick, "
                f"{row['rss_mb']:.0f} MB, {row['within_half_ms_pct']:.2f} % of ticks within 0.5 ms, "
                f"{row['missed']} missed, {row['frames_read_per_s']} frames/s read"
            )
    print("\n".join(json.dumps(row) for row in rows))


if __name__ == "__main__":
    main()
