from __future__ import annotations

import contextlib
import gc
import gzip
import importlib.util
import os
import sqlite3
import subprocess
import sys
import threading
import warnings

import can
import numpy as np
import pytest

from canest.core.errors import LogError
from canest.core.frames import EXTENDED, REMOTE, FrameBlock
from canest.logs import open_log
from canest.logs.python_can import find_asammdf
from tests.fresh_interpreter import output_of
from tests.logs.helpers_logs import assert_same, read_all

MF4_ONLY = pytest.mark.skipif(importlib.util.find_spec("asammdf") is None, reason="asammdf (extra: formats)")
MF4 = pytest.param(".mf4", marks=MF4_ONLY)
FRAMES = [
    (1_000_000 + 10_000 * i, (0x18FEEE31 | EXTENDED) if i % 3 else 0x123, bytes([i % 256, 2, 3][: i % 4]))
    for i in range(200)
]


def write(path, frames=FRAMES, remote=False):
    find_asammdf()  # whatever imported python-can first
    with can.Logger(str(path)) as logger:
        for t_us, can_id, payload in frames:
            logger.on_message_received(
                can.Message(
                    timestamp=t_us / 1e6,
                    arbitration_id=can_id & 0x1FFFFFFF,
                    is_extended_id=bool(can_id & EXTENDED),
                    data=payload,
                    channel=0,
                )
            )
        if remote:
            logger.on_message_received(
                can.Message(timestamp=9.0, arbitration_id=5, is_remote_frame=True, dlc=4, channel=0)
            )
    return path


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".csv", ".db", MF4])
def test_what_python_can_writes_is_read(tmp_path, suffix):
    block, reader = read_all(write(tmp_path / f"drive{suffix}"))
    expected = FrameBlock.from_frames(FRAMES)
    offset = int(block.t_us[0]) - int(expected.t_us[0])  # some formats count from their first frame
    assert_same(
        block, FrameBlock(expected.t_us + offset, expected.can_id, expected.length, expected.data)
    ) if suffix != ".trc" else assert_same(
        block, FrameBlock(block.t_us, expected.can_id, expected.length, expected.data)
    )
    assert (reader.frames, reader.skipped_lines) == (200, 0)


@pytest.mark.parametrize("suffix", [".asc", ".blf"])
def test_remote_frames_are_marked(tmp_path, suffix):
    block, _ = read_all(write(tmp_path / f"drive{suffix}", remote=True))
    assert int(block.can_id[-1]) == 5 | EXTENDED | REMOTE
    assert not block.data[-1]


@pytest.mark.parametrize("suffix", [".asc", ".csv"])
def test_a_damaged_line_is_counted_and_the_rest_is_read(tmp_path, suffix):
    path = write(tmp_path / f"drive{suffix}")
    lines = path.read_text().splitlines(keepends=True)
    damaged = {".asc": "   1.5 1  xyz    Rx   d 8 zz\n", ".csv": "1.5,0xzz,1,0,0,1,AA==\n"}[suffix]
    lines[50] = damaged
    lines[120] = damaged
    path.write_text("".join(lines))
    block, reader = read_all(path)
    assert len(block) == 198
    assert reader.skipped_lines == 2
    assert [number for number, _, _ in reader.skipped] == [51, 121]


GARBAGE = {
    ".asc": [
        "hello garbage",
        "   1.5 1  18FEEE31",
        "   1.5 1  18FEEE31x  Rx   d 8 01 02",
        "   1.5 1  18FEEE31x  Rx",
        "   1.5 1  zzz  Rx   d 8 01 02 03 04 05 06 07 08",
        "\x00\x00",
    ],
    ".csv": ["1.5,0x12", "1.5,0xzz,1,0,0,1,AA==", "1.5,0x12,1,0,0,8,AQID", "1.5,0x12,1,0,0,8,AQI", "1.5,"],
    ".trc": ["garbage", "12 1.5 DT", "  12  x DT 18FEEE31 Rx 1  AA"],
}


@pytest.mark.parametrize("suffix", GARBAGE)
def test_no_garbage_vanishes_uncounted_nor_does_a_last_line_cut_off(tmp_path, suffix):
    path = write(tmp_path / f"drive{suffix}")
    lines = path.read_text().splitlines()
    count = len(GARBAGE[suffix])
    header = next(i for i, line in enumerate(lines) if "18FEEE31" in line.upper())
    at = header + 20
    lines[at:at] = GARBAGE[suffix]
    whole = next(line for line in reversed(lines) if "18FEEE31" in line.upper())
    last = whole.rstrip()[: whole.upper().index("18FEEE31") + 5]
    path.write_text("\n".join([*lines, last]))
    block, reader = read_all(path)
    assert len(block) == 200
    assert reader.skipped_lines == count + 1
    assert [number for number, _, _ in reader.skipped] == [*range(at + 1, at + count + 1), len(lines) + 1]
    for _, _, reason in reader.skipped:
        assert "Error" not in reason
        assert "unpack" not in reason and "literal" not in reason


def test_what_an_asc_logs_beside_frames_is_no_fault(tmp_path):
    events = """   1.500000 1  Statistic: D 0 R 0 XD 700 XR 0 E 0 O 0 B 8.50%
   1.500000 CAN 1 Status:chip status error active
   1.500000 1  ErrorFrame
   1.500000 J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F
   1.500000 log trigger event
   1.500000 SV: 3 0 1 ::Gear = 4
// a comment

End TriggerBlock"""
    path = write(tmp_path / "drive.asc")
    lines = path.read_text().splitlines()
    lines[50:50] = events.splitlines()
    path.write_text("\n".join(lines))
    block, reader = read_all(path)
    assert (len(block), reader.skipped_lines) == (201, 0)


def test_a_truncated_blf_gives_what_it_holds(tmp_path):
    frames = [
        (i * 1000, 0x18FEEE31 | EXTENDED, (i * 2654435761).to_bytes(8, "little")) for i in range(20_000)
    ]
    path = write(tmp_path / "drive.blf", frames)
    path.write_bytes(path.read_bytes()[:-5000])
    block, reader = read_all(path)
    assert 1000 < len(block) < 20_000
    assert reader.truncated


def test_wanted_and_channel_apply_here_too(tmp_path):
    path = write(tmp_path / "drive.asc")
    block, reader = read_all(path, wanted=lambda can_id: can_id == 0x123)
    assert reader.frames == 200
    assert set(block.can_id.tolist()) == {0x123}
    assert len(read_all(path, channel="0")[0]) == 200
    with pytest.raises(LogError, match=r"this channel, found '7', expected one of 0 \(200 frames"):
        read_all(path, channel="7")


@pytest.mark.skipif(importlib.util.find_spec("asammdf") is not None, reason="asammdf is installed")
def test_mf4_without_its_package_names_the_extra(tmp_path):
    path = tmp_path / "drive.mf4"
    path.write_bytes(b"MDF     4.10    " + bytes(100))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(LogError, match=r"pip install canest\[formats\]"):
            list(open_log(path))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@MF4_ONLY
def test_a_truncated_mf4_is_one_line_and_nothing_else(tmp_path, capfd, share):
    path = write(tmp_path / "drive.mf4")
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])  # its descriptions come last
    with pytest.raises(LogError, match=r"drive\.mf4: damaged or cut short, nothing in it can be read"):
        list(open_log(path))
    gc.collect()
    assert capfd.readouterr() == ("", "")


@MF4_ONLY
def test_a_compressed_mf4_is_read(tmp_path):
    path = tmp_path / "drive.mf4.gz"
    path.write_bytes(gzip.compress(write(tmp_path / "drive.mf4").read_bytes()))
    assert len(read_all(path)[0]) == 200


def database(path, rows):
    columns = "ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER, dlc INTEGER"
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute(f"CREATE TABLE messages ({columns}, data BLOB)")
        frames = ((1 + 0.001 * i, 0x18FEEE31, 1, 0, 0, 8, bytes(8)) for i in range(rows))
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", frames)
        connection.commit()
    return path


@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
def test_a_truncated_database_gives_what_it_holds(tmp_path, share):
    path = database(tmp_path / "drive.db", 5000)
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[: int(share * size)])
    block, reader = read_all(path)
    assert (share - 0.05) * 5000 < len(block) < (share + 0.01) * 5000
    assert set(block.can_id.tolist()) == {0x18FEEE31 | EXTENDED}
    assert reader.truncated_reason.endswith(f"of the {size:,} bytes its header announces")


def test_a_database_cut_in_its_first_page_has_that_reason(tmp_path):
    path = database(tmp_path / "drive.db", 5000)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(LogError, match=r"drive\.db: damaged or cut short, .*, expected a whole \.db file"):
        list(open_log(path))


@pytest.mark.parametrize("suffix", [".blf", ".db", ".asc", MF4])
def test_what_comes_through_a_pipe_is_read_too(tmp_path, suffix):
    expected, _ = read_all(write(tmp_path / f"drive{suffix}"))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    content = (tmp_path / f"drive{suffix}").read_bytes()
    feeder = threading.Thread(target=pipe.write_bytes, args=(content,))
    feeder.start()
    block, _ = read_all(pipe)
    feeder.join()
    assert_same(block, expected)


def test_an_export_of_time_differences_is_refused_by_name(tmp_path):
    path = write(tmp_path / "drive.asc")
    path.write_text(path.read_text().replace("timestamps absolute", "timestamps relative"))
    with pytest.raises(
        LogError, match="'timestamps relative', expected an export with `timestamps absolute`"
    ):
        read_all(path)


@MF4_ONLY
def test_a_damaged_mf4_makes_no_noise(tmp_path, capfd):
    path = write(tmp_path / "drive.mf4")
    content = bytearray(path.read_bytes())
    for at in range(300, len(content), 97):  # descriptions, names and links alike
        content[at] ^= 0x55
    path.write_bytes(content)
    with contextlib.suppress(LogError):
        list(open_log(path))
    gc.collect()
    assert capfd.readouterr() == ("", "")


@MF4_ONLY
def test_an_mf4_is_read_where_a_bus_was_used_before(tmp_path):
    write(tmp_path / "drive.mf4")
    code = (
        "import sys, canest.bus.drivers; from canest.logs import open_log; "
        "reader = open_log(sys.argv[1]); [None for _ in reader]; print(reader.frames)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "drive.mf4")], capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == str(len(FRAMES)), done.stderr


def test_an_odd_line_of_an_asc_log_does_not_bring_asammdf(tmp_path):
    """python-can reads such a line, and would import asammdf: a second, and 80 MB of a fleet's worker."""
    log = tmp_path / "odd.asc"
    with can.Logger(log) as writer:
        writer(can.Message(timestamp=0.5, arbitration_id=0x18EAFF31, data=b"\xe9\xfe\x00"))
    code = f"""
import sys
from canest.logs.format_detection import open_log
print(sum(map(len, open_log({str(log)!r}))), "can" in sys.modules, "asammdf" in sys.modules)
"""
    assert output_of(code).split() == ["1", "True", "False"]


def test_an_mf4_of_decoded_signals_says_so(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    t_s = np.arange(0.0, 10.0, 0.02)
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(t_s, t_s, name="VehSpd", unit="km/h")])
        path = file.save(tmp_path / "signals.mf4")
    with pytest.raises(LogError, match="holds decoded signals and no CAN frames, expected a recording of"):
        list(open_log(path))
