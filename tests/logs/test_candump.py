from __future__ import annotations

import lzma
import random
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.core import jit
from canest.core.errors import LogError
from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.logs import open_log
from canest.logs.base import SKIPPED_SHOWN
from canest.logs.candump import CandumpParser
from canest.logs.log_warnings import log_warnings
from tests.logs.helpers_logs import DATA, FRAMES, assert_same, log_form, one_by_one, read_all, screen_form


def parse(text: str | bytes, **options: object) -> tuple[FrameBlock, CandumpParser]:
    parser = CandumpParser(**options)  # type: ignore[arg-type]
    return parser.parse(text.encode() if isinstance(text, str) else text), parser


@pytest.mark.parametrize("form", [log_form, screen_form])
@given(frames=FRAMES)
@settings(max_examples=60, deadline=None)
def test_any_frames_written_and_read_are_the_same(form, frames):
    text = "".join(form(*frame) + "\n" for frame in frames)
    block, parser = parse(text)
    assert_same(block, FrameBlock.from_frames(frames))
    assert (parser.skipped_lines, parser.frames, parser.lines) == (0, len(frames), len(frames))


@given(st.binary(max_size=2000), st.booleans())
@settings(max_examples=100, deadline=None)
def test_random_bytes_never_raise_and_every_line_is_accounted_for(noise, between_frames):
    good = log_form(1_700_000_000_000_102, 0x18FEEE31 | EXTENDED, bytes(8)).encode() + b"\n"
    text = (good * 30 + noise + b"\n" + good * 30) if between_frames else noise + b"\n"
    block, parser = parse(text)
    expected, skipped = one_by_one(text)
    assert_same(block, expected)
    assert parser.skipped_lines == skipped
    assert parser.frames + parser.skipped_lines + parser.ignored_lines == parser.lines == text.count(b"\n")


def damaged_log(rng: random.Random, damages: int) -> bytes:
    forms = rng.choice([(log_form,), (screen_form,), (log_form, screen_form)])
    lines = [
        rng.choice(forms)(
            1_700_000_000_000_000 + 997 * i,
            rng.choice([0x18FEEE31 | EXTENDED, 0x123, 4 | ERROR]),
            rng.randbytes(rng.choice([0, 3, 8, 8, 8, 8])),
            rng.choice(["can0", "can0", "can1", "vcan0"]),
        )
        for i in range(150)
    ]
    text = bytearray("\n".join(lines).encode() + b"\n")
    for _ in range(damages):
        text[rng.randrange(len(text) - 1)] = rng.choice(b"0123456789abcdefgABCDEFG@`:/#(). \nR\x80\xff\0\x19")
    return bytes(text)


@given(st.integers(0, 2**32), st.integers(0, 100))
@settings(max_examples=60, deadline=None)
def test_layouts_claim_only_what_the_tolerant_parser_reads_the_same_way(seed, damages):
    text = damaged_log(random.Random(seed), damages)
    block, parser = parse(text)
    expected, skipped = one_by_one(text)
    assert_same(block, expected)
    assert parser.skipped_lines == skipped


@pytest.mark.parametrize("position", range(50))
def test_no_character_of_a_line_may_be_anything_but_what_it_is(position):
    good = log_form(1_700_000_000_000_102, 0x18FEEE31 | EXTENDED, bytes.fromhex("BCC1FF0012345678")).encode()
    lines = [bytearray(good) for _ in range(256)]
    for value, line in enumerate(lines):
        line[position] = value
    text = b"\n".join([good] * 40 + [bytes(line) for line in lines]) + b"\n"
    block, parser = parse(text)
    expected, skipped = one_by_one(text)
    assert_same(block, expected)
    assert parser.skipped_lines == skipped


@pytest.mark.parametrize("name", ["kenworth/normal", "kenworth/tsc1", "ip332/bike"])
def test_real_logs_read_without_a_loss(name):
    path = DATA / f"{name}.log.xz"
    block, reader = read_all(path)
    expected, _ = one_by_one(lzma.decompress(path.read_bytes()))
    assert_same(block, expected)
    assert reader.skipped_lines == 0 and not reader.truncated
    assert reader.bytes_done == reader.bytes_total == path.stat().st_size


def test_kenworth_drive_has_the_frames_it_is_known_for():
    block, reader = read_all(DATA / "kenworth" / "normal.log.xz")
    assert reader.frames == len(block) == 19_957
    assert int(block.t_us[1]) == 5001
    assert int(block.can_id[1]) == 0x18FEDF00 | EXTENDED
    assert int(block.data[1]).to_bytes(8, "little") == bytes.fromhex("8AA0287D7DFFFFF5")


def test_log_form_equals_python_can(tmp_path):
    raw = lzma.decompress((DATA / "ip332" / "bike.log.xz").read_bytes())
    path = tmp_path / "bike.log"
    path.write_bytes(b"\n".join(raw.split(b"\n")[:5000]) + b"\n(1557265999.000001) can0 123#R\n")
    block, _ = read_all(path)
    oracle = list(can.CanutilsLogReader(str(path)))
    assert len(oracle) == len(block) == 5001
    for i, message in enumerate(oracle):
        assert round(message.timestamp * 1e6) == block.t_us[i]
        assert message.arbitration_id == int(block.can_id[i]) & ID_MASK
        assert message.is_extended_id == bool(int(block.can_id[i]) & EXTENDED)
        assert message.is_remote_frame == bool(int(block.can_id[i]) & REMOTE)
        assert message.dlc == block.length[i]
        assert int.from_bytes(message.data or b"", "little") == block.data[i]


ODD_BUT_GOOD = {
    "(1.5) can0 123#": (1_500_000, 0x123, b""),
    "(0000000001.000002) can0 18feee31#bcc1": (1_000_002, 0x18FEEE31 | EXTENDED, b"\xbc\xc1"),
    "(0000000001.000002) can0 18FEEE31#BC.C1 R": (1_000_002, 0x18FEEE31 | EXTENDED, b"\xbc\xc1"),
    "(0000000001.000002) can0 123#1122334455667788_9": (1_000_002, 0x123, bytes.fromhex("1122334455667788")),
    "(0000000001.000002) can0 20000004#0004000000000000": (1_000_002, 4 | ERROR, b"\0\x04" + bytes(6)),
    "(0000000001.000002) can0 18FEEE31##1" + "AB" * 12: (1_000_002, 0x18FEEE31 | EXTENDED, b"\xab" * 12),
    " (000.005001)  can0  18FEDF00   [8]  8A A0 28 7D 7D FF FF F5   '..(}}...'": (
        5001,
        0x18FEDF00 | EXTENDED,
        bytes.fromhex("8AA0287D7DFFFFF5"),
    ),
    " (000.005001)  can0  RX - -  18FEDF00   [2]  8A A0": (5001, 0x18FEDF00 | EXTENDED, b"\x8a\xa0"),
    " (000.005001)  can0  18FEDF00  [12]  " + " ".join(["8A"] * 12): (
        5001,
        0x18FEDF00 | EXTENDED,
        b"\x8a" * 12,
    ),
    " (000.005001)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME": (
        5001,
        4 | ERROR,
        b"\0\4" + bytes(6),
    ),
    " (2023-11-14 22:13:20.000102)  can0  123   [1]  11": (1_700_000_000_000_102, 0x123, b"\x11"),
    " (000.005001)  \x1b[32mcan0\x1b[0m  123   [1]  11": (5001, 0x123, b"\x11"),
    "(0000000001.000002) can0 123#11\r": (1_000_002, 0x123, b"\x11"),
    "(0000000001.000002123) can0 123#11": (1_000_002, 0x123, b"\x11"),
}


@pytest.mark.parametrize("line", ODD_BUT_GOOD)
@pytest.mark.parametrize("repeat", [1, 60])
def test_what_candump_options_and_other_tools_write_is_read(line, repeat):
    block, parser = parse((line + "\n") * repeat)
    assert parser.skipped == []
    assert_same(block, FrameBlock.from_frames([ODD_BUT_GOOD[line]] * repeat))


REMOTE_LINES = [
    "(0000000001.000002) can0 18FEEE31#R8",
    " (001.000002)  can0  18FEEE31   [8]  remote request",
]


@pytest.mark.parametrize("line", REMOTE_LINES)
@pytest.mark.parametrize("repeat", [1, 60])
def test_remote_frames_have_a_length_and_no_data(line, repeat):
    block, _ = parse((line + "\n") * repeat)
    assert block.can_id.tolist() == [0x18FEEE31 | EXTENDED | REMOTE] * repeat
    assert block.length.tolist() == [8] * repeat
    assert not block.data.any()


MALFORMED = [
    "(0000000001.000002) can0 18FEEE3#BCC1",  # a digit of the identifier is missing
    "(0000000001.000002) can0 18FEEE31#BCC",  # half a byte
    "(0000000001.000002) can0 18FEEE31#112233445566778899",  # nine bytes
    "(0000000001.000002) can0 18FEEE31",  # cut
    "(0000000001.0000",
    "(0000000001,000002) can0 18FEEE31#BCC1",
    "(99999999999999999999.000002) can0 18FEEE31#BCC1",
    "(0000000001.000002) can0 98FEEE31#BCC1",  # 30 bits
    "(0000000001.000002) can0 FFF#BCC1",  # 12 bits
    "(0000000001.000002) can0 18FEEE31#GGC1",
    "(0000000001.000002) can0 18FEEE31##1" + "AB" * 13,  # no such CAN FD length
    "(0000000001.000002) can0 18FEEE31##1R",
    " (000.005001)  can0  18FEDF00   [8]  8A A0 28",  # announces more than it brings
    " (000.005001)  can0  18FEDF00   [2]  8A A0 28",
    " (000.005001)  can0  18FEDF00  [12]  8A A0 28",
    " (000.005001)  can0  18FEDF00   [9]  8A A0 28 7D 7D FF FF F5",  # no such CAN FD length
    " (2023-13-14 22:13:20.000102)  can0  123   [1]  11",
    "  can0  18FEDF00   [2]  8A A0",  # no time stamp
    "\0\0\0\0\0\0\0\0",
    "#" * 3000,
]


@pytest.mark.parametrize("copies", [1, 40])
def test_malformed_lines_are_counted_with_their_numbers_and_cost_nobody_else(copies):
    good = "(0000000001.000002) can0 18FEEE31#BCC1\n"
    text = (good * 30 + "".join((bad + "\n") * copies for bad in MALFORMED)) * 2 + "\n\tprotocol-violation\n"
    block, parser = parse(text)
    assert len(block) == parser.frames == 60
    assert parser.skipped_lines == 2 * copies * len(MALFORMED)
    assert parser.ignored_lines == 2
    assert min(number for number, _, _ in parser.skipped) == 31
    assert len(parser.skipped) <= SKIPPED_SHOWN and all(len(text) <= 80 for _, text, _ in parser.skipped)


def test_a_line_without_stamp_has_that_reason():
    _, parser = parse("  can0  18FEDF00   [2]  8A A0\n")
    assert parser.skipped[0][2] == "no time stamp"


def test_a_stamp_before_1970_has_that_reason():
    _, parser = parse("(-1.500000) can0 18FEDF00#8AA0\n")
    assert parser.skipped[0][2] == "negative time stamp"


def test_line_numbers_go_on_from_block_to_block():
    parser = CandumpParser()
    parser.parse(b"(1.0) can0 123#\n" * 7)
    parser.parse(b"(1.0) can0 123#\nwrong\n")
    assert parser.skipped[0][:2] == (9, "wrong")


@pytest.mark.parametrize("block_frames", [1, 100, 5000, 10**6])
def test_block_size_changes_nothing(block_frames):
    path = DATA / "kenworth" / "normal.log.xz"
    block, reader = read_all(path, block_frames=block_frames)
    expected, _ = read_all(path)
    assert_same(block, expected)
    assert reader.frames == 19_957


@given(st.lists(st.integers(1, 400), min_size=1, max_size=20))
@settings(max_examples=30, deadline=None)
def test_however_the_file_is_read_the_frames_are_the_same(sizes):
    text = b"".join(
        log_form(10**15 + i, 0x18F00400 | EXTENDED, bytes(i % 9)).encode() + b"\n" + b"x" * (i % 50 == 3)
        for i in range(300)
    )
    expected, _ = one_by_one(text)
    parser, blocks, position, turn = CandumpParser(), [], 0, 0
    while position < len(text):
        end = position
        for _ in range(sizes[turn % len(sizes)]):
            end = text.find(b"\n", end) + 1 or len(text)
            if end == len(text):
                break
        piece = text[position:end]
        blocks.append(parser.parse(piece if piece.endswith(b"\n") else piece + b"\n"))
        position, turn = end, turn + 1
    assert_same(FrameBlock.concatenate(blocks), expected)


def test_unwanted_frames_are_counted_but_not_delivered():
    path = DATA / "kenworth" / "normal.log.xz"
    everything, _ = read_all(path)
    pgn = 0xF004
    wanted = lambda can_id: (can_id >> 8 & 0xFFFF) == pgn  # noqa: E731
    block, reader = read_all(path, wanted=wanted)
    assert reader.frames == 19_957
    assert 0 < len(block) < reader.frames
    assert_same(block, everything[wanted(everything.can_id)])


def test_wanted_never_gets_back_a_malformed_line():
    text = ("(1.000000) can0 123#11\n" * 30 + "(1.000000) can0 12X#11\n") * 2
    block, parser = parse(text, wanted=lambda can_id: np.ones(len(can_id), np.bool_))
    assert len(block) == parser.frames == 60


def test_one_interface_of_several(tmp_path: Path):
    path = tmp_path / "two.log"
    path.write_text("".join(log_form(i, 0x100 + i % 2, b"", f"can{i % 2}") + "\n" for i in range(100)))
    block, reader = read_all(path, channel="can1")
    assert reader.channels == {"can0": 50, "can1": 50}
    assert block.can_id.tolist() == [0x101] * 50
    assert reader.frames == 100
    with pytest.raises(LogError, match=r"expected one of can0 \(50 frames\), can1 \(50 frames\)"):
        read_all(path, channel="can2")


def test_last_line_without_newline_is_read(tmp_path):
    path = tmp_path / "cut.log"
    path.write_text("(1.000000) can0 123#11\n(2.000000) can0 123#22")
    block, reader = read_all(path)
    assert block.t_us.tolist() == [1_000_000, 2_000_000]
    assert reader.skipped_lines == 0


def test_a_byte_order_mark_costs_no_frame(tmp_path):
    path = tmp_path / "edited.log"
    path.write_bytes(b"\xef\xbb\xbf(1.000000) can0 123#11\n(2.000000) can0 123#22\n")
    block, reader = read_all(path)
    assert block.t_us.tolist() == [1_000_000, 2_000_000]
    assert reader.skipped_lines == 0


@pytest.mark.parametrize("zeros", [1, 5, 4096, 3_000_000])
def test_what_a_power_cut_left_unwritten_costs_no_frame(tmp_path, zeros):
    text = "(1.000000) can0 18FEF100#0102030405060708\n(1.100000) can0 18FEF100#1102030405060708\n"
    path = tmp_path / "cut.log"
    path.write_bytes(bytes(zeros) + text.encode() + bytes(zeros) + text.encode())
    reader = open_log(path)
    frames = FrameBlock.concatenate(list(reader))
    assert (len(frames), reader.skipped_lines) == (4, 0)


def test_one_endless_line_takes_no_memory_and_counts_once(tmp_path):
    path = tmp_path / "long.log"
    path.write_bytes(b"(1.000000) can0 123#11\n" + b"x" * 3_000_000 + b"\n(2.000000) can0 123#22\n")
    block, reader = read_all(path)
    assert block.t_us.tolist() == [1_000_000, 2_000_000]
    assert (reader.skipped_lines, reader.skipped[0][0]) == (1, 2)


def test_time_going_backwards_is_kept_as_it_stands():
    block, _ = parse("(2.000000) can0 123#11\n(1.000000) can0 123#22\n")
    assert block.t_us.tolist() == [2_000_000, 1_000_000]


def test_a_log_of_nothing_but_garbage_is_one_clear_error(tmp_path):
    path = tmp_path / "noise.log"
    path.write_bytes(random.Random(1).randbytes(100_000))
    with pytest.raises(LogError, match=r"noise\.log: nothing to read in \d+ lines; line 1"):
        read_all(path)


@pytest.fixture(scope="module")
def compiled():
    if not jit.available():
        pytest.skip("numba is not installed (extra: fast)")
    jit.enable()
    yield
    jit.enable(False)


@pytest.mark.usefixtures("compiled")
class TestCompiled:
    """The same source lines as above, through numba: equal to the definition, and so to numpy's way."""

    @given(seed=st.integers(0, 2**32))
    @settings(max_examples=60, deadline=None)
    def test_compiled_layouts_equal_the_tolerant_parser_on_damaged_logs(self, seed):
        text = damaged_log(random.Random(seed), 30)
        block, parser = parse(text)
        expected, skipped = one_by_one(text)
        assert_same(block, expected)
        assert parser.skipped_lines == skipped

    @pytest.mark.parametrize("line", ODD_BUT_GOOD)
    def test_compiled_reads_what_options_and_other_tools_write(self, line):
        block, parser = parse((line + "\n") * 60)
        assert parser.skipped == []
        assert_same(block, FrameBlock.from_frames([ODD_BUT_GOOD[line]] * 60))

    @pytest.mark.parametrize("line", REMOTE_LINES)
    def test_compiled_reads_remote_frames(self, line):
        test_remote_frames_have_a_length_and_no_data(line, 60)

    @pytest.mark.parametrize("name", ["kenworth/normal", "ip332/bike"])
    def test_compiled_equals_numpy_on_real_logs(self, name):
        path = DATA / f"{name}.log.xz"
        compiled_block, _ = read_all(path)
        jit.enable(False)
        block, _ = read_all(path)
        jit.enable()
        assert_same(compiled_block, block)


def test_every_bad_line_is_reported_by_number_and_endless_ones_by_count(tmp_path):
    good = "(1700000000.{:06d}) can0 0CF00400#F07D9128A000F0FF\n"
    log = tmp_path / "a.log"
    log.write_text("".join("garbage\n" if n % 9 == 0 else good.format(n) for n in range(1, 601)))
    reader = open_log(log)
    assert sum(len(block) for block in reader) == 600 - 66
    warning = log_warnings(reader)[3]
    assert warning.startswith("63 more lines skipped: 36, 45, 54, ") and warning.endswith(
        ", 441, 450 and 16 after them"
    )
