from __future__ import annotations

import bz2
import gzip
import lzma

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core.errors import LogError
from canest.core.frames import FrameBlock
from canest.logs import open_log
from canest.logs.compression import Source
from tests.logs.helpers_logs import DATA, assert_same, one_by_one, read_all

TEXT = lzma.decompress((DATA / "kenworth" / "normal.log.xz").read_bytes())
PACK = {
    ".gz": gzip.compress,
    ".xz": lzma.compress,
    ".zst": zstandard.ZstdCompressor().compress,
    ".bz2": bz2.compress,
}


@pytest.mark.parametrize("suffix", PACK)
@pytest.mark.parametrize("name", ["drive.log{}", "drive{}", "renamed.bin"])
def test_archives_are_known_by_their_content(tmp_path, suffix, name):
    path = tmp_path / name.format(suffix)
    path.write_bytes(PACK[suffix](TEXT))
    block, reader = read_all(path)
    assert_same(block, one_by_one(TEXT)[0])
    assert not reader.truncated


@pytest.mark.parametrize("suffix", PACK)
def test_a_truncated_archive_gives_what_it_holds_and_a_reason(tmp_path, suffix):
    packed = PACK[suffix](TEXT)
    path = tmp_path / f"cut.log{suffix}"
    path.write_bytes(packed[: len(packed) * 3 // 4])
    block, reader = read_all(path)
    expected, _ = one_by_one(TEXT)
    assert 5000 < len(block) < len(expected)
    assert_same(block, expected[: len(block)])
    assert reader.truncated and "ends early" in reader.truncated_reason
    assert reader.skipped_lines <= 1  # the line at the cut


@pytest.mark.parametrize("suffix", PACK)
def test_several_archives_behind_each_other_are_one_log(tmp_path, suffix):
    path = tmp_path / f"two.log{suffix}"
    path.write_bytes(PACK[suffix](TEXT) + PACK[suffix](TEXT))
    block, reader = read_all(path)
    assert len(block) == 2 * 19_957
    assert not reader.truncated


@pytest.mark.parametrize("suffix", PACK)
@given(position=st.floats(0, 0.999), value=st.integers(0, 255))
@settings(max_examples=15, deadline=None)
def test_a_damaged_archive_never_escapes(tmp_path_factory, suffix, position, value):
    packed = bytearray(PACK[suffix](TEXT[:100_000]))
    packed[int(position * len(packed))] = value
    path = tmp_path_factory.mktemp("damaged") / f"x.log{suffix}"
    path.write_bytes(packed)
    try:
        reader = open_log(path)
        FrameBlock.concatenate(list(reader))
    except LogError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("suffix", PACK)
def test_an_archive_that_unpacks_to_very_much_comes_in_pieces(tmp_path, suffix):
    size = 128 << 20
    path = tmp_path / f"zeros.log{suffix}"
    path.write_bytes(PACK[suffix](bytes(size)) + PACK[suffix](TEXT))
    with Source(path) as source:
        pieces = list(iter(lambda: source.read(1 << 19), b""))
        assert not source.damage
    assert max(map(len, pieces)) < size // 3
    assert b"".join(pieces) == bytes(size) + TEXT
