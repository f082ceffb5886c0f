"""Files that are whole, and the thread that waits for the disk."""

from __future__ import annotations

import gzip
import os
import threading
import time
from io import FileIO
from pathlib import Path

import numpy as np
import pytest

from canest.core.estimates import Estimates
from canest.core.frames import ERROR, EXTENDED, REMOTE, FrameBlock
from canest.live.record import Ring, TextLog, candump_renderer, render_estimates
from canest.logs.estimate_writer import HEADER
from canest.logs.format_detection import open_log
from canest.system.files import Background, write_atomically


@pytest.fixture
def background():
    worker = Background()
    yield worker
    worker.close(5)


def frames(n, begin_us=1_700_000_000_000_000, seed=1):
    rng = np.random.default_rng(seed)
    return FrameBlock(
        begin_us + np.arange(n, dtype=np.int64) * 1000,
        (rng.integers(0, 2**29, n) | EXTENDED).astype(np.uint32),
        np.full(n, 8, np.uint8),
        rng.integers(0, 2**63, n, dtype=np.uint64),
    )


def same(a, b):
    return all(np.array_equal(getattr(a, c), getattr(b, c)) for c in ("t_us", "can_id", "length", "data"))


def test_a_file_is_replaced_whole_and_leaves_no_litter(tmp_path):
    path = tmp_path / "a" / "file"
    write_atomically(path, b"old")
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in path.parent.iterdir()] == ["file"]


def test_a_write_that_fails_leaves_the_old_content(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_atomically(path, b"old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("canest.system.atomic_file.os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_directory_that_cannot_be_made_is_an_oserror(tmp_path):
    (tmp_path / "occupied").write_text("")
    with pytest.raises(OSError):
        write_atomically(tmp_path / "occupied" / "file", b"x")


def test_jobs_run_in_order_and_failures_are_counted_and_reported(background):
    done = []

    def fail():
        raise OSError(28, "No space left on device")

    background.submit("a", lambda: done.append(1))
    background.submit("b", fail)
    background.submit("a", lambda: done.append(2))
    assert background.flush(5)
    assert done == [1, 2]
    assert background.counters == {"a_done": 2, "b_failed": 1}
    assert "No space" in background.failures["b"]
    background.submit("b", lambda: None)
    assert background.flush(5)
    assert background.failures == {}


def hang(worker, release):
    begun = threading.Event()
    worker.submit("hang", lambda: (begun.set(), release.wait()))
    assert begun.wait(5)


def test_a_disk_that_hangs_costs_the_caller_nothing_and_is_bounded():
    worker, release = Background(), threading.Event()
    hang(worker, release)
    begin = time.monotonic()
    accepted = sum(worker.submit("log", lambda: None) for _ in range(1000))
    assert time.monotonic() - begin < 0.5
    assert accepted == 256
    assert worker.counters["log_refused"] == 1000 - 256
    assert worker.close(0.05) is False
    release.set()


def test_only_the_newest_of_a_kind_waits():
    worker, release, done = Background(), threading.Event(), []
    hang(worker, release)
    for n in range(100):
        worker.submit("state", lambda n=n: done.append(n), newest_only=True)
    release.set()
    assert worker.close(5)
    assert done == [99]


def test_a_recording_reads_back_as_the_same_frames(tmp_path, background):
    kinds = FrameBlock.from_frames(
        [
            (1_700_000_000_000_001, 0x18FEF100 | EXTENDED, bytes(range(8))),
            (1_700_000_000_000_002, 0x123, b"\x01"),
            (1_700_000_000_000_003, 0x18FEF100 | EXTENDED, b""),
            (1_700_000_000_000_004, 0x20000004 | ERROR, bytes(8)),
            (1_700_000_000_000_005, 0x123 | REMOTE, b""),
        ]
    )
    log = TextLog(tmp_path / "rec.log", candump_renderer("can0"), background, kind="record")
    log.add(kinds, 0.0)
    log.add(frames(50), 0.5)
    log.close()
    assert background.flush(5)
    read = FrameBlock.concatenate(list(open_log(tmp_path / "rec.log")))
    assert same(read, FrameBlock.concatenate([kinds, frames(50)]))


def test_two_daemons_do_not_mix_their_rows_in_one_file(tmp_path, background):
    """Two clocks in one recording are no drive. The second says so, and writes once the first is gone."""
    first, second = (
        TextLog(tmp_path / "rec.log", candump_renderer("can0"), background, kind=kind)
        for kind in ("record", "estimates")
    )
    first.add(frames(50), 0.0)
    second.add(frames(50, seed=2), 0.0)
    assert background.flush(5)
    assert "another process writes this file" in background.failures["estimates"]
    first.close()
    second.add(frames(50, seed=3), 2.0)
    second.close()
    assert background.flush(5)
    read = FrameBlock.concatenate(list(open_log(tmp_path / "rec.log")))
    assert same(read, FrameBlock.concatenate([frames(50), frames(50, seed=3)]))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_failed_write_reports_its_own_reason_and_the_file(background):
    log = TextLog(Path("/dev/full"), candump_renderer("can0"), background, kind="record")
    log.add(frames(10), 0.0)
    assert background.flush(5)
    assert background.failures["record"] == "[Errno 28] No space left on device: '/dev/full'"
    log.close()
    assert background.flush(5)


def test_a_full_disk_leaves_whole_lines_and_recording_goes_on_later(tmp_path, background, monkeypatch):
    class Disk(FileIO):
        full = False

        def write(self, text):
            return super().write(text[: len(text) // 2] if Disk.full else text)

    monkeypatch.setattr("canest.live.record.FileIO", Disk)
    log = TextLog(tmp_path / "rec.log", candump_renderer("can0"), background, kind="record")
    log.add(frames(10), 0.0)
    assert background.flush(5)
    Disk.full = True
    log.add(frames(10, seed=2), 2.0)
    assert background.flush(5)
    assert background.counters["record_failed"] == 1 and "space" in background.failures["record"]
    assert background.failures["record"].endswith(f"'{tmp_path}/rec.log'")
    Disk.full = False
    log.add(frames(10, seed=3), 4.0)
    log.close()
    assert background.flush(5)
    reader = open_log(tmp_path / "rec.log")
    read = FrameBlock.concatenate(list(reader))
    assert reader.skipped_lines == 0
    assert same(read, FrameBlock.concatenate([frames(10), frames(10, seed=3)]))


def estimates(t_us):
    one = np.ones(1)
    return Estimates(np.array([t_us]), 20_000 * one, 100 * one, 0.01 * one, 0.001 * one,
                     np.array([2], np.uint8), np.array([0], np.uint8))  # fmt: skip


def test_estimates_that_are_truncated_while_written_begin_with_a_header_again(tmp_path, background):
    """As logrotate does with copytruncate."""
    path = tmp_path / "est.csv"
    log = TextLog(path, render_estimates, background, kind="estimates", header=HEADER)
    for t_us in (20_000, 40_000, 60_000):
        log.add(estimates(t_us), 1e-6 * t_us * 1000.0)
        assert background.flush(5)
        if t_us == 20_000:
            os.truncate(path, 0)
    log.close()
    assert background.flush(5)
    lines = path.read_text().splitlines()
    assert lines[0] == "t_s,mass_kg,mass_std_kg,grade,grade_std,status,gate"
    assert [line.split(",")[0] for line in lines[1:]] == ["0.040", "0.060"]


def test_estimates_are_logged_as_est_csv_with_one_header_over_restarts(tmp_path, background):
    for t_us in (20_000, 40_000):
        log = TextLog(tmp_path / "est.csv", render_estimates, background, kind="estimates", header=HEADER)
        log.add(estimates(t_us), 0.0)
        log.close()
        assert background.flush(5)
    lines = (tmp_path / "est.csv").read_text().splitlines()
    assert lines[0] == "t_s,mass_kg,mass_std_kg,grade,grade_std,status,gate"
    assert len(lines) == 3 and lines[1].endswith("valid,")


def test_the_ring_never_outgrows_its_bound_and_keeps_the_newest(tmp_path, background):
    clock = [1_700_000_000.0]
    ring = Ring(tmp_path, "can0", 400_000, background, lambda: clock[0])
    newest = None
    for k in range(300):
        newest = frames(200, begin_us=1_700_000_000_000_000 + k * 1_000_000, seed=k)
        ring.add(newest, 2.0 * k)
        clock[0] += 20
        assert background.flush(5)
    ring.close()
    assert background.flush(5)
    assert background.counters["ring_failed"] == 0
    segments = sorted(tmp_path.iterdir())
    assert sum(p.stat().st_size for p in segments) <= 400_000
    assert len(segments) > 10
    last = FrameBlock.concatenate(list(open_log(segments[-1])))
    assert same(last[-200:], newest)


def test_segments_of_a_time_yet_to_come_go_first(tmp_path, background):
    clock = [2_100_000_000.0]  # until the clock is set right
    ring = Ring(tmp_path, "can0", 100_000, background, lambda: clock[0])
    for k in range(100):
        clock[0] = clock[0] + 20 if k != 40 else 1_790_000_000.0
        ring.add(frames(200, seed=k), 2.0 * k)
        assert background.flush(5)
    ring.close()
    assert background.flush(5)
    segments = sorted(p.name for p in tmp_path.iterdir())
    assert len(segments) > 10 and {name[:4] for name in segments} == {"2026"}


def test_a_segment_cut_off_by_a_crash_gives_what_it_holds(tmp_path, background):
    ring = Ring(tmp_path, "can0", 10_000_000, background)
    ring.add(frames(100), 0.0)
    assert background.flush(5)
    [segment] = tmp_path.iterdir()  # the segment is still open: this is what a crash would leave
    with pytest.raises(EOFError):
        gzip.decompress(segment.read_bytes())
    assert same(FrameBlock.concatenate(list(open_log(segment))), frames(100))
    ring.close()


def test_other_files_in_the_rings_folder_are_left_alone(tmp_path, background):
    (tmp_path / "notes.txt").write_text("x" * 1000)
    clock = [1_700_000_000.0]
    ring = Ring(tmp_path, "can0", 20_000, background, lambda: clock[0])
    for k in range(60):
        ring.add(frames(50, seed=k), 2.0 * k)
        clock[0] += 1000
    ring.close()
    assert background.flush(5)
    assert (tmp_path / "notes.txt").exists()


def test_a_full_disk_is_one_failure_though_every_segment_has_another_name(tmp_path, background, monkeypatch):
    clock, failures = [1_700_000_000.0], set()
    ring = Ring(tmp_path, "can0", 10_000_000, background, lambda: clock[0])

    class FullFile(gzip.GzipFile):
        def write(self, data):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("canest.live.record.gzip.open", FullFile)
    for _ in range(3):
        clock[0] += 1.0
        ring.add(frames(10), clock[0])
        ring.flush()
        assert background.flush(5)
        failures.add(background.failures["ring"])
    assert failures == {f"[Errno 28] No space left on device: '{tmp_path}'"}


def test_a_full_disk_leaves_no_empty_segments(tmp_path, background, monkeypatch):
    clock = [1_700_000_000.0]
    ring = Ring(tmp_path, "can0", 10_000_000, background, lambda: clock[0])

    class FullFile(gzip.GzipFile):
        def write(self, data):
            raise OSError(28, "No space left on device")

    whole = gzip.open
    monkeypatch.setattr("canest.live.record.gzip.open", FullFile)
    for failed in range(1, 6):
        clock[0] += 1.0
        ring.add(frames(1), clock[0])
        assert background.flush(5)
        assert background.counters["ring_failed"] == failed
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr("canest.live.record.gzip.open", whole)
    ring.add(frames(1), clock[0] + 1.0)
    ring.close()
    assert background.flush(5)
    (segment,) = tmp_path.iterdir()
    assert gzip.decompress(segment.read_bytes()) == candump_renderer("can0")([frames(1)])


@pytest.mark.parametrize("kind", ["FIFO", "directory"])
def test_a_recording_into_what_is_no_file_fails_and_the_other_files_are_written(tmp_path, background, kind):
    path = tmp_path / "rec.log"
    if kind == "FIFO":
        os.mkfifo(path)
    else:
        path.mkdir()
    log = TextLog(path, candump_renderer("can0"), background, kind="record")
    log.add(frames(10), 0.0)
    background.submit("metrics", lambda: write_atomically(tmp_path / "canest.prom", b"x"))
    assert background.flush(5)
    assert str(path) in background.failures["record"]
    assert background.counters["metrics_done"] == 1
