"""Small logs made to cost much: one line says why each is given up."""

from __future__ import annotations

import contextlib
import importlib.util
import lzma
import signal
import sqlite3
import struct
import tempfile
import threading
import time
import zlib

import numpy as np
import pytest

from canest.core.errors import LogError
from canest.logs import budget, open_log
from canest.logs.budget import LogBudget, log_budget
from tests.logs.helpers_logs import log_form, read_all

PARQUET_ONLY = pytest.mark.skipif(
    importlib.util.find_spec("pyarrow") is None, reason="pyarrow (extra: formats)"
)
BRIEF = LogBudget(time_s=1.0)
#: 400 MB, as archives one behind the other
ZEROS_XZ = lzma.compress(bytes(1 << 22), preset=0) * 100


@pytest.fixture(autouse=True)
def ended():
    """End a test that would never end."""
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("does not end"))
    signal.alarm(60)
    yield
    signal.alarm(0)


def blf(*objects: bytes) -> bytes:
    content = zlib.compress(b"".join(objects))
    container = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(content), 10, 2, sum(map(len, objects)))
    body = container + content + bytes(len(content) % 4)
    header = struct.pack("<4sLBBBBBBBBQQLL8H8H", b"LOGG", 144, *[0] * 8, 144 + len(body), 0, 0, 0, *[0] * 16)
    return header.ljust(144, b"\0") + body


def blf_object(size: int = 48, kind: int = 1, stamp_ns: int = 0) -> bytes:
    header = struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, size, kind, 2, 0, 0, stamp_ns)
    return header + struct.pack("<HBBL8s", 1, 0, 8, 0x123, bytes(8))


#: canest's own reader leaves it to python-can
ONLY_FOR_PYTHON_CAN = blf(blf_object(0))


@pytest.mark.parametrize("kind", [1, 77])
def test_a_blf_object_of_size_0_ends_the_log(tmp_path, kind):
    path = tmp_path / "drive.blf"
    path.write_bytes(blf(blf_object(0, kind)))
    assert path.stat().st_size < 300
    with pytest.raises(LogError, match=r"drive\.blf: damaged .*an object of size 0"):
        read_all(path)


def test_what_stands_before_a_blf_object_of_size_0_is_read(tmp_path):
    path = tmp_path / "drive.blf"
    path.write_bytes(blf(blf_object(), blf_object(stamp_ns=10**9), blf_object(0)))
    block, reader = read_all(path)
    assert len(block) == 2
    assert "an object of size 0" in reader.truncated_reason


def database(path, *statements):
    with contextlib.closing(sqlite3.connect(path)) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()
    return path


ENDLESS = "WITH RECURSIVE n(ts) AS (SELECT 1.0 UNION ALL SELECT ts + 1 FROM n{limit}) SELECT {columns} FROM n"
COLUMNS = "ts, 291 AS arbitration_id, 0 AS extended, 0 AS remote, 0 AS error, 8 AS dlc, zeroblob(8) AS data"


@pytest.mark.parametrize("name", ["messages", "MESSAGES"])
@pytest.mark.parametrize("where", ["", " WHERE ts < 0"])
def test_messages_that_are_a_view_are_refused(tmp_path, name, where):
    query = ENDLESS.format(limit="", columns=COLUMNS)
    path = database(tmp_path / "drive.db", f"CREATE VIEW {name} AS {query}{where}")
    with pytest.raises(LogError, match=r"drive\.db: `messages` is no plain table, found 'a view'"):
        read_all(path)
    packed = tmp_path / "drive.db.xz"
    packed.write_bytes(lzma.compress(path.read_bytes()))
    with pytest.raises(LogError, match=r"drive\.db\.xz: `messages` is no plain table"):
        read_all(packed)


def test_messages_that_are_a_virtual_table_are_refused(tmp_path):
    path = database(tmp_path / "drive.db", "CREATE VIRTUAL TABLE messages USING fts5(a, b, c, d, e, f, g)")
    with pytest.raises(LogError, match="found 'a virtual table'"):
        read_all(path)


def test_a_query_that_gives_no_row_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("canest.logs.damaged.refuse_query", lambda *_: None)
    query = ENDLESS.format(limit="", columns=COLUMNS)
    path = database(tmp_path / "drive.db", f"CREATE VIEW messages AS {query} WHERE ts < 0")
    with log_budget(BRIEF), pytest.raises(LogError, match=r"takes more than 1 s of computing"):
        read_all(path)


def test_a_database_is_not_written_to(tmp_path):
    columns = "ts, arbitration_id, extended, remote, error, dlc, data"
    path = database(
        tmp_path / "drive #1%20.db", f"CREATE TABLE messages ({columns})",
        "INSERT INTO messages VALUES (1.0, 291, 0, 0, 0, 8, zeroblob(8))",
    )  # fmt: skip
    path.chmod(0o444)
    assert len(read_all(path)[0]) == 1
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("head", [b"LOGG", b"SQLite format 3\0", b"PAR1", b"(1.0) can0 123#00\n"])
def test_an_archive_that_unpacks_to_too_much_is_given_up_early(tmp_path, monkeypatch, head):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    path = tmp_path / "drive.xz"
    path.write_bytes(lzma.compress(head) + ZEROS_XZ)
    with pytest.raises(
        LogError, match=r"drive\.xz: unpacks to more than 200 times its size, found \d+ MB so far"
    ):
        list(open_log(path))
    assert list(tmp_path.iterdir()) == [path]


def test_a_small_archive_may_unpack_to_any_multiple(tmp_path):
    path = tmp_path / "drive.log.xz"
    path.write_bytes(lzma.compress(b"(0000000001.000000) can0 123#00\n" * 200_000))
    assert path.stat().st_size * 200 < 200_000 * 32
    assert len(read_all(path)[0]) == 200_000


def test_a_library_that_loops_is_stopped_though_it_swallows_errors(tmp_path, monkeypatch):
    import can

    class Loops(can.BLFReader):
        def __iter__(self):
            while True:
                with contextlib.suppress(Exception):
                    while True:
                        pass
            yield

    monkeypatch.setattr("canest.logs.python_can.blf_reader", Loops)
    path = tmp_path / "drive.blf"
    path.write_bytes(ONLY_FOR_PYTHON_CAN)
    before = signal.getsignal(signal.SIGVTALRM)
    with log_budget(BRIEF), pytest.raises(LogError, match=r"drive\.blf: takes more than 1 s of computing"):
        read_all(path)
    assert signal.getsignal(signal.SIGVTALRM) == before
    assert signal.getitimer(signal.ITIMER_VIRTUAL) == (0.0, 0.0)


def endless_frames(monkeypatch, path):
    import can

    class Endless(can.BLFReader):
        def __iter__(self):
            while True:
                yield can.Message(timestamp=1.0, arbitration_id=1, data=bytes(8), channel=0)

    monkeypatch.setattr("canest.logs.python_can.blf_reader", Endless)
    path.write_bytes(ONLY_FOR_PYTHON_CAN)
    return path


def test_in_a_thread_the_steps_of_reading_are_counted(tmp_path, monkeypatch):
    path = endless_frames(monkeypatch, tmp_path / "drive.blf")
    raised = []

    def read():
        with log_budget(BRIEF), pytest.raises(LogError) as caught:
            for _ in open_log(path, block_frames=1000):
                pass
        raised.append(str(caught.value))

    thread = threading.Thread(target=read)
    thread.start()
    thread.join(50)
    assert "takes more than 1 s of computing" in raised[0]


def test_time_spent_on_the_blocks_is_not_the_log_s(tmp_path):
    path = tmp_path / "drive.log"
    path.write_text("".join(log_form(10_000 * i, 0x123, b"") + "\n" for i in range(5000)))
    with log_budget(LogBudget(time_s=0.5)):
        for _ in open_log(path, block_frames=1000):
            end_s = time.process_time() + 0.5
            while time.process_time() < end_s:
                pass


def test_memory_is_refused_while_a_library_takes_it(tmp_path, monkeypatch):
    import can

    class Hoards(can.BLFReader):
        def __iter__(self):
            hoard = []
            while True:
                hoard.append(bytes(1 << 20))
                np.frombuffer(bytearray(hoard[-1]), np.uint8)[:] = 1
            yield

    monkeypatch.setattr("canest.logs.python_can.blf_reader", Hoards)
    path = tmp_path / "drive.blf"
    path.write_bytes(ONLY_FOR_PYTHON_CAN)
    with log_budget(LogBudget(memory_mb=200)), pytest.raises(LogError, match="more than 200 MB of memory"):
        read_all(path)


def test_memory_far_beyond_is_refused_by_the_kernel(tmp_path, monkeypatch):
    import can

    class Grabs(can.BLFReader):
        def __iter__(self):
            bytearray(1 << 33)
            yield

    monkeypatch.setattr("canest.logs.python_can.blf_reader", Grabs)
    path = tmp_path / "drive.blf"
    path.write_bytes(ONLY_FOR_PYTHON_CAN)
    with pytest.raises(
        LogError, match=r"more than 2,000 MB of memory to read, expected .*--log-budget memory"
    ):
        read_all(path)


def test_a_size_that_a_damaged_blf_announces_costs_nothing(tmp_path):
    path = tmp_path / "drive.blf"
    object_of_4_gb = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 0xFFFF_FFF0, 10)
    path.write_bytes(blf(blf_object()) + object_of_4_gb)
    block, reader = read_all(path)
    assert len(block) == 1
    assert reader.truncated


@PARQUET_ONLY
def test_a_parquet_file_whose_rows_take_too_much_is_refused_before_it_is_read(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "drive.parquet"
    rows = 200_000
    table = pa.table({"t_s": np.arange(rows) / 50, "v": np.random.default_rng(1).random(rows)})
    pq.write_table(table, path, row_group_size=rows)
    with (
        log_budget(LogBudget(memory_mb=1)),
        pytest.raises(LogError, match=r"1 MB of memory to read, found 4 MB"),
    ):
        list(open_log(path))
    pq.write_table(table, path, row_group_size=rows // 10)
    with log_budget(LogBudget(memory_mb=1)):
        open_log(path).close()


def test_a_file_that_is_mostly_a_hole_counts_as_what_it_takes_up(tmp_path):
    path = tmp_path / "drive.log"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with budget_of(path) as meter:
        assert meter.stored == 0
    with path.open("r+b") as file:
        file.write(b"x")
    with budget_of(path) as meter:
        assert meter.stored < 1 << 20


@contextlib.contextmanager
def budget_of(path):
    reader = open_log(path)
    yield reader.meter
    reader.close()


def test_the_budget_grows_with_the_log(tmp_path):
    assert LogBudget().allowed_s(0) == 60.0
    assert LogBudget().allowed_s(100_000_000) == 120.0
    assert LogBudget(time_s=5.0).allowed_s(1e12) == 5.0
    assert budget.current_budget() == LogBudget()
