"""Value tables: labels of a DBC, texts of a table and raw numbers become what a role means."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from canest.config import parse_config, read_databases
from canest.core.errors import ConfigError
from canest.core.frames import FrameBlock
from canest.pipeline.signal_map import decoder_for
from canest.pipeline.table_map import TableMap, open_for

DBC = """VERSION ""
BU_: X
BO_ 416 Gearbox: 8 X
 SG_ Gear : 0|4@1+ (1,0) [0|15] "" X
 SG_ Clutch : 4|2@1+ (1,0) [0|3] "" X
 SG_ Torque : 15|16@0- (0.5,0) [0|0] "Nm" X
 SG_ Wheel : 32|16@1+ (0.1,0) [0|0] "km/h" X
 SG_ Text : 48|16@1+ (1,0) [0|0] "" X
VAL_ 416 Gear 1 "Gang_1" 2 "Gang_2" 13 "Leerlauf" 14 "Rueckwaerts" 15 "SNA" ;
VAL_ 416 Clutch 0 "Off" 1 "On" ;
"""
VEHICLE = """
vehicle: {mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 4, drag_area_m2: 0.7,
  rolling_resistance: 0.01, gear_ratios: {1: 3.5, 2: 2.0}}
"""


@pytest.fixture
def config(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)

    def make(signals: str):
        text = f"{VEHICLE}\ndbc: [{tmp_path}/car.dbc]\nsignals:\n" + signals
        return read_databases(parse_config(text))

    return make


def frames(words) -> FrameBlock:
    n = len(words)
    return FrameBlock(
        np.arange(n, dtype=np.int64) * 10_000,
        np.full(n, 416, np.uint32),
        np.full(n, 8, np.uint8),
        np.array(words, np.uint64),
    )


def decoded(config, words, cut=None) -> dict[str, np.ndarray]:
    """Decode frames, cut into blocks of so many."""
    decoder, found = decoder_for(config), {}
    block = frames(words)
    for first in range(0, len(words), cut or len(words)):
        for role, (_, values) in decoder.push(block[first : first + (cut or len(words))]).samples.items():
            found.setdefault(role, []).append(values)
    return {role: np.concatenate(parts) for role, parts in found.items()}


def test_labels_and_raw_numbers_of_a_dbc_become_gears(config):
    some = config(
        "  gear: {message: Gearbox, signal: Gear, "
        "map: {gang_1: 1, Gang_2: 2, Leerlauf: 0, Rueckwaerts: -1, 7: 5}}\n"
    )
    found = decoded(some, [1, 2, 13, 14, 7, 15, 3])["gear"]
    np.testing.assert_array_equal(found, [1, 2, 0, -1, 5, np.nan, np.nan])


def test_a_map_alone_decides_what_is_valid(config):
    """Raw 14 and 15 of four bits are indicators to J1939; here the map lists one of them."""
    plain = config("  gear: {message: Gearbox, signal: Gear}\n")
    mapped = config("  gear: {message: Gearbox, signal: Gear, map: {14: 4}}\n")
    assert np.isnan(decoded(plain, [14])["gear"][0])
    assert decoded(mapped, [14])["gear"][0] == 4


def test_what_yaml_reads_as_true_is_the_label_on(config):
    some = config("  clutch_switch: {message: Gearbox, signal: Clutch, map: {on: 1, No: 0}}\n")
    np.testing.assert_array_equal(decoded(some, [0, 16, 32])["clutch_switch"], [0, 1, np.nan])


def test_an_inverted_state(config):
    some = config("  driveline_engaged: {message: Gearbox, signal: Clutch, invert: true}\n")
    np.testing.assert_array_equal(decoded(some, [0, 16, 48])["driveline_engaged"], [1, 0, np.nan])


def test_scale_and_offset_apply_in_the_unit_of_the_role(config):
    some = config("  vehicle_speed: {message: Gearbox, signal: Wheel, scale: 2, offset: -1.5}\n")
    (speed,) = decoded(some, [360 << 32])["vehicle_speed"]
    assert speed == pytest.approx(2 * 10.0 - 1.5)


def test_a_signed_signal_is_mapped_by_its_signed_raw_number(config):
    some = config("  engine_torque: {message: Gearbox, signal: Torque, map: {-1: 7, 2: 8}}\n")
    words = [0xFFFF00, 0x020000]
    np.testing.assert_array_equal(decoded(some, words)["engine_torque"], [7, 8])


def test_characters_are_mapped_by_their_text(config):
    some = config("  gear: {message: Gearbox, signal: Text, validity: ascii, map: {D1: 3, xx: 0}}\n")
    words = [int.from_bytes(t, "little") << 48 for t in (b"D1", b"XX", b"D2")]
    np.testing.assert_array_equal(decoded(some, words)["gear"], [3, 0, np.nan])


@pytest.mark.parametrize("cut", [1, 7, 250, 999])
def test_any_cut_gives_the_same_bits(config, cut):
    some = config(
        "  gear: {message: Gearbox, signal: Gear, "
        "map: {Gang_1: 1, Gang_2: 2, 13: 0.1}, scale: 3, offset: 0.7}\n"
        "  driveline_engaged: {message: Gearbox, signal: Clutch, invert: true}\n"
    )
    words = np.random.default_rng(3).integers(0, 1 << 62, 1000).tolist()
    whole, pieces = decoded(some, words), decoded(some, words, cut)
    for role in whole:
        assert whole[role].tobytes() == pieces[role].tobytes()


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            "map: {Gang_9: 9}",
            "no such label, found 'Gang_9', expected a raw number, or a label of the DBC: Gang_",
        ),
        ("map: {16: 1}", "no raw number of the signal, found 16, expected 0 to 15"),
        ("map: {1.5: 1}", "no such label, found '1.5'"),
    ],
)
def test_a_key_that_the_signal_cannot_hold_is_refused(config, entry, message):
    some = config("  gear: {message: Gearbox, signal: Gear, " + entry + "}\n")
    with pytest.raises(ConfigError) as error:
        decoder_for(some)
    assert "signals.gear.map" in str(error.value) and message in str(error.value)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("gear: {column: g, map: {}}", "signals.gear.map"),
        ("gear: {column: g, map: {N: none}}", "signals.gear.map.N"),
        ("gear: {column: g, invert: true}", "signals.gear.invert: gear has more than two states"),
    ],
)
def test_an_entry_that_makes_no_sense_is_refused(config, entry, message):
    with pytest.raises(ConfigError) as error:
        config(f"  {entry}\n")
    assert message in str(error.value)


TABLE = (
    "  gear: {column: gear, map: {D3: 3, Gang_1: 1, N: 0, 5: 5}}\n"
    "  driveline_engaged: {column: gear, map: {N: 0, D3: 1, Gang_1: 1}}\n"
    "  vehicle_speed: {column: v, unit: km/h, offset: 1}\n"
)
ROWS = [("0.0", "D3"), ("0.1", " Gang_1"), ("0.2", "N"), ("0.3", "5"), ("0.4", ""), ("0.5", "X?")]


def table(path, config):
    tables, found = TableMap(config), {}
    with open_for(config, path) as reader:
        for block in reader:
            for role, (_, values) in tables.samples(block).items():
                found.setdefault(role, []).append(values)
    return {role: np.concatenate(parts) for role, parts in found.items()}, tables.warnings()


@pytest.mark.parametrize("quoting", [csv.QUOTE_MINIMAL, csv.QUOTE_ALL])
def test_gear_text_of_a_csv(config, tmp_path, quoting):
    with (tmp_path / "t.csv").open("w", newline="") as file:
        writer = csv.writer(file, quoting=quoting)
        writer.writerows([("t_s", "gear", "v"), *((t, text, "36") for t, text in ROWS)])
    found, notes = table(tmp_path / "t.csv", config(TABLE))
    np.testing.assert_array_equal(found["gear"], [3, 1, 0, 5, np.nan, np.nan])
    np.testing.assert_array_equal(found["driveline_engaged"], [1, 1, 0, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(found["vehicle_speed"], 11.0)
    assert notes[0] == ("column gear: 1 cells are not in signals.gear.map and count as not available: 'X?'")


def test_gear_text_of_a_parquet_file(config, tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    columns = {
        "t_s": [float(t) for t, _ in ROWS],
        "gear": [text or None for _, text in ROWS],
        "v": [36.0] * 6,
    }
    pq.write_table(pa.table(columns), tmp_path / "t.parquet")
    found, _ = table(tmp_path / "t.parquet", config(TABLE))
    np.testing.assert_array_equal(found["gear"], [3, 1, 0, 5, np.nan, np.nan])


def test_a_log_without_a_listed_text_warns_of_it(config, tmp_path):
    from canest.offline.replay import replay

    (tmp_path / "t.csv").write_text("t_s,gear,v,M\n" + "".join(f"{i / 10},Fahrt,36,50\n" for i in range(50)))
    some = config(TABLE + "  engine_torque: {column: M}\n")
    result = replay(tmp_path / "t.csv", some)
    assert any("'Fahrt'" in note for note in result.warnings)
    assert "signals.gear.map lists" in result.summary["reason"]
