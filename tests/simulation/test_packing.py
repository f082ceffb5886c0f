"""Bit fields: what cantools reads back is what was put in."""

from __future__ import annotations

from typing import Any

import cantools
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.simulation.packing import Field, payload, scaled, signed

MESSAGE: Any = cantools.database.load_string(
    """VERSION ""
BU_:
BO_ 1 M: 8 Vector__XXX
 SG_ A : 3|13@1+ (0.5,-100) [0|0] "" Vector__XXX
 SG_ B : 16|16@1- (0.25,0) [0|0] "" Vector__XXX
 SG_ C : 40|2@1+ (1,0) [0|0] "" Vector__XXX
""",
    "dbc",
).get_message_by_name("M")


@settings(max_examples=60, deadline=None)
@given(st.floats(-100, 3900), st.floats(-8000, 8000), st.integers(0, 3))
def test_cantools_reads_back_what_was_packed(a: float, b: float, c: int):
    fields = [
        scaled(3, 13, np.array([a]), 0.5, -100, 8000),
        signed(16, 16, np.array([b]), 0.25),
        Field(40, 2, np.array([c])),
    ]
    data = int(payload(fields, 1)[0])
    read = MESSAGE.decode(data.to_bytes(8, "little"), decode_choices=False)
    assert abs(read["A"] - a) <= 0.2501
    assert abs(read["B"] - b) <= 0.1251
    assert read["C"] == c
    untouched = ~((0x1FFF << 3) | (0xFFFF << 16) | (0x3 << 40)) & 0xFFFF_FFFF_FFFF_FFFF
    assert data & untouched == untouched


def test_beyond_the_range_the_last_number_is_sent_and_unknown_is_all_ones():
    values = np.array([1e9, -1e9, np.nan])
    raw = payload([scaled(0, 8, values, 0.4, 0, 250)], 3) & np.uint64(0xFF)
    assert raw.tolist() == [250, 0, 255]
