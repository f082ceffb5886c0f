from __future__ import annotations

import gzip
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core.errors import LogError
from canest.logs import LogReader, TableBlock, open_log
from canest.logs.line_splitting import LINE_CHARS_MAX
from canest.logs.log_warnings import log_warnings
from canest.logs.truth import read_truth


def read(path: Path, **options) -> tuple[TableBlock, LogReader]:
    reader = open_log(path, **options)
    blocks = list(reader)
    assert reader.kind == "table"
    columns = {name: np.concatenate([b.columns[name] for b in blocks]) for name in blocks[0].columns}
    return TableBlock(np.concatenate([b.t_us for b in blocks]), columns), reader


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_csv_columns_come_as_numbers_with_exact_stamps(tmp_path):
    path = write(tmp_path / "a.csv", "t_s,v_kmh,name\n1700000000.020,1.5,7\n1700000000.040,-2e3,8\n")
    block, reader = read(path)
    assert block.t_us.tolist() == [1_700_000_000_020_000, 1_700_000_000_040_000]
    assert block.columns["v_kmh"].tolist() == [1.5, -2000.0]
    assert (reader.frames, reader.skipped_lines, reader.bad_cells) == (2, 0, {})


def test_text_in_a_cell_is_reported_with_the_first_row_that_has_it(tmp_path):
    path = write(tmp_path / "a.csv", "t_s,v,w\n0.1,,1\n0.2,nan,2\n0.3,abc,3\n0.4,n/a,4\n0.5,5,5\n")
    block, reader = read(path)
    assert np.isnan(block.columns["v"]).tolist() == [True] * 4 + [False]
    assert (reader.bad_cells, reader.text_cells) == ({"v": 4}, {"v": (2, 4, "abc")})
    expected = "column v: 2 cells hold text and count as not available, first in row 4: 'abc'"
    assert log_warnings(reader) == [expected]
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t_s": [0.1, 0.2, 0.3], "v": ["1.5", "abc", None]}), path)
    block, reader = read(path)
    assert block.columns["v"][0] == 1.5
    assert reader.text_cells == {"v": (1, 2, "abc")}


def test_truth_values_are_0_and_1_in_csv_as_they_are_in_parquet(tmp_path):
    block, reader = read(write(tmp_path / "a.csv", "t_s,brake\n0.1,False\n0.2,True\n0.3,true\n0.4,off\n"))
    np.testing.assert_array_equal(block.columns["brake"], [0.0, 1.0, 1.0, np.nan])
    assert reader.text_cells == {"brake": (1, 5, "off")}
    pq.write_table(pa.table({"t_s": [0.1, 0.2], "brake": [False, True]}), tmp_path / "a.parquet")
    assert read(tmp_path / "a.parquet")[0].columns["brake"].tolist() == [0.0, 1.0]


def test_a_time_that_is_none_is_shown(tmp_path):
    path = write(tmp_path / "a.csv", "t_s,v\ns,m/s\n0.1,1\n01.02.2024 00:00:00,2\n")
    expected = ["t_s = s", "t_s = 01.02.2024 00:00:00"]
    assert [text for _, text, _ in read(path)[1].skipped] == expected
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t_s": ["s", "0.1", "01.02.2024 00:00:00"], "v": [0.0, 1.0, 2.0]}), path)
    assert [text for _, text, _ in read(path)[1].skipped] == expected


@pytest.mark.parametrize(
    "stamp",
    ["2024-01-01T00:00:00.020Z", "2024-01-01 00:00:00.020", "2023-12-31T19:00:00.020-05:00"],
)
def test_a_date_and_a_time_are_seconds_since_1970(tmp_path, stamp):
    path = write(tmp_path / "a.csv", f"time,v\n{stamp},1\n{stamp.replace('.020', '.040')},2\n")
    block, reader = read(path, time_column="time")
    assert block.t_us.tolist() == [1_704_067_200_020_000, 1_704_067_200_040_000]
    assert (block.columns["v"].tolist(), reader.skipped_lines) == ([1.0, 2.0], 0)
    pq.write_table(pa.table({"time": [stamp], "v": [1.0]}), tmp_path / "a.parquet")
    assert read(tmp_path / "a.parquet", time_column="time")[0].t_us.tolist() == [1_704_067_200_020_000]


def test_durations_are_seconds_as_time_stamps_are(tmp_path):
    path = tmp_path / "a.parquet"
    times = pa.array([0, 20_000_000, 40_000_001], pa.duration("ns"))
    pq.write_table(pa.table({"t_s": times, "v": [1.0, 2.0, 3.0]}), path)
    assert read(path)[0].t_us.tolist() == [0, 20_000, 40_000]


def test_dates_are_seconds_whatever_the_year(tmp_path):
    path = tmp_path / "a.parquet"
    days = pa.array([1, None, 2**30], pa.int32()).cast(pa.date32())  # beyond Python's calendar
    pq.write_table(pa.table({"t_s": days, "v": pa.array([86_400_000, 0, 0]).cast(pa.date64())}), path)
    block, reader = read(path)
    assert block.t_us.tolist() == [86_400_000_000]
    assert block.columns["v"].tolist() == [86_400.0]
    assert reader.skipped_lines == 2


def test_a_line_that_does_not_end_is_counted_without_being_kept(tmp_path):
    path = tmp_path / "a.csv.gz"
    endless = b"7," * 20 * LINE_CHARS_MAX
    path.write_bytes(gzip.compress(b"t_s,v\n0.1,1\n" + endless + b"\n0.3,3\n" + endless, 1))
    tracemalloc.start()
    block, reader = read(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert block.columns["v"].tolist() == [1.0, 3.0]
    assert [number for number, _, _ in reader.skipped] == [3, 5]
    assert most < len(endless)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_table_has_no_interface_to_choose(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    if suffix == ".csv":
        write(path, "t_s,v\n0,1\n")
    else:
        pq.write_table(pa.table({"t_s": [0.0], "v": [1.0]}), path)
    with pytest.raises(LogError, match=r"has no interfaces, found '--channel can0', expected none"):
        open_log(path, channel="can0")


def test_cells_without_a_number_become_nan_and_are_counted(tmp_path):
    path = write(tmp_path / "a.csv", "t_s,v,w\n0.1,,1\n0.2,nan,2\n0.3,n/a,3\n0.4,inf,4\n0.5,5,5\n")
    block, reader = read(path)
    np.testing.assert_array_equal(block.columns["v"], [np.nan] * 4 + [5.0])
    assert block.columns["w"].tolist() == [1, 2, 3, 4, 5]
    assert reader.bad_cells == {"v": 4}


def test_rows_without_time_or_of_wrong_length_are_counted_with_their_line(tmp_path):
    path = write(tmp_path / "a.csv", "t_s,v\n0.1,1\n,2\n0.3\n0.4,4,4\nlater,5\n1e300,6\n0.7,7\n\n")
    block, reader = read(path)
    assert block.t_us.tolist() == [100_000, 700_000]
    assert sorted(number for number, _, _ in reader.skipped) == [3, 4, 5, 6, 7]


@pytest.mark.parametrize(
    "text",
    [
        "t_s;v\n0,1;1,5\n0,2;2,5\n",
        "t_s\tv\n0.1\t1.5\n0.2\t2.5\n",
        '"t_s","v"\n"0.1","1.5"\n"0.2","2.5"\n',
        "\ufefft_s,v\r\n0.1,1.5\r\n0.2,2.5\r\n",
        "\n t_s , v \n0.1, 1.5\n0.2, 2.5",
    ],
)
def test_the_dialects_of_csv(tmp_path, text):
    block, reader = read(write(tmp_path / "a.csv", text))
    assert block.t_us.tolist() == [100_000, 200_000]
    assert block.columns["v"].tolist() == [1.5, 2.5]
    assert reader.skipped_lines == 0 and reader.bad_cells == {}


def test_only_the_wanted_columns_and_another_time_column(tmp_path):
    path = write(tmp_path / "a.csv", "clock,v,comment\n1,10,hello\n2,20,world\n")
    block, reader = read(path, time_column="clock", columns=["v", "w"])
    assert list(block.columns) == ["v"]
    assert reader.bad_cells == {}


@pytest.mark.parametrize("block_frames", [1, 7, 1000])
def test_block_size_changes_nothing(tmp_path, block_frames):
    text = "t_s,v\n" + "".join(f"{i / 10},{i if i % 13 else ''}\n" for i in range(100))
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(text.encode()))
    block, reader = read(path, block_frames=block_frames)
    assert block.t_us.tolist() == [i * 100_000 for i in range(100)]
    assert reader.bad_cells == {"v": 8}


@given(st.binary(max_size=500))
@settings(max_examples=60, deadline=None)
def test_random_bytes_below_a_header_never_escape(tmp_path_factory, noise):
    path = tmp_path_factory.mktemp("noise") / "a.csv"
    path.write_bytes(b"t_s,v\n0.1,1\n" + noise)
    reader = open_log(path)
    assert sum(len(block) for block in reader) == reader.frames >= 1


def test_a_wanted_column_that_stands_twice_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t_s,v,v,w,w\n0,1,2,3,4\n")
    with pytest.raises(LogError, match=r"a\.csv: the table has columns of one name, found 'v'"):
        list(open_log(path, columns=["v"]))


def test_no_time_column_names_what_there_is(tmp_path):
    with pytest.raises(
        LogError,
        match=r"a\.csv: no log format that canest knows; .*no time column 't_s', found 'time, v'",
    ):
        list(open_log(write(tmp_path / "a.csv", "time,v\n1,2\n")))


@pytest.mark.parametrize("packed", [False, True])
def test_parquet_equals_csv(tmp_path, packed):
    table = pa.table(
        {
            "t_s": [0.1, 0.2, None],
            "v": [1.5, None, 3.0],
            "gear": pa.array([1, 2, 3], pa.int8()),
            "s": list("abc"),
        }
    )
    path = tmp_path / "a.parquet"
    pq.write_table(table, path)
    if packed:
        path.with_suffix(".parquet.gz").write_bytes(gzip.compress(path.read_bytes()))
        path = path.with_suffix(".parquet.gz")
    block, reader = read(path)
    assert block.t_us.tolist() == [100_000, 200_000]
    np.testing.assert_array_equal(block.columns["v"], [1.5, np.nan])
    assert block.columns["gear"].tolist() == [1.0, 2.0]
    assert reader.bad_cells == {"v": 1, "s": 2} and reader.skipped_lines == 1


def test_truncated_parquet_is_one_line(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t_s": np.arange(1000.0)}), path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(LogError, match="no readable parquet file"):
        list(open_log(path))


class TestTruth:
    def test_either_column_may_be_missing_and_others_are_ignored(self, tmp_path):
        truth = read_truth(write(tmp_path / "t.csv", "t_s,shift,grade\n0.0,1,0.01\n0.1,x,0.02\n"))
        assert truth.t_us.tolist() == [0, 100_000]
        assert truth.mass_kg is None
        assert truth.grade is not None and truth.grade.tolist() == [0.01, 0.02]

    def test_stamps_always_increase(self, tmp_path):
        truth = read_truth(write(tmp_path / "t.csv", "t_s,mass_kg\n0,1\n2,2\n1,3\n2,4\n3,5\n"))
        assert truth.t_us.tolist() == [0, 1_000_000, 2_000_000, 3_000_000]
        assert truth.mass_kg is not None and truth.mass_kg.tolist() == [1, 3, 2, 5]

    @pytest.mark.parametrize(
        ("text", "notes"),
        [
            ("t_s;grade\n0;0,02\n1;-0,3\n", []),
            ("t_s,grade,mass_kg\n0,,7000\n1,,7000\n", []),
            ("t_s,grade\n0,0.1\n1,0.1\n2,0,1\n", ["line 4 skipped: 3 cells where the header has 2: '2,0,1'"]),
            ("t_s,mass_kg\n0,7000\n1,7 000\n2,7000\n", ["column mass_kg: 1 cells hold text"]),
            ("t_s,grade\n0,0.1\n1,nan\n", ["one row alone has a number, at t_s 0.000"]),
            ("t_s,grade\n0,0.1\n1,-5\n", ["grade 5 is steeper than any road: another unit"]),
        ],
    )
    def test_what_can_hardly_be_meant_is_noted(self, tmp_path, text, notes):
        found = read_truth(write(tmp_path / "t.csv", text)).notes
        assert len(found) == len(notes)
        assert all(note.startswith(f"truth: {start}") for note, start in zip(found, notes, strict=True))

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("t_s,speed\n0,1\n", "neither grade nor mass_kg"),
            ("time,grade\n0,1\n", "no time column"),
            ("t_s,grade\n", "no truth"),
            ("t_s,mass_kg\n5,7000\n6,\n7,0\n8,-1\n", r": row 3 \(t_s 7\.000\): mass_kg: .*found '0', exp"),
            ("", "no truth"),
            ("t_s,grade\n5,nan\n6,x\n", "no row has a number in grade; .*first in row 3: 'x'"),
            ("(1.000000) can0 123#11\n", "no truth"),
        ],
    )
    def test_anything_else_is_one_line(self, tmp_path, text, message):
        with pytest.raises(LogError, match=rf"t\.csv.*{message}"):
            read_truth(write(tmp_path / "t.csv", text))
