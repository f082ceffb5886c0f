"""What is fuzzed: each target turns any bytes into input, and says by an exception when that did harm.

A target raises nothing but what is a finding: `CanestError` is a proper answer and is swallowed here.
"""

from __future__ import annotations

import atexit
import bz2
import contextlib
import gzip
import io
import lzma
import math
import os
import shutil
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from canest.config import Config, load_config
from canest.core.errors import CanestError
from canest.core.estimates import Estimates
from canest.core.frames import EXTENDED, FrameBlock
from canest.core.samples import Status
from canest.decode import Decoder, j1939
from canest.live import state
from canest.logs.candump_writer import CandumpWriter
from canest.logs.format_detection import open_log
from canest.logs.python_can import find_asammdf
from canest.logs.truth import read_truth
from canest.node.bus_monitor import BusMonitor
from canest.node.node import Node
from canest.pipeline.pipeline import Pipeline
from canest.pipeline.signal_map import decoder_for
from canest.system.shipped_files import find

DATA = Path(__file__).parents[1] / "data"
START_US = 1_700_000_000_000_000
SUFFIXES = (".log", ".asc", ".blf", ".trc", ".csv", ".parquet", ".db", ".mf4", ".txt", ".log.gz", ".csv.xz")


@dataclass(frozen=True)
class Target:
    """Bytes in, nothing out; ``seeds`` are inputs worth mutating, ``tokens`` what to put into them."""

    name: str
    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    tokens: Sequence[bytes] = ()


@cache
def scratch() -> Path:
    """Return a directory in memory where there is one; files there are overwritten again and again."""
    shm = Path("/dev/shm")
    folder = tempfile.mkdtemp(prefix="canest-fuzz.", dir=shm if os.access(shm, os.W_OK) else None)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


# -- logs ----------------------------------------------------------------------------------------------


def run_logs(data: bytes) -> None:
    """First byte: the name's suffix; the rest: the file's content. Every block must be whole."""
    path = scratch() / f"log{SUFFIXES[data[0] % len(SUFFIXES)]}" if data else scratch() / "log.log"
    path.write_bytes(data[1:])
    with contextlib.suppress(CanestError):
        reader = open_log(path, block_frames=1000)
        try:
            for block in reader:
                columns = [getattr(block, name) for name in ("t_us", "can_id", "length", "data") if
                           hasattr(block, name)]  # fmt: skip
                assert len({len(c) for c in columns}) <= 1
                assert columns[0].dtype == np.int64
            assert reader.frames >= 0
            assert reader.skipped_lines >= 0
            assert all("\n" not in text for _, text, _ in reader.skipped)
        finally:
            reader.close()
    with contextlib.suppress(CanestError):
        read_truth(path)


def _candump(count: int) -> bytes:
    frames = real_frames()[:count]
    path = scratch() / "seed.log"
    with CandumpWriter(path) as writer:
        writer.write(frames)
    return path.read_bytes()


@cache
def log_seeds() -> list[bytes]:
    """Return a small log of every kind that can be written here."""
    import can

    text = _candump(40)
    with lzma.open(DATA / "kenworth" / "normal.log.xz") as file:
        screen = file.read(4000)
    table = b"t_s,speed,torque\n" + b"".join(b"%d.02,%d,%d.5\n" % (k, 3 * k, 100 - k) for k in range(30))
    truth = b"t_s,grade,mass_kg\n0,0.01,20000\n1,nan,20000\n2,0.02,20000\n"
    contents = [(0, text), (0, screen), (4, table), (4, truth), (8, table.replace(b",", b";"))]
    contents += [(9, gzip.compress(text)), (0, bz2.compress(text)), (10, lzma.compress(table))]
    for index in (1, 2, 3, 4, 6):
        path = scratch() / f"seed{SUFFIXES[index]}"
        path.unlink(missing_ok=True)
        find_asammdf()
        writer = can.Logger(str(path))
        for k in range(20):
            writer(can.Message(timestamp=1.7e9 + k / 50, arbitration_id=0xCF00400, is_extended_id=True,
                               data=bytes(range(8)), channel=0))  # fmt: skip
        writer.stop()
        contents.append((index, path.read_bytes()))
    with contextlib.suppress(ImportError):
        import pyarrow
        import pyarrow.parquet

        sink = io.BytesIO()
        columns = {"t_s": [0.0, 0.02, 0.04], "speed": [1.0, 2.0, math.nan]}
        pyarrow.parquet.write_table(pyarrow.table(columns), sink)
        contents.append((5, sink.getvalue()))
    return [bytes([index]) + content for index, content in contents]


# -- frames --------------------------------------------------------------------------------------------

RECORD = struct.Struct("<IBBQ")  #: identifier, length, time step, payload
_STEPS_US = (0, 1, 20, 500, 1000, 5000, 10_000, 20_000, 20_001, 100_000, 750_001, 3_000_000, -1, -10_000,
             -2_000_000, -10**12, 10**12, 4 * 10**15)  # fmt: skip


@cache
def real_frames() -> FrameBlock:
    return FrameBlock.concatenate(list(open_log(DATA / "kenworth" / "normal.log.xz")))


def frames_of(data: bytes, ids: tuple[int, ...] = ()) -> FrameBlock:
    """Read frames out of bytes; with ``ids`` most identifiers are one of them."""
    rows, t_us = [], START_US
    for can_id, length, step, payload in RECORD.iter_unpack(data[: len(data) // RECORD.size * RECORD.size]):
        t_us += _STEPS_US[step % len(_STEPS_US)]
        n = 8 if length < 200 else length % 65
        known = ids and can_id % 8
        rows.append((t_us, ids[can_id // 8 % len(ids)] if known else can_id,
                     payload.to_bytes(8, "little")[:n].ljust(n, b"\0")))  # fmt: skip
    return FrameBlock.from_frames(rows)


@cache
def _config(name: str) -> Config:
    return load_config(name)


@cache
def ids_of(name: str) -> tuple[int, ...]:
    """Return identifiers that a config wants, transport frames included, from the addresses it names."""
    config, decoder = _config(name), decoder_for(_config(name))
    sources = sorted({s.source for s in config.signals.values() if s.source is not None}) or [0]
    groups = [
        (6 << 26) | (pgn << 8) | (0xFF00 if j1939.is_destination_specific(pgn) else 0) for pgn in decoder.pgns
    ]
    exact = [i for i, mask in decoder.can_filters() if i not in groups and mask & 0xFF]
    return tuple([g | s | EXTENDED for g in groups for s in sources] + exact)


def _same_samples(a: dict, b: list[dict]) -> None:
    joined: dict[str, list] = {}
    for part in b:
        for role, (t_us, values) in part.items():
            joined.setdefault(role, []).append((t_us, values))
    assert set(a) == set(joined)
    for role, (t_us, values) in a.items():
        assert t_us.tobytes() == np.concatenate([t for t, _ in joined[role]]).tobytes()
        assert values.tobytes() == np.concatenate([v for _, v in joined[role]]).tobytes()


_CONFIGS = ("class8", "class8-j1587", "kenworth", "testcar")


def run_decoder(data: bytes) -> None:
    """Both paths of the decoder and any cut must agree, and no value may be infinite."""
    if not data:
        return
    name = _CONFIGS[data[0] % len(_CONFIGS)]
    frames = frames_of(data[1:], ids_of(name))
    if 0 < len(frames) <= 300:
        frames = FrameBlock.concatenate(
            [frames] * (300 // len(frames) + 1)
        )  # the columnar path is for long ones
    whole, cut = decoder_for(_config(name)), decoder_for(_config(name))
    samples = whole.push(frames).samples
    size = 1 + data[0] // len(_CONFIGS)
    _same_samples(samples, [cut.push(frames[i : i + size]).samples for i in range(0, len(frames), size)])
    assert whole.counters == cut.counters
    for _, values in samples.values():
        assert not np.isinf(values).any()


def run_bam(data: bytes) -> None:
    """Transport frames only, as bursts of sessions: nothing but whole messages comes out."""
    ids = tuple(EXTENDED | base | source for base in (0x1CECFF00, 0x1CEBFF00, 0x1CEC3100, 0x1CEB3100)
                for source in (0x00, 0x0F, 0x31))  # fmt: skip
    frames = frames_of(data, ids)
    decoder: Decoder = decoder_for(_config("class8"))
    once = decoder_for(_config("class8"))
    samples = once.push(frames).samples
    _same_samples(samples, [decoder.push(frames[i : i + 1]).samples for i in range(len(frames))])
    counts = once.counters.transport
    assert counts == decoder.counters.transport
    assert once.open_sessions <= 64
    received = len(samples.get("reference_torque", ([], []))[0])
    assert received <= counts.get("complete", 0)


def _record(can_id: int, payload: bytes) -> bytes:
    return RECORD.pack(
        can_id, 0, _STEPS_US.index(10_000), int.from_bytes(payload.ljust(8, b"\xff"), "little")
    )


def _session(pgn: int, body: bytes, cm: int, dt: int) -> bytes:
    packets = -(-len(body) // 7)
    head = bytes([32]) + len(body).to_bytes(2, "little") + bytes([packets, 0xFF]) + pgn.to_bytes(3, "little")
    out = [_record(cm * 8 + 1, head)]
    out += [_record(dt * 8 + 1, bytes([k + 1]) + body[7 * k : 7 * k + 7]) for k in range(packets)]
    return b"".join(out)


def _split(records: bytes) -> list[bytes]:
    return [records[i : i + RECORD.size] for i in range(0, len(records), RECORD.size)]


def bam_seeds() -> list[bytes]:
    """Return whole sessions, of the wanted group and of others, and two that are interleaved."""
    ec1 = bytes(range(39))
    one, other = _session(65251, ec1, 0, 3), _session(65226, bytes(20), 1, 4)
    pairs = zip(_split(one), _split(other), strict=False)
    both = b"".join(a + b for a, b in pairs)
    return [one, other, both, one + one, _session(65251, bytes(1785), 0, 3)]


def frame_seeds() -> list[bytes]:
    """Return stretches of the real log."""
    frames = real_frames()
    seeds = []
    for begin in (0, 5000, 12_000):
        part = frames[begin : begin + 200]
        records = [
            RECORD.pack(i & ~7, 0, 3, d)
            for i, d in zip(part.can_id.tolist(), part.data.tolist(), strict=True)
        ]
        seeds += [bytes([k]) + b"".join(records) for k in (0, 2)]
    return seeds


# -- the whole pipeline --------------------------------------------------------------------------------


@cache
def _drive() -> FrameBlock:
    """Return the wanted frames of the first seconds of a simulated drive."""
    from canest.simulation.reading import load_scenario
    from canest.simulation.run import simulate

    frames = simulate(load_scenario("demo").model_copy(update={"duration_s": 6.0})).frames
    return decoder_for(_config("class8")).select(frames)


def check_estimates(config: Config, e: Estimates) -> None:
    """Raise AssertionError for an estimate that no vehicle can have."""
    started = ~np.isnan(e.mass_kg)
    valid = e.status == Status.VALID
    for column in (e.mass_kg, e.mass_std_kg, e.grade, e.grade_std):
        assert np.isfinite(column[valid]).all(), "a valid estimate without a number"
        assert np.isfinite(column[started]).all(), "mass without std or grade"
    low, high = config.vehicle.mass_min_kg, config.vehicle.mass_max_kg
    mass = e.mass_kg[started]
    assert ((mass >= low * (1 - 1e-9)) & (mass <= high * (1 + 1e-9))).all(), "mass out of bounds"
    assert (e.mass_std_kg[started] > 0).all()
    assert (e.grade_std[started] > 0).all()
    assert (np.abs(e.grade[started]) < 1).all()
    assert (np.diff(e.t_us) != 0).all()


def run_pipeline(data: bytes) -> None:
    """Mutated frames in a drive, from a restored mass, in blocks: estimates stay believable."""
    if len(data) < 4:
        return
    config, drive = _config("class8"), _drive()
    forged = frames_of(data[4:6_000], ids_of("class8"))  # as much as a second of work may be made of
    at = int.from_bytes(data[:2], "little") % len(drive)
    repeat = 1 + data[2] % 10
    shift = int(drive.t_us[at]) - START_US
    parts, last = [drive[:at]], at
    for k in range(repeat):
        end = min(last + 1 + data[3] * 8, len(drive))
        moved = forged.t_us + shift + k * 100_000
        parts += [FrameBlock(moved, forged.can_id, forged.length, forged.data), drive[last:end]]
        last = end
    parts.append(drive[last:])
    pipeline = Pipeline(config)
    if data[3] & 1:
        pipeline.restore(20_000.0, 600.0)
    for part in parts:
        check_estimates(config, pipeline.push(part))
    check_estimates(config, pipeline.finish())


def pipeline_seeds() -> list[bytes]:
    """Return a few records at a few places of the drive."""
    return [bytes([k * 40, k * 9, 5, 20 + k]) + seed[1 : 1 + RECORD.size * 40]
            for k, seed in enumerate([*frame_seeds()[::2], b"\0" + bam_seeds()[0]])]  # fmt: skip


# -- the node on the bus -------------------------------------------------------------------------------


class _Wire:
    """Takes what a node sends; every seventh frame finds the buffer full."""

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self.sent = 0

    def send(self, can_id: int, payload: bytes) -> bool:
        assert len(payload) == 8
        assert can_id & EXTENDED
        self.sent += 1
        return self.sent % 7 > 0

    @property
    def waiting(self) -> int:
        return self.sent % 3

    def failed(self) -> list[int]:
        return [0x18EEFF9E | EXTENDED] if self.sent % 11 == 0 else []

    def drop_waiting(self) -> None:
        """Nothing waits."""


def run_node(data: bytes) -> None:
    """Claims, requests and other users of our group: whatever they say, we do not flood the bus."""
    config = load_node_config()
    node, wire, begin_us = Node(config, BusMonitor(config.broadcast.pgn)), _Wire(), 1_000_000
    now_us = begin_us
    node.attach(config, wire, now_us)
    for can_id, length, step, payload in RECORD.iter_unpack(data[: len(data) // RECORD.size * RECORD.size]):
        now_us += step * step * 50
        n = min(length, 8)
        frame = (now_us, can_id, payload.to_bytes(8, "little")[:n])
        node.observe(FrameBlock.from_frames([frame]), now_us)
        node.send_due(now_us)
    # a claim, a refusal and an estimate in all groups per 100 ms is the most there may ever be
    assert wire.sent <= 20 + (now_us - begin_us) / 20_000 + 4 * len(data) / RECORD.size


@cache
def load_node_config() -> Config:
    return load_config("vcan", ["broadcast.cvw=true"])


def node_seeds() -> list[bytes]:
    """Return claims, requests, our own group and a mass from others, at several paces."""
    ids = (0x98EEFF9E, 0x98EAFF21, 0x98EA9E21, 0x98FF5A44, 0x98FE700B)
    payloads = (bytes(range(8)), bytes(8), b"\xff" * 8, (0xEE00).to_bytes(3, "little") + bytes(5))
    return [
        b"".join(RECORD.pack(i, 8, step, int.from_bytes(p, "little")) for i in ids for p in payloads)
        for step in (0, 20, 200)
    ]


# -- state and config ----------------------------------------------------------------------------------


def run_state(data: bytes) -> None:
    """Any file: either nothing is restored, or a mass that the pipeline can start from."""
    config, now_s = _config("class8"), 1.8e9
    path = scratch() / "learned.json"
    path.write_bytes(data)
    state.peek(path)
    restored = state.load(path, config, now_s)
    assert "\n" not in restored.message
    if restored.learned is None:
        return
    std_kg = state.widened_std_kg(restored.learned, config)
    assert math.isfinite(std_kg)
    assert std_kg > 0
    assert config.vehicle.mass_min_kg <= restored.learned.mass_kg <= config.vehicle.mass_max_kg
    pipeline = Pipeline(config)
    pipeline.restore(restored.learned.mass_kg, std_kg, state.unseen_s(restored.learned, now_s))
    check_estimates(config, pipeline.push(_drive()[:400]))


def state_seeds() -> list[bytes]:
    """Return a whole file."""
    config = _config("class8")
    learned = state.Learned(
        state.vehicle_key(config), state.fingerprint(config), 20_000.0, 500.0, 1.7e9, True
    )
    state.save(scratch() / "seed.json", learned)
    return [(scratch() / "seed.json").read_bytes()]


def run_config(data: bytes) -> None:
    """Any text: one plain error, or a config that runs."""
    path = scratch() / "config.yaml"
    path.write_bytes(data)
    try:
        config = load_config(path)
        pipeline = Pipeline(config)
        check_estimates(config, pipeline.push(_drive()[:800]))
        check_estimates(config, pipeline.finish())
    except CanestError as error:
        assert "\n" not in str(error)


def config_seeds() -> list[bytes]:
    """Return every shipped config."""
    return [
        find("configs", name).read_bytes() for name in ("class8", "kenworth", "bmw-i3", "testcar", "vcan")
    ]


_NUMBERS = (
    b"0 -1 nan inf -inf 1e308 1e-308 1e999 99999999999999999999 0x7f 2147483648 null true '' \xff \xc3\xa9 \0"
).split(b" ")
_YAML = [
    *(b"[", b"{", b"}", b"]", b": ", b"- ", b"\n", b"&a ", b"*a", b"? ", b"|\n", b"\t", b"<<: *a", b"!!set "),
    b"effects:\n - {effect: headwind, wind_mps: 3}\n",
    b"estimator: {name: rlsmf}\n",
    b"estimator: {name: ekf, options: {x: 1}}\n",
    b"filter: {order: 6, cutoff_hz: 24.9}\n",
]
_TEXT = [
    b" ",
    b"  can0  ",
    b"(",
    b")",
    b"#",
    b"##3",
    b"#R",
    b".",
    b"\r\n",
    b",",
    b";",
    b"\t",
    b"\n",
    b"E",
    b"[8]",
]

TARGETS = {
    t.name: t
    for t in (
        Target("logs", run_logs, log_seeds, [*_NUMBERS, *_TEXT]),
        Target("bam", run_bam, bam_seeds),
        Target("decoder", run_decoder, frame_seeds),
        Target("pipeline", run_pipeline, pipeline_seeds),
        Target("node", run_node, node_seeds),
        Target("state", run_state, state_seeds, (*_NUMBERS, b"[" * 2000, b'"mass_kg":', b"{}", b",", b":")),
        Target("config", run_config, config_seeds, [*_NUMBERS, *_YAML]),
    )
}


@cache
def all_targets() -> dict[str, Target]:
    """Return these targets, and one for every single parser (`tests.fuzz.parsers`), by name."""
    from .parsers import parser_targets

    return {**TARGETS, **{t.name: t for t in parser_targets()}}
