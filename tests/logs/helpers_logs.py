from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from canest.core.frames import ERROR, EXTENDED, FrameBlock
from canest.logs import LogReader, open_log
from canest.logs.candump_line import Line, is_ignorable, parse_line

DATA = Path(__file__).resolve().parent.parent / "data"

EXTENDED_IDS = st.integers(0, 0x1FFF_FFFF).map(lambda i: i | EXTENDED)
STANDARD_IDS = st.integers(0, 0x7FF)
ERROR_IDS = st.integers(0, 0x1FFF_FFFF).map(lambda i: i | ERROR)
FRAMES = st.lists(
    st.tuples(
        st.integers(0, 10**16),
        st.one_of(EXTENDED_IDS, STANDARD_IDS, ERROR_IDS),
        st.binary(max_size=8),
    ),
    max_size=80,
)
#: CAN FD among classic frames
LONG_FRAMES = st.lists(
    st.tuples(
        st.integers(0, 10**16),
        st.one_of(EXTENDED_IDS, STANDARD_IDS),
        st.sampled_from((0, 3, 8, 12, 16, 20, 24, 32, 48, 64)).flatmap(
            lambda size: st.binary(min_size=size, max_size=size)
        ),
    ),
    max_size=40,
)


def read_all(path: Path, **options: object) -> tuple[FrameBlock, LogReader]:
    reader = open_log(path, **options)  # type: ignore[arg-type]
    return FrameBlock.concatenate(list(reader)), reader  # type: ignore[arg-type]


def assert_same(left: FrameBlock, right: FrameBlock) -> None:
    for name in ("t_us", "can_id", "length", "data"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name), err_msg=name)


def one_by_one(text: bytes) -> tuple[FrameBlock, int]:
    """The definition: every line through the tolerant parser; frames and count of skipped lines."""
    lines = text.split(b"\n")
    lines = lines[:-1] if not lines[-1] else lines
    parsed = [(line, parse_line(line) if len(line) <= 1024 else "long") for line in lines]
    good = [line for _, line in parsed if isinstance(line, Line)]
    skipped = sum(1 for text, line in parsed if not isinstance(line, Line) and not is_ignorable(text))
    block = FrameBlock(
        np.array([line.t_us for line in good], np.int64),
        np.array([line.can_id for line in good], np.uint32),
        np.array([line.length for line in good], np.uint8),
        np.array([line.data for line in good], np.uint64),
    )
    return block, skipped


def log_form(t_us: int, can_id: int, payload: bytes, channel: str = "can0") -> str:
    digits = f"{can_id & 0x3FFF_FFFF:08X}" if can_id & (EXTENDED | ERROR) else f"{can_id:03X}"
    return f"({t_us // 10**6:010d}.{t_us % 10**6:06d}) {channel} {digits}#{payload.hex().upper()}"


def screen_form(t_us: int, can_id: int, payload: bytes, channel: str = "can0") -> str:
    digits = f"{can_id & 0x3FFF_FFFF:08X}" if can_id & (EXTENDED | ERROR) else f"{can_id:>8X}"
    if not can_id & (EXTENDED | ERROR):
        digits = f"     {can_id:03X}"
    data = " ".join(f"{byte:02X}" for byte in payload)
    return f" ({t_us // 10**6:03d}.{t_us % 10**6:06d})  {channel}  {digits}   [{len(payload)}]  {data}"
