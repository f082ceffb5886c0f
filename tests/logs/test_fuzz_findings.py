"""What the fuzzer (`benchmarks/fuzz.py`) found, kept as examples."""

from __future__ import annotations

import pytest

from canest.core.errors import LogError
from canest.logs.format_detection import open_log


def test_a_table_of_one_line_with_a_stray_carriage_return(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_bytes(b"t_s,v\rx,y")
    blocks = list(open_log(path))
    assert sum(len(block.t_us) for block in blocks) == 0


def test_a_header_longer_than_any_csv_cell_may_be(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_bytes(b"t_s," + b"v" * 200_000 + b"\n0,1\n")
    with pytest.raises(LogError, match="header"):
        list(open_log(path))
