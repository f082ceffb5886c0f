"""MF4, BLF and ASC: our own readers give what python-can's give, frame by frame and fault by fault."""

from __future__ import annotations

import importlib.util
import lzma
import random
import struct
import sys
import time
import zlib
from collections import Counter
from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from canest.core.errors import LogError
from canest.core.frames import FrameBlock
from canest.logs.compression import Source
from canest.logs.python_can import PythonCanReader, find_asammdf
from tests.logs.helpers_logs import DATA, assert_same, read_all

MF4_ONLY = pytest.mark.skipif(importlib.util.find_spec("asammdf") is None, reason="asammdf (extra: formats)")
IN_A_FILE = settings(
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)

BLF_OBJECT = b"LOBJ"
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)


@st.composite
def messages(draw):
    """Some messages of every kind, in order of time."""
    stamp, found = draw(st.sampled_from((0.0, 1_700_000_000.0))), []
    for _ in range(draw(st.integers(0, 60))):
        stamp += draw(st.sampled_from((0.0, 0.000001, 0.0123, 1.5)))
        kind = draw(st.sampled_from(("classic", "classic", "classic", "fd", "remote", "error")))
        long = draw(st.booleans())
        size = draw(st.sampled_from(LENGTHS if kind == "fd" else LENGTHS[:9]))
        found.append(
            can.Message(
                timestamp=stamp,
                arbitration_id=draw(st.integers(0, 0x1FFF_FFFF if long else 0x7FF)),
                is_extended_id=long,
                is_fd=kind == "fd",
                is_remote_frame=kind == "remote",
                is_error_frame=kind == "error",
                is_rx=draw(st.booleans()),
                channel=draw(st.integers(0, 2)),
                dlc=size,
                data=None if kind == "remote" else draw(payloads(size)),
            )
        )
    return found


def payloads(size):
    """Payloads without the letters that begin an object of BLF: from there on python-can loses frames."""
    return st.binary(min_size=size, max_size=size).filter(lambda data: BLF_OBJECT not in data)


class Read:
    """What a reader makes of a file: its frames and all that it reports."""

    def __init__(self, make) -> None:
        self.frames, self.error, self.reader = FrameBlock.empty(), "", None
        blocks = []
        try:
            self.reader = make()
            blocks.extend(self.reader)
        except LogError as error:
            self.error = str(error)
        self.frames = FrameBlock.concatenate(blocks)

    @property
    def report(self):
        r = self.reader
        return (self.error, r.frames, dict(r.channels), r.skipped_lines, r.skipped, r.truncated_reason)


def through_python_can(path: Path, channel=None) -> Read:
    def make():
        source = Source(path)
        suffix = path.with_suffix("").suffix if path.suffix == ".xz" else path.suffix
        return PythonCanReader(source, source.read(1 << 16), suffix.lower(), None, channel, 1000)

    return Read(make)


def assert_equal_to_python_can(path: Path) -> FrameBlock:
    from canest.logs import open_log

    ours, theirs = Read(lambda: open_log(path, block_frames=50)), through_python_can(path)
    assert_same(ours.frames, theirs.frames)
    assert ours.report == theirs.report
    return ours.frames


def write(path: Path, found, **options) -> Path:
    find_asammdf()
    with can.Logger(str(path), **options) as logger:
        for message in found:
            logger.on_message_received(message)
    return path


@pytest.mark.parametrize("suffix", [".asc", ".blf"])
@settings(IN_A_FILE, max_examples=25)
@given(found=messages())
def test_frames_of_every_kind(tmp_path, suffix, found):
    path = tmp_path / f"drive{suffix}"
    if suffix == ".asc" or found:
        assert_equal_to_python_can(write(path, found))


@pytest.mark.parametrize("is_fd", [False, True])
def test_a_payload_that_looks_like_an_object_of_blf_is_a_payload(tmp_path, is_fd):
    """python-can looks for the next object by these letters, takes the payload for one and loses the rest."""
    data = [bytes(at) + BLF_OBJECT + bytes(4 - at) for at in range(5)] * 3
    found = [
        can.Message(timestamp=1.0 + 0.01 * i, arbitration_id=0x18F00400, is_fd=is_fd, data=each)
        for i, each in enumerate(data)
    ]
    frames, reader = read_all(write(tmp_path / "drive.blf", found))
    assert len(frames) == len(found) == reader.frames
    if not is_fd:
        assert [word.to_bytes(8, "little") for word in frames.data.tolist()] == data


@settings(IN_A_FILE, max_examples=12)
@given(found=messages(), level=st.integers(0, 2))
@MF4_ONLY
def test_frames_of_every_kind_in_an_mf4(tmp_path, found, level):
    """Plain, packed and transposed records; errors and requests are groups of their own."""
    assert_equal_to_python_can(write(tmp_path / "drive.mf4", found, compression_level=level))


def bus(count, seed=1):
    """Messages of a bus, more than fit into one block."""
    random.seed(seed)
    return [
        can.Message(
            timestamp=1_700_000_000 + 0.001 * i,
            arbitration_id=0x18FE0000 + i % 7 if i % 5 else 0x123,
            is_extended_id=bool(i % 5),
            channel=i % 2,
            data=random.randbytes(8 if i % 3 else i % 9),
        )
        for i in range(count)
    ]


@pytest.mark.parametrize("suffix", [".asc", ".blf", pytest.param(".mf4", marks=MF4_ONLY)])
def test_a_log_of_many_blocks_one_of_its_interfaces(tmp_path, suffix):
    path = write(tmp_path / f"drive{suffix}", bus(3000))
    assert len(assert_equal_to_python_can(path)) == 3000
    expected = through_python_can(path, channel="1").frames
    frames, _ = read_all(path, channel="1", block_frames=100)
    assert_same(frames, expected)
    assert len(frames) == 1500


# -- what loggers write ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["drive", "unfinished"])
@MF4_ONLY
def test_recordings_of_a_logger(tmp_path, name):
    path = tmp_path / f"{name}.mf4"
    path.write_bytes(lzma.decompress((DATA / "obd-car" / f"{name}.mf4.xz").read_bytes()))
    assert len(assert_equal_to_python_can(path)) == {"drive": 7601, "unfinished": 1952}[name]


@MF4_ONLY
def test_the_local_time_of_an_mf4_does_not_depend_on_the_machine(tmp_path, monkeypatch):
    """python-can writes a local time without its zone, as some loggers do."""
    found = bus(20)
    try:
        for zone in ("UTC", "America/New_York"):
            monkeypatch.setenv("TZ", zone)
            time.tzset()
            path = tmp_path / "local.mf4"
            block = assert_equal_to_python_can(path if path.exists() else write(path, found))
            assert block.t_us[0] == 1_700_000_000_000_000, zone
    finally:
        monkeypatch.undo()
        time.tzset()


def test_an_mf4_is_read_without_asammdf(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    frames, reader = read_all(DATA / "obd-car" / "drive.mf4.xz")
    assert (len(frames), dict(reader.channels)) == (7601, {"1": 870, "2": 6731})


@pytest.mark.parametrize(("share", "frames"), [(0.7, 694), (0.9, 5296)])
def test_an_mf4_that_is_cut_short_gives_the_frames_whose_data_bytes_are_there(tmp_path, share, frames):
    whole = lzma.decompress((DATA / "obd-car" / "drive.mf4.xz").read_bytes())
    (tmp_path / "whole.mf4").write_bytes(whole)
    (tmp_path / "cut.mf4").write_bytes(whole[: int(share * len(whole))])
    block, reader = read_all(tmp_path / "cut.mf4")
    assert_same(block, read_all(tmp_path / "whole.mf4")[0][:frames])
    assert reader.truncated_reason == f"ends early, after {frames:,} frames"


def frames_of(block: FrameBlock) -> Counter:
    return Counter(zip(block.t_us.tolist(), block.can_id.tolist(), block.data.tolist(), strict=True))


@pytest.mark.parametrize("cut", [1, 7, 100, 20_000])
def test_an_unfinished_mf4_may_end_anywhere(tmp_path, cut):
    whole = lzma.decompress((DATA / "obd-car" / "unfinished.mf4.xz").read_bytes())
    (tmp_path / "whole.mf4").write_bytes(whole)
    (tmp_path / "cut.mf4").write_bytes(whole[:-cut])
    block, _ = read_all(tmp_path / "cut.mf4")
    expected, _ = read_all(tmp_path / "whole.mf4")
    assert 0 <= len(expected) - len(block) <= cut // 9 + 1
    assert frames_of(block) <= frames_of(expected)


# -- BLF objects that python-can does not write -------------------------------------------------------------


def blf_file(objects: list[bytes], container_bytes: int, method: int, start=(2023, 11, 2, 14, 22, 13, 20, 5)):
    content, body = b"".join(objects), b""
    for first in range(0, len(content), container_bytes):
        part = content[first : first + container_bytes]
        data = zlib.compress(part) if method == 2 else part
        body += struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(data), 10, method, len(part))
        body += data + bytes((32 + len(data)) % 4)
    header = struct.pack(
        "<4sLBBBBBBBBQQLL8H8H", b"LOGG", 144, *[0] * 8, 144 + len(body), 0, 0, 0, *start, *[0] * 8
    )
    return header.ljust(144, b"\0") + body


@st.composite
def blf_objects(draw):
    """Return one object: a frame in any of the layouts, or something else."""
    flags, version = draw(st.sampled_from((1, 2))), draw(st.sampled_from((1, 1, 1, 2, 3)))
    stamp = draw(st.one_of(st.integers(0, 10**13), st.integers(0, 2**62)))
    channel, identifier = draw(st.integers(0, 5)), draw(st.integers(0, 2**32 - 1))
    byte, data = st.integers(0, 255), draw(st.binary(min_size=64, max_size=64))
    kind = draw(st.sampled_from((1, 1, 86, 73, 100, 101, 65, 8)))
    if kind in (1, 86):
        body = struct.pack("<HBBL8s", channel, draw(byte), draw(byte), identifier, data[:8])
        body += bytes(8) if kind == 86 else b""
    elif kind == 73:
        dlc = draw(byte)
        body = struct.pack("<HHLBBBxLLH2x8s", channel, 0, 0, 0, 0, dlc, 0, identifier, 0, data[:8])
    elif kind == 100:
        body = struct.pack(
            "<HBBLLBBB5x64s", channel, draw(byte), draw(byte), identifier, 0, 0, 1, draw(byte), data
        )
    elif kind == 101:
        size, extension = draw(byte), draw(st.sampled_from((0, 0, 80, 90)))
        head = (channel, draw(byte), size, 0, identifier, 0, draw(st.sampled_from((0, 0x1000, 0x1010))))
        body = struct.pack("<BBBBLLLLLLLHBBL", *head, 0, 0, 0, 0, 0, draw(st.integers(0, 1)), extension, 0)
        body += data[: draw(st.integers(0, 64))]
    else:
        body = draw(st.sampled_from((b"comment", b"LOBJ in a text", data)))
    head = (
        struct.pack("<LHHQ", flags, 0, 0, stamp)
        if version == 1
        else struct.pack("<LBxHQ8x", flags, 0, 0, stamp)
    )
    size = 16 + len(head) + len(body)
    base = struct.pack("<4sHHLL", b"LOBJ", 16 + len(head), version, size, kind)
    return base + head + body + bytes(draw(st.sampled_from((size % 4, -size % 4))))


@settings(IN_A_FILE, max_examples=60)
@given(
    objects=st.lists(blf_objects(), min_size=1, max_size=30),
    container_bytes=st.sampled_from((1 << 17, 1000, 300)),
    method=st.sampled_from((0, 2)),
)
def test_blf_objects_of_every_kind(tmp_path, objects, container_bytes, method):
    path = tmp_path / "drive.blf"
    path.write_bytes(blf_file(objects, container_bytes, method))
    assert_equal_to_python_can(path)


@settings(IN_A_FILE, max_examples=60)
@given(
    objects=st.lists(blf_objects(), min_size=1, max_size=12),
    method=st.sampled_from((0, 2)),
    damage=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=4),
    keep=st.floats(0.2, 1.0),
)
def test_blf_files_that_are_damaged_or_cut_short(tmp_path, objects, method, damage, keep):
    content = bytearray(blf_file(objects, 500, method))
    for place, value in damage:
        content[4 + int(place * (len(content) - 4))] = value
    path = tmp_path / "drive.blf"
    path.write_bytes(content[: int(keep * len(content))])
    assert_equal_to_python_can(path)


# -- lines of an .asc log --------------------------------------------------------------------------------

ASC_LINES = (
    "   {t} 1  18FEEE31x       Rx   d 8 BA FF 62 B9 90 DF A2 C4",
    "   {t} 2  18FEEE31x       Tx   d 8 BA FF 62 B9 90 DF A2 C4  Length = 244{n} BitCount = 126 ID = 41{n}x",
    "   {t} 1  7{n}             Rx   d 3 01 02 03",
    "   {t} 1  7{n}             Rx   d 3 01 02 03 04 05",
    "   {t} 1  {n}             Rx   d 0",
    "   {t} 1  {n}             Rx   d 0 ",
    "   {t} 1  {n}             Rx   r",
    "   {t} 1  {n}x            Rx   r {n}",
    "   {t} 1  {n}x            Rx   r 4 Length = 0",
    "   {t} 1  ErrorFrame",
    "   {t} 1  ErrorFrame  ECC: 10{n}",
    "   {t} CANFD   1 Rx   18FEEE31x   Engine  1 0 9 12 01 02 03 04 05 06 07 08 09 0A 0B 0C  0 0 {n}",
    "   {t} CANFD   2 Tx        12{n}          0 0 8  8 01 02 03 04 05 06 07 {n}{n}  0 0",
    "   {t} CANFD   1 Rx   12   1 0 8 0 ",
    "   {t} CANFD   1 Rx   ErrorFrame  not acknowledged",
    # odd, damaged, or no frame at all
    "   {t} 1  1FFFFFFFFx      Rx   d 1 00",
    "   {t} 1  3FFFFFFFx       Rx   d 1 00",
    "   {t} 1  18FEEE31x       Rx   d 8 BA FF",
    "   {t} 1  18FEEE31x       Rx   d 8 B FF 62 B9 90 DF A2 C4",
    "   {t} 1  18FEEE31x       Rx   d 8 BA FF 62 B9 90 DF A2 C",
    "   {t} 1  18FEEE31x       Rx   d 8 BA FF 62 B9 90 DF A2 C4EE",
    "   {t} 1  18FEEE31x       Rx   d 9 BA FF 62 B9 90 DF A2 C4",
    "   {t} 1  18FEEE31x       TxRq d 1 BA",
    "   {t} 1  18FEEE31x       rx   D 1 ba",
    "   {t} 1  18FEEG31x       Rx   d 1 BA",
    "   {t} 1  Statistic: D 0 R 0 XD 700 XR 0 E 0 O 0 B 8.50%",
    "   {t} J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F",
    "   {t} log trigger event",
    "// a comment",
    "Begin Triggerblock Tue Nov 14 22:13:20.0 2023",
    "End TriggerBlock",
    "garbage",
    "",
)
STAMPS = (
    "0.000000",
    "1.5",
    "12.123456",
    "1700000000.000123",
    "1799999999.999999",
    "3.1234567",
    "2999999999.5",
)
ASC_HEADERS = (
    "date Tue Nov 14 22:13:20.0 2023\nbase hex  timestamps absolute\ninternal events logged\n",
    "date Tue Nov 14 10:13:20.000 pm 2023\nbase hex  timestamps absolute\nno internal events logged\n// a\n",
    "date Tue Nov 14 22:13:20.0 2023\nbase dec  timestamps absolute\ninternal events logged\n",
    "base hex timestamps absolute\n",
    "// version 13.0.0\ndate Tue Nov 14 22:13:20.0 2023\n\n",
)


@settings(IN_A_FILE, max_examples=60)
@given(
    header=st.sampled_from(ASC_HEADERS),
    lines=st.lists(
        st.tuples(st.sampled_from(ASC_LINES), st.sampled_from(STAMPS), st.integers(0, 9), st.integers(1, 40)),
        max_size=20,
    ),
    ending=st.sampled_from(("\n", "\r\n")),
)
@example(ASC_HEADERS[0], [(line, stamp, 3, 40) for line in ASC_LINES for stamp in STAMPS], "\n")
def test_asc_lines_of_every_kind(tmp_path, header, lines, ending):
    text = header + "".join(
        line.format(t=stamp, n=(n + i) % 10) + "\n" for line, stamp, n, count in lines for i in range(count)
    )
    path = tmp_path / "drive.asc"
    path.write_bytes(text.replace("\n", ending).encode())
    assert_equal_to_python_can(path)


@pytest.mark.parametrize("end", ["", "\n", "\n   1.5 1  18FEE"])
def test_an_asc_log_that_ends_in_a_line(tmp_path, end):
    path = write(tmp_path / "drive.asc", bus(200))
    path.write_text(path.read_text().removesuffix("End TriggerBlock\n").rstrip("\n") + end)
    assert_equal_to_python_can(path)


def test_an_archive_of_an_asc_log_that_is_cut_off(tmp_path):
    text = write(tmp_path / "drive.asc", bus(5000)).read_bytes()
    path = tmp_path / "drive.asc.xz"
    packed = lzma.compress(text)
    path.write_bytes(packed[: len(packed) // 2])
    assert 0 < len(assert_equal_to_python_can(path)) < 5000
