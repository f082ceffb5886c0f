from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from canest.core.errors import LogError
from canest.logs import open_log


def test_empty_log_yields_nothing_and_is_no_error(tmp_path):
    path = tmp_path / "empty.log"
    path.touch()
    reader = open_log(path)
    assert list(reader) == []
    assert (reader.frames, reader.skipped_lines, reader.truncated) == (0, 0, False)


def test_missing_file_is_one_line(tmp_path):
    with pytest.raises(LogError, match=r"none\.log: cannot open: No such file"):
        open_log(tmp_path / "none.log")


def test_directory_is_one_line(tmp_path):
    with pytest.raises(LogError, match="Is a directory"):
        open_log(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_forbidden_file_is_one_line(tmp_path):
    path = tmp_path / "secret.log"
    path.write_text("(1.000000) can0 123#11\n")
    path.chmod(0)
    with pytest.raises(LogError, match="Permission denied"):
        open_log(path)


@pytest.mark.parametrize(
    "name", ["noise.bin", "noise.blf", "noise.csv", "noise.log", "noise.asc", "noise.xz"]
)
@pytest.mark.parametrize(
    "magic", [b"", b"LOGG", b"MDF     ", b"PAR1", b"SQLite format 3\0", b"\x1f\x8b", b"BZh9"]
)
def test_binary_garbage_is_one_line(tmp_path, name, magic):
    path = tmp_path / name
    path.write_bytes(magic + random.Random(7).randbytes(30_000))
    with pytest.raises(LogError) as caught:
        reader = open_log(path)
        list(reader)
        assert reader.truncated, "garbage that is no error must at least be called damaged"
        raise LogError("damaged", where=str(path))
    assert "\n" not in str(caught.value) and name in str(caught.value)


def test_content_counts_more_than_the_name(tmp_path: Path):
    path = tmp_path / "drive.csv"
    path.write_text("(1.000000) can0 123#11\n")
    with open_log(path) as reader:
        assert reader.format == "candump"


@pytest.mark.parametrize(
    ("name", "words"), [("a.log", "not a candump line"), ("a.foo", "no log that canest knows")]
)
def test_bytes_that_are_no_text_are_no_table_although_they_hold_commas(tmp_path, name, words):
    path = tmp_path / name
    path.write_bytes(bytes([7, 44, 200, 59, 44, 3, 31, 250, 10]) * 100)
    with pytest.raises(LogError, match=words):
        list(open_log(path))
