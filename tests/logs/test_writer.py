from __future__ import annotations

import csv
import importlib.util
import itertools
import lzma
import os
import socket
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core import jit
from canest.core.errors import OutputError
from canest.core.estimates import Estimates
from canest.core.frames import EXTENDED, FrameBlock
from canest.core.gates import LABELS
from canest.logs import text_fields
from canest.logs.candump import CandumpParser
from canest.logs.candump_writer import CandumpWriter, candump_text
from canest.logs.estimate_writer import estimates_csv, open_writer
from tests.logs.helpers_logs import DATA, FRAMES, LONG_FRAMES, assert_same, log_form

MCAP = ["est.mcap"] if importlib.util.find_spec("mcap") else []
STATUS = ["unestimated", "converging", "valid"]


def estimates(rows: int, seed: int = 0) -> Estimates:
    rng = np.random.default_rng(seed)
    result = Estimates(
        1_700_000_000_020_000 + 20_000 * np.arange(rows),
        rng.uniform(7000, 44_000, rows),
        rng.uniform(0, 9000, rows),
        rng.normal(0, 0.05, rows),
        rng.uniform(0, 0.1, rows),
        rng.integers(0, 3, rows).astype(np.uint8),
        rng.integers(0, 14, rows).astype(np.uint8),
    )
    result.mass_kg[: rows // 10] = np.nan
    result.grade_std[: rows // 20] = np.nan
    return result


def oracle(e: Estimates, row: int) -> list[str]:
    """The line as Python's own formatting writes it."""

    def text(value: float, decimals: int) -> str:
        return "" if np.isnan(value) else f"{value:.{decimals}f}"

    return [
        f"{e.t_us[row] // 10**6}.{e.t_us[row] % 10**6 // 1000:03d}",
        text(e.mass_kg[row], 1),
        text(e.mass_std_kg[row], 1),
        text(e.grade[row], 6),
        text(e.grade_std[row], 6),
        STATUS[e.status[row]],
        LABELS[int(e.gate[row])],
    ]


@pytest.fixture(params=["numpy", "compiled"])
def form(request):
    """Both ways to the same text, which each test below compares with Python's own."""
    if request.param == "compiled" and not jit.available():
        pytest.skip("numba is not installed (extra: fast)")
    jit.enable(request.param == "compiled")
    yield
    jit.enable(False)


@pytest.mark.usefixtures("form")
def test_csv_equals_plain_formatting(tmp_path):
    e = estimates(20_000)
    with open_writer(tmp_path / "est.csv") as writer:
        writer.write(e)
    rows = list(csv.reader((tmp_path / "est.csv").read_text().splitlines()))
    assert ",".join(rows[0]) == "t_s,mass_kg,mass_std_kg,grade,grade_std,status,gate"
    assert [rows[1 + i] for i in range(len(e))] == [oracle(e, i) for i in range(len(e))]


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize(
    ("t_us", "text"),
    [
        (0, "0.000"),
        (20_000, "0.020"),
        (1, "0.000001"),
        (999_999, "0.999999"),
        (1_700_000_000_000_100, "1700000000.000100"),
        (-20_000, "-0.020"),
        (9_999_999_999_999_999, "9999999999.999999"),
    ],
)
def test_stamps_are_exact(tmp_path, t_us, text):
    e = estimates(1)
    e.t_us[0] = t_us
    with open_writer(tmp_path / "est.csv") as writer:
        writer.write(e)
    assert (tmp_path / "est.csv").read_text().splitlines()[1].split(",")[0] == text


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0.000000"),
        (-1e-9, "0.000000"),
        (-0.03, "-0.030000"),
        (12.5, "12.500000"),
        (np.inf, ""),
        (1e300, ""),
    ],
)
def test_numbers_at_the_edges(tmp_path, value, text):
    e = estimates(3)
    e.grade[1] = value
    with open_writer(tmp_path / "est.csv") as writer:
        writer.write(e)
    assert (tmp_path / "est.csv").read_text().splitlines()[2].split(",")[3] == text


@given(
    values=st.lists(st.floats(width=64) | st.floats(-1e4, 1e4), min_size=1, max_size=20),
    first_us=st.integers(-(10**15), 10**16),
    step_us=st.integers(0, 10**6),
    decimals=st.integers(0, 7),
)
@settings(max_examples=100, deadline=None)
def test_compiled_writes_what_numpy_writes(values, first_us, step_us, decimals):
    if not jit.available():
        pytest.skip("numba is not installed (extra: fast)")
    n, column = len(values), np.array(values)
    codes = (np.arange(n) * 37 % 256).astype(np.uint8)  # a code without a name is an empty field
    e = Estimates(first_us + step_us * np.arange(n), column, -column, column / 7, column[::-1], codes, codes)
    texts = []
    for compiled in (False, True):
        jit.enable(compiled)
        texts.append(estimates_csv(e, slice(None), [(column, decimals), (-column, 3)]))
        jit.enable(False)
    assert texts[0] == texts[1]


@pytest.mark.parametrize("name", ["est.csv", "est.parquet", *MCAP])
@given(cuts=st.lists(st.integers(0, 300), max_size=5))
@settings(max_examples=15, deadline=None)
def test_however_the_rows_are_cut_the_file_is_the_same(tmp_path_factory, name, cuts):
    e = estimates(300)
    folder = tmp_path_factory.mktemp("cut")
    bounds = [0, *sorted(cuts), 300]
    with open_writer(folder / name) as writer:
        for first, last in itertools.pairwise(bounds):
            writer.write(Estimates(*(getattr(e, n)[first:last] for n in Estimates.__slots__)))
    with open_writer(folder / ("whole_" + name)) as writer:
        writer.write(e)
    if name.endswith((".csv", ".mcap")):
        assert (folder / name).read_bytes() == (folder / ("whole_" + name)).read_bytes()
    else:
        assert pq.read_table(folder / name).equals(pq.read_table(folder / ("whole_" + name)))


def test_parquet_has_the_same_columns(tmp_path):
    e = estimates(1000)
    with open_writer(tmp_path / "est.parquet") as writer:
        writer.write(e)
    table = pq.read_table(tmp_path / "est.parquet").to_pydict()
    assert list(table) == ["t_s", "mass_kg", "mass_std_kg", "grade", "grade_std", "status", "gate"]
    assert table["mass_kg"][:100] == [None] * 100
    assert table["mass_kg"][100:] == e.mass_kg[100:].tolist()
    assert table["gate"] == [LABELS[int(code)] for code in e.gate]
    np.testing.assert_array_equal(np.rint(np.array(table["t_s"]) * 1e6), e.t_us)


@pytest.mark.skipif(importlib.util.find_spec("mcap") is None, reason="mcap (extra: mcap)")
def test_an_mcap_holds_no_time_before_1970(tmp_path):
    e = estimates(3)
    e.t_us[:] = [-20_000, 0, 20_000]
    with (
        pytest.raises(OutputError, match=r"est\.mcap: MCAP holds no time before 1970, found '-0\.02 s'"),
        open_writer(tmp_path / "est.mcap") as writer,
    ):
        writer.write(e)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(importlib.util.find_spec("mcap") is None, reason="mcap (extra: mcap)")
def test_what_rounds_to_zero_has_no_sign(tmp_path):
    """A level road is level, whichever side of it the estimate is."""
    from mcap.reader import make_reader

    almost = estimates(20)
    almost.grade[:] = -1e-9
    texts = []
    for name in ("est.csv", "est.mcap"):
        with open_writer(tmp_path / name) as writer:
            writer.write(almost)
    with (tmp_path / "est.mcap").open("rb") as file:
        texts += [message.data.decode() for _, _, message in make_reader(file).iter_messages()]
    assert len(texts) == 20 and all('"grade":0.0,' in text for text in texts)
    table = (tmp_path / "est.csv").read_text()
    assert ",0.000000," in table and "-0.0" not in table


@pytest.mark.skipif(importlib.util.find_spec("mcap") is None, reason="mcap (extra: mcap)")
def test_an_mcap_without_rows_can_be_read(tmp_path):
    from mcap.reader import make_reader

    with open_writer(tmp_path / "est.mcap"):
        pass
    with (tmp_path / "est.mcap").open("rb") as file:
        assert list(make_reader(file).iter_messages()) == []


def test_nothing_stands_under_the_name_before_it_is_complete(tmp_path):
    path = tmp_path / "est.csv"
    path.write_text("of yesterday")
    with open_writer(path) as writer:
        writer.write(estimates(10))
        assert path.read_text() == "of yesterday"
    assert path.read_text().startswith("t_s,")
    assert [p.name for p in tmp_path.iterdir()] == ["est.csv"]


@pytest.mark.parametrize("name", ["est.csv", "est.parquet", *MCAP])
def test_an_exception_leaves_no_file(tmp_path, name):
    with pytest.raises(KeyboardInterrupt), open_writer(tmp_path / name) as writer:
        writer.write(estimates(10))
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["est.csv", "est.parquet", *MCAP])
def test_a_folder_that_is_not_there_is_one_line(tmp_path, name):
    with pytest.raises(OutputError, match=rf"{name}: cannot write: No such file"):
        open_writer(tmp_path / "none" / name)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_one_line():
    with pytest.raises(OutputError, match="No space left"), open_writer("/dev/full") as writer:
        writer.write(estimates(10_000))


@given(FRAMES)
@settings(max_examples=60, deadline=None)
def test_frames_written_as_candump_are_the_definition_and_read_back(frames):
    block = FrameBlock.from_frames(frames)
    text = candump_text(block)
    assert text.decode() == "".join(log_form(*frame) + "\n" for frame in frames)
    assert_same(CandumpParser().parse(text), block)


def test_a_real_log_is_written_back_byte_for_byte(tmp_path):
    text = lzma.decompress((DATA / "ip332" / "bike.log.xz").read_bytes())
    channel = text.split(b" ", 2)[1].decode()
    with CandumpWriter(tmp_path / "back.log", channel) as writer:
        writer.write(CandumpParser().parse(text))
    assert (tmp_path / "back.log").read_bytes() == text


@given(LONG_FRAMES)
@settings(max_examples=30, deadline=None)
def test_of_a_long_can_fd_frame_its_length_and_what_is_known_are_written(frames):
    block = FrameBlock.from_frames(frames)
    parser = CandumpParser()
    assert_same(parser.parse(candump_text(block) * 3), FrameBlock.concatenate([block] * 3))
    assert not parser.skipped


def test_no_byte_of_a_long_can_fd_frame_is_made_up():
    frames = [(1_000_000, 0x18FEEE31 | EXTENDED, bytes(range(1, 13))), (2_000_000, 0x123, b"\x11")]
    assert candump_text(FrameBlock.from_frames(frames)).decode().splitlines() == [
        "(0000000001.000000)  can0  18FEEE31  [12]  01 02 03 04 05 06 07 08",
        "(0000000002.000000) can0 123#11",
    ]


def test_remote_frames_survive(tmp_path):
    parser = CandumpParser()
    text = b"(0000000001.000000) can0 18FEEE31#R8\n(0000000001.000000) can0 123#R0\n"
    assert candump_text(parser.parse(text)) == text


@pytest.mark.parametrize("name", ["est.csv", "est.parquet", *MCAP])
def test_of_two_writers_of_one_name_the_later_fails_and_the_file_is_whole(tmp_path, name):
    path = tmp_path / name
    path.write_text("of yesterday")
    message = f"{name}: cannot write: was written by another process meanwhile"
    with pytest.raises(OutputError, match=message), open_writer(path) as late:
        late.write(estimates(50, seed=1))
        with open_writer(path) as early:
            early.write(estimates(100, seed=2))
        written = path.read_bytes()
        late.write(estimates(5000, seed=1))
    assert path.read_bytes() == written
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_was_removed_meanwhile_may_be_written(tmp_path):
    path = tmp_path / "est.csv"
    path.write_text("of yesterday")
    with open_writer(path) as writer:
        path.unlink()
        writer.write(estimates(10))
    assert path.read_text().startswith("t_s,")


def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path):
    victim, link = tmp_path / "victim", tmp_path / "est.csv"
    victim.write_text("precious")
    link.symlink_to(victim)
    with open_writer(link) as writer:
        writer.write(estimates(10))
    assert victim.read_text() == "precious" and not link.is_symlink()


def test_names_that_temporaries_once_had_are_nobodys(tmp_path):
    for name in ("est.csv.part", ".est.csv.tmp"):
        (tmp_path / name).write_text("precious")
    with open_writer(tmp_path / "est.csv") as writer:
        writer.write(estimates(10))
    assert {p.name: p.read_text()[:8] for p in tmp_path.iterdir() if p.name != "est.csv"} == {
        "est.csv.part": "precious", ".est.csv.tmp": "precious",
    }  # fmt: skip


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_result_has_the_permissions_of_the_umask_once_it_is_complete(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        with open_writer(tmp_path / "est.csv") as writer:
            (growing,) = tmp_path.iterdir()
            assert stat.S_IMODE(growing.stat().st_mode) == 0o600
            writer.write(estimates(10))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "est.csv").stat().st_mode) == mode


def test_the_longest_name_of_a_file_is_written(tmp_path):
    path = tmp_path / ("ä" * 125 + ".csv")
    with open_writer(path) as writer:
        writer.write(estimates(10))
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("kind", ["directory", "socket"])
def test_what_is_no_file_is_refused_in_one_line(tmp_path, kind):
    path = tmp_path / "est.csv"
    with socket.socket(socket.AF_UNIX) as server:
        if kind == "directory":
            path.mkdir()
        else:
            server.bind(str(path))
        with pytest.raises(OutputError, match=r"est\.csv: cannot write: "):
            open_writer(path)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("redirection", [">", ">>", "| cat >"])
def test_standard_output_is_written_as_it_stands(tmp_path, redirection):
    code = (
        "from canest.logs.candump_writer import CandumpWriter; from canest.core.frames import FrameBlock\n"
        "with CandumpWriter('/dev/stdout') as out: out.write(FrameBlock.from_frames([(0, 1, b'')]))"
    )
    path, link = tmp_path / "out", Path("/dev/stdout").readlink()
    path.write_text("first\n")
    subprocess.run(["sh", "-c", f'"$0" -c "$1" {redirection} "$2"', sys.executable, code, path], check=True)
    kept = "first\n" if redirection == ">>" else ""
    assert path.read_text() == kept + "(0000000000.000000) can0 001#\n"
    assert Path("/dev/stdout").readlink() == link


def test_a_number_that_no_column_holds_is_left_out():
    large, one = text_fields.fixed(np.array([1.7e308, 1.0]), 6)
    blank = np.frombuffer(text_fields.integer(np.array([1, 10])).tobytes(), np.uint8)[0]
    assert set(large.tolist()) == {int(blank)}
    assert one.tobytes() == b"1.000000"
