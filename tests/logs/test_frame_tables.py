"""Frames in csv: Vehicle Spy, and traces exported from CANalyzer and CANoe in several languages."""

import numpy as np
import pytest

import canest
from canest.core.errors import LogError
from canest.core.frames import EXTENDED, REMOTE, FrameBlock
from canest.logs import open_log
from canest.pipeline.table_map import open_for

from .helpers_logs import read_all

SPY_HEADERS = (
    "Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,ID,Cycle,Ch,B1-256,Dyn,"
    "Symbol Type,Strt-PPI-NULL-Sync-Res,H-CRC,CRC,Tframe,Tss Length,Value,Trigger,Signals\n"
    "Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,Arb ID,Remote/EDL-BRS-ESI,Xtd,"
    "B1,B2,B3,B4,B5,B6,B7,B8,Value,Trigger,Signals\n"
    "Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,PT,Trgt,Src,"
    "B1,B2,B3,B4,B5,B6,B7,B8,Value,Trigger,Signals\n"
)
SPY = (
    "Vehicle Spy,3.9,csv\nSave Date,11/23/2026\nSave Time,9:05:11 AM\nSystem Time,160000000\nNotes,\n\n"
    "Network Description,Hardware,Network,Protocol,Baud Rate\nHS CAN,Default,HS CAN,CAN,250000,\n\n\n\n"
    + SPY_HEADERS
    + "1,0.000250,0,67371008,F,F,HS CAN $CF00400,HS CAN,,CF00400,F,T,F0,7D,8E,20,1C,00,FF,FF,,,\n"
    "2,0.010251000,0.010001,67371008,F,F,HS CAN $119,MS CAN,,119,F,F,00,0D,8B,,,,,,,,\n"
    "3,0.020,0.01,67371008,T,F,error frame,HS CAN,,0,F,F,,,,,,,,,,,\n"
    "4,0.030,0.01,67371008,F,F,remote,HS CAN,,18EA00F9,T,T,,,,,,,,,,,\n"
    "5,0.040,0.01,67371008,F,F,J1708,J1708,,84,00,C2,11,22,,,,,,,,,\n"
)
#: the same three frames as CANalyzer shows them: bytes in one cell, an x after identifiers of 29 bits
VECTOR = {
    "hex": "Time,Chn,ID,Name,Event Type,Dir,DLC,Data length,Data\n"
    "0.000250,CAN 1,CF00400x,EEC1,CAN Frame,Rx,8,8,F0 7D 8E 20 1C 00 FF FF\n"
    "0.010251,CAN 2,119,,CAN Frame,Rx,3,3,00 0D 8B\n"
    "0.020000,CAN 1,,,Error Frame,Rx,,,\n",
    "german, decimal": "Time;Chn;ID;Name;Event Type;Dir;DLC;Data length;Data\n"
    "0,000250;CAN 1;217056256x;EEC1;CAN Frame;Rx;8;8;240 125 142 32 28 0 255 255\n"
    "0,010251;CAN 2;281;;CAN Frame;Rx;3;3;0 13 139\n",
    "tabs, other columns first": "Name\tTime [ms]\tID (hex)\tData (hex)\n"
    "EEC1\t0.250\t0x0CF00400\tF07D8E201C00FFFF\n"
    "\t10.251\t0x119\t00 0D 8B\n",
    "quoted, byte-order mark": '\ufeff"Time";"Channel";"ID";"Dir";"DLC";"Data"\r\n'
    '"0,000250";"1";"0CF00400h";"Rx";"8";"F0 7D 8E 20 1C 00 FF FF"\r\n'
    '"0,010251";"2";"119h";"Rx";"3";"00 0D 8B"\r\n',
}
EXPECTED = FrameBlock.from_frames([
    (250, 0xCF00400 | EXTENDED, bytes.fromhex("F07D8E201C00FFFF")),
    (10_251, 0x119, bytes.fromhex("000D8B")),
])  # fmt: skip


def same(found, expected):
    return all(
        np.array_equal(getattr(found, name), getattr(expected, name))
        for name in ("t_us", "can_id", "length", "data")
    )


def test_vehicle_spy(tmp_path):
    path = tmp_path / "spy.csv"
    path.write_text(SPY)
    block, reader = read_all(path)
    assert same(block[:2], EXPECTED)
    assert block.can_id[2] == 0x18EA00F9 | EXTENDED | REMOTE and len(block) == 3
    # a J1708 message has no place in a log of frames: counted, and reported
    assert [number for number, *_ in reader.skipped] == [len(SPY.splitlines())]
    assert reader.channels == {"HS CAN": 2, "MS CAN": 1}


def test_one_network_of_vehicle_spy(tmp_path):
    path = tmp_path / "spy.csv"
    path.write_text(SPY)
    block, _ = read_all(path, channel="MS CAN")
    assert block.can_id.tolist() == [0x119]


@pytest.mark.parametrize("layout", VECTOR)
def test_a_canalyzer_trace(tmp_path, layout):
    path = tmp_path / "trace.csv"
    path.write_text(VECTOR[layout], encoding="utf-8", newline="")
    block, reader = read_all(path)
    assert same(block, EXPECTED) and not reader.skipped_lines


def test_small_decimal_identifiers_are_known_by_their_bytes(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_text("Time,ID,DLC,Data\n0.1,281,2,255 16\n0.2,281,2,100 0\n")
    block, _ = read_all(path)
    assert block.can_id.tolist() == [281, 281] and block.data[0] == 0x10FF


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("0.3,XYZ,2,00 01", "invalid literal"),
        ("0.3,3FFFFFFFFx,2,00 01", "no identifier"),
        ("0.3,119,2,00 1FF", "range"),
        ("soon,119,2,00 01", "could not convert"),
        ("0.3", "cells"),
        ("nan,119,2,00 01", "no time"),
    ],
)
def test_a_damaged_line_is_counted_and_the_rest_is_read(tmp_path, line, reason):
    path = tmp_path / "trace.csv"
    path.write_text(f"Time,ID,DLC,Data\n0.1,1A9,2,00 01\n{line}\n0.2,1A9,2,00 02\n")
    block, reader = read_all(path)
    assert len(block) == 2 and reader.skipped_lines == 1
    assert reason in reader.skipped[0][2] and reader.skipped[0][0] == 3


def test_a_table_of_decoded_signals_stays_one(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("t_s,id,v\n0,1,2\n")
    with open_log(path) as reader:
        assert reader.kind == "table"


def test_an_unknown_csv_is_refused_with_the_formats_that_are_known(tmp_path):
    path = tmp_path / "odd.csv"
    path.write_text("Recorder,ACME\nwhen,what,how much\n1,2,3\n")
    with pytest.raises(LogError) as caught:
        list(open_log(path))
    text = str(caught.value)
    assert "no log format that canest knows" in text and "Vehicle Spy" in text and ".blf" in text


def test_a_replay_from_vehicle_spy_is_that_of_the_same_frames(tmp_path):
    drive = canest.demo_drive()
    frames = drive.frames[:20_000]
    columns = [getattr(frames, name).tolist() for name in ("t_us", "can_id", "length", "data")]
    lines = [
        f"{n},{t / 1e6:.6f},0,0,F,F,d,HS CAN,,{i & 0x1FFFFFFF:X},F,T,"
        + ",".join(f"{b:02X}" for b in int(d).to_bytes(8, "little")[:length]).ljust(1)
        + "," * (8 - length)
        + ",,,"
        for n, (t, i, length, d) in enumerate(zip(*columns, strict=True))
    ]
    path = tmp_path / "drive.csv"
    path.write_text(SPY_HEADERS + "\n".join(lines) + "\n")
    config = canest.load_config("class8")
    with open_for(config, path) as reader:
        assert reader.kind == "frames"
    ours, theirs = canest.replay(path, config), canest.replay(frames, config)
    assert np.array_equal(ours.mass_kg, theirs.mass_kg, equal_nan=True) and len(ours) == len(theirs)
