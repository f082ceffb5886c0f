"""A log in which nothing can be read is an error; one that never had a frame is empty."""

from __future__ import annotations

import gzip
import lzma

import pytest

from canest.core.errors import LogError
from canest.logs import open_log

LINES = b"".join(b"(1700000000.%06d) can0 0CF00400#0000000000000000\n" % k for k in range(0, 900_000, 20_000))


@pytest.mark.parametrize(
    ("name", "content", "found"),
    [
        ("cut.log.gz", gzip.compress(LINES, mtime=0)[:20], "ends early"),
        ("rotten.log.xz", lzma.compress(LINES)[:24] + b"\xff" * 400, "damaged"),
        ("never-written.log", bytes(4096), "zeros alone"),
        ("never-written.log.gz", gzip.compress(bytes(4096), mtime=0), "zeros alone"),
    ],
)
def test_a_log_without_a_frame_that_is_damaged_cannot_be_read(tmp_path, name, content, found):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(LogError, match=found):
        list(open_log(path))


@pytest.mark.parametrize(
    ("name", "content"), [("a.log", b""), ("b.log", b"\n"), ("c.log.gz", gzip.compress(b"", mtime=0))]
)
def test_a_log_that_never_had_a_frame_is_empty(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with open_log(path) as reader:
        assert not list(reader)
    assert not reader.frames
    assert not reader.truncated


def test_what_zeros_leave_is_read(tmp_path):
    path = tmp_path / "half.log"
    path.write_bytes(LINES + bytes(4096))
    with open_log(path) as reader:
        assert sum(len(block) for block in reader) == LINES.count(b"\n")
