"""A DBC that was cut down to a few messages still has entries for the signals of others."""

import pytest

from canest.core.errors import ConfigError
from canest.decode.database import database_warnings, overlap_warnings, parse

DBC = """VERSION ""
BU_: E
BO_ 256 Motor: 8 E
 SG_ Torque : 0|16@1+ (0.1,-500) [0|0] "Nm" E
 SG_ State : 16|4@1+ (1,0) [0|0] "" E
VAL_ 256 State 0 "off; or VAL_ 9 x" 1 "on" ;
"""
UNUSED = """VAL_ 999 Other_Sig 0 "off; at night" 1 "on" ;
VAL_ 256 Gone 1 "one"
  2 "two" ;
SIG_VALTYPE_ 999 Other_Sig : 1;
VAL_ 2147484647 Far 0 "off" ;
"""


def test_entries_without_a_signal_are_left_out_and_named():
    database = parse((DBC + UNUSED).encode(), ".dbc", "own.dbc")
    (message,) = database.messages
    assert {int(raw): str(text) for raw, text in message.get_signal_by_name("State").choices.items()} == {
        0: "off; or VAL_ 9 x",
        1: "on",
    }
    (note,) = database_warnings([database])
    assert note.startswith("the DBC has no signal for VAL_ ") and "VAL_ 999 Other_Sig" in note
    assert note.endswith(" and 1 more")
    assert not database_warnings([parse(DBC.encode(), ".dbc", "own.dbc")])


def test_signals_that_overlap_beside_them_are_named_too():
    overlapping = DBC.replace("16|4@1+", "8|4@1+")
    database = parse((overlapping + UNUSED).encode(), ".dbc", "own.dbc")
    assert len(overlap_warnings([database])) == 1 and len(database_warnings([database])) == 2


def test_an_error_has_all_lines_of_its_cause(monkeypatch):
    monkeypatch.setattr("canest.decode.database.without_entries", lambda content, entries: content)
    with pytest.raises(ConfigError) as caught:
        parse((DBC + UNUSED).encode(), ".dbc", "own.dbc")
    assert "VAL_ 999 Other_Sig" in str(caught.value) and "\n" not in str(caught.value)
