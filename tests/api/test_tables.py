"""Tables of every library, and what is wrong with a table, in one plain line."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest

import canest

API_PAGE = (Path(__file__).parents[2] / "docs" / "api.md").read_text(encoding="utf-8")
VAN = canest.Vehicle(
    mass_min_kg=2000, mass_max_kg=3500, wheel_radius_m=0.34, final_drive=3.9, drag_area_m2=1.2,
    rolling_resistance=0.009,
)  # fmt: skip


def columns(n: int = 4000) -> dict[str, np.ndarray]:
    """Return 80 s of a 3 t van at 50 Hz that is pushed to and fro on the level."""
    t_s = 1000.0 + 0.02 * np.arange(n)
    accel = 0.6 * np.sin(0.7 * t_s) * (1 + 0.5 * np.sin(0.11 * t_s))
    speed = 15.0 + np.cumsum(accel) * 0.02
    force = 3000.0 * (accel + 9.80665 * 0.009) + 0.5 * 1.2 * 1.2 * speed**2
    return {"t_s": t_s, "wheel_torque": 0.34 * force, "vehicle_speed": speed}


class Stand:
    """The least that a table is: names, and columns that numpy understands."""

    def __init__(self, columns):
        self._columns = columns

    @property
    def columns(self):
        return list(self._columns)

    def __getitem__(self, name):
        return list(self._columns[name])


def made(library: str, of):
    if library == "mapping":
        return of
    if library == "lists":
        return {name: column.tolist() for name, column in of.items()}
    if library == "stand-in":
        return Stand(of)
    if library == "pyarrow":
        return pytest.importorskip("pyarrow").table(of)
    if library == "polars":
        return pytest.importorskip("polars").DataFrame(of)
    return pytest.importorskip("pandas").DataFrame(of)


@pytest.fixture(scope="module")
def expected():
    return canest.estimate(columns(), VAN)


def assert_same(found, expected):
    for name, column in expected.columns().items():
        np.testing.assert_array_equal(getattr(found, name), column, err_msg=name)


LIBRARIES = ["mapping", "lists", "stand-in", "pandas", "polars", "pyarrow"]


@pytest.mark.parametrize("library", LIBRARIES)
def test_every_library_gives_the_same_bits(library, expected):
    assert expected.summary["status"] == "valid"
    assert_same(canest.estimate(made(library, columns()), VAN), expected)


@pytest.mark.parametrize("library", ["pandas", "polars", "pyarrow"])
def test_dates_and_gaps_of_every_library(library, expected):
    of = columns()
    dates = np.rint(of["t_s"] * 1e6).astype("int64").astype("datetime64[us]")
    table = made(library, of | {"t_s": dates, "altitude": np.full(len(dates), np.nan)})
    assert_same(canest.estimate(table, VAN), expected)


def test_pandas_index_is_the_time(expected):
    pd = pytest.importorskip("pandas")
    of = columns()
    micros = np.rint(of.pop("t_s") * 1e6).astype("int64")
    dates = pd.to_datetime(micros, unit="us")
    abroad = dates.tz_localize("UTC").tz_convert("Asia/Tokyo")
    for index in (dates, abroad, pd.to_timedelta(micros, unit="us"), pd.Index(micros / 1e6, name="t_s")):
        assert_same(canest.estimate(pd.DataFrame(of, index=index), VAN), expected)


@pytest.mark.parametrize("kind", ["datetime", "text", "datetime64"])
def test_dates_without_a_time_zone_are_utc_wherever_the_machine_is(kind, expected, monkeypatch):
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    time.tzset()
    of = columns()
    dates = np.rint(of["t_s"] * 1e6).astype("int64").astype("datetime64[us]")
    made = {"datetime": dates.tolist(), "text": dates.astype(str).tolist(), "datetime64": dates}
    try:
        assert_same(canest.estimate(of | {"t_s": made[kind]}, VAN), expected)
    finally:
        monkeypatch.undo()
        time.tzset()


def test_pandas_own_missing_values_and_text():
    pd = pytest.importorskip("pandas")
    of = columns()
    frame = pd.DataFrame(of)
    frame["vehicle_speed"] = frame["vehicle_speed"].astype("Float64")
    frame.loc[5, "vehicle_speed"] = pd.NA
    frame["gear"] = pd.Categorical(["D"] * len(frame))
    found = canest.estimate(frame, VAN)
    assert found.summary["status"] == "valid"
    text = "column gear: 4,000 cells hold text and count as not available, first in row 1: 'D'"
    assert text in found.summary["notes"]


def test_sparse_table_is_told_to_be_filled():
    pd = pytest.importorskip("pandas")
    of = pd.DataFrame(columns())
    torque, speed = of[["t_s", "wheel_torque"]][::2], of[["t_s", "vehicle_speed"]][1::2]
    table = torque.merge(speed, on="t_s", how="outer").sort_values("t_s")
    summary = canest.estimate(table, VAN).summary
    note = (
        "columns are empty in many rows (wheel_torque 50 %, vehicle_speed 50 %), and an empty cell counts as "
        "not available: where it stands for the value before, fill it (pandas: table.ffill())"
    )
    assert summary["status"] == "unestimated"
    assert note in summary["notes"]
    filled = canest.estimate(table.ffill(), VAN).summary
    assert filled["status"] == "valid"
    assert not any("empty" in found for found in filled["notes"])


def test_table_of_one_row_or_none():
    for n in (0, 1):
        result = canest.estimate({name: column[:n] for name, column in columns().items()}, VAN)
        assert result.summary["frames"] == n
        assert result.summary["status"] == "unestimated"


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"wheel_torque": None}, canest.ConfigError, "signals: no torque, expected engine_torque_pct"),
        ({"vehicle_speed": None}, canest.ConfigError, "signals: no speed, expected output_shaft_speed"),
        ({"wheel_torque": None, "vehicle_speed": None}, canest.ConfigError,
         "table: no column is named by a role, found 't_s', expected names as engine_torque_pct"),
        ({"t_s": None}, canest.LogError, "table: the table has no time column 't_s', found 'wheel_torque"),
        ({"vehicle_speed": np.ones(3)}, canest.LogError, "table: the columns differ in length, found"),
        ({"vehicle_speed": np.ones((4000, 2))}, canest.LogError, r"no column of numbers, times or text"),
        ({"vehicle_speed": 5.0}, canest.LogError, "table: vehicle_speed: no column, expected values"),
        ({"vehicle_speed": np.ones(4000, complex)}, canest.LogError, "complex128 of shape"),
    ],
)  # fmt: skip
def test_what_a_table_lacks_is_reported(change, error, text):
    table = {name: column for name, column in (columns() | change).items() if column is not None}
    with pytest.raises(error, match=text):
        canest.estimate(table, VAN)


@pytest.mark.parametrize("config", [VAN, "class8"])
def test_rows_out_of_order_are_reported(config):
    shuffled = np.random.default_rng(1).permutation(4000)
    for order in (shuffled, slice(None, None, -1)):
        table = {name: column[order] for name, column in columns().items()}
        text = r"table: column t_s: the rows are not in the order of time, found '\d,\d+ of 4,000 that are "
        with pytest.raises(canest.LogError, match=text + r"earlier .* sorted by time"):
            canest.estimate(table, config)


def test_clock_that_is_set_back_is_no_disorder(expected):
    of = columns()
    of["t_s"][2000:] -= 30.0
    result = canest.estimate(of, VAN)
    assert result.summary["status"] == expected.summary["status"]


@pytest.mark.parametrize(
    ("factor", "every", "unit"),
    [(1e3, 1, "milliseconds"), (1e3, 50, "milliseconds"), (1e6, 1, "microseconds"), (1e9, 1, "nanoseconds"),
     (1.0, 250, "milliseconds")],
)  # fmt: skip
def test_times_that_are_no_seconds_are_reported(factor, every, unit):
    table = {name: column[::every] for name, column in columns().items()}
    table["t_s"] = table["t_s"] * factor
    with pytest.raises(canest.LogError, match=f"or their times are in {unit}, found .* times in seconds"):
        canest.estimate(table, VAN)


@pytest.mark.parametrize("rows", [4000, 60_000], ids=["80 s", "20 minutes"])
@pytest.mark.parametrize("function", [canest.estimate, canest.read_signals])
@pytest.mark.parametrize("dtype", [np.float32, np.float64], ids=["float32", "made float64 again"])
def test_times_since_1970_in_float32_are_reported(rows, function, dtype):
    """Four minutes had a few times only, and the error was of rows 128 s apart, or milliseconds."""
    table = columns(rows)
    table["t_s"] = (1.7e9 + table["t_s"]).astype(np.float32).astype(dtype)
    text = (
        r"column t_s: the times are rounded to float32, whose numbers are 128 s apart there, found '\d+ times"
    )
    with pytest.raises(canest.LogError, match=text + r" in .*,000 rows', expected float64 or dates"):
        function(table, VAN)


@pytest.mark.parametrize("start_s", [0.0, 86_400.0])
def test_times_in_float32_that_tell_rows_apart_are_times(start_s, expected):
    of = columns()
    of["t_s"] = (of["t_s"] + start_s).astype(np.float32)
    assert canest.estimate(of, VAN).mass_kg[-1] == pytest.approx(expected.mass_kg[-1], rel=0.01)


@pytest.mark.parametrize("table", [None, 5, [1, 2], "drive.csv.missing"])
def test_what_is_no_table_is_refused(table):
    with pytest.raises(canest.CanestError):
        canest.estimate(table, VAN)


def test_columns_may_have_numbers_for_names(expected):
    pd = pytest.importorskip("pandas")
    table = pd.DataFrame(columns())
    table[7] = 1.0
    assert_same(canest.estimate(table, VAN), expected)


def test_tables_of_one_diagnosis_are_alike():
    other = {name: column[::50] for name, column in columns().items()}
    with pytest.raises(canest.UsageError, match="tables of one diagnosis differ"):
        canest.diagnose([columns(), other], VAN)


def test_duckdb_relation_is_no_table_yet():
    relation = pytest.importorskip("duckdb").sql("select 1.0 as t_s, 2.0 as vehicle_speed")
    with pytest.raises(canest.LogError, match="no table"):
        canest.estimate(relation, VAN)


def test_what_is_no_truth_is_called_so():
    with pytest.raises(canest.LogError, match="no truth, found 'list', expected one truth"):
        canest.estimate(columns(), VAN, truth=[1, 2])


def test_polars_query_is_no_table_yet():
    polars = pytest.importorskip("polars")
    with pytest.raises(
        canest.LogError, match="found 'LazyFrame', expected a pandas, polars or pyarrow table"
    ):
        canest.estimate(polars.DataFrame(columns()).lazy(), VAN)


def test_vehicle_alone_is_no_config_of_frames():
    with pytest.raises(canest.ConfigError, match="a vehicle alone does not define where signals are"):
        canest.read_signals(canest.demo_drive(), VAN)


def test_signals_are_a_table_for_estimate_and_replay_says_so():
    drive = canest.demo_drive()
    signals = canest.read_signals(drive, drive.config)
    table = {"t_s": signals.t_s, **signals.values}
    vehicle = drive.config.vehicle
    assert_same(canest.estimate(signals, vehicle), canest.estimate(table, vehicle))
    for given in (signals, table):
        with pytest.raises(canest.LogError, match=r"table: .*canest.estimate takes it by the names of roles"):
            canest.replay(given, drive.config)
        with pytest.raises(
            canest.ConfigError, match=r"config: a vehicle alone .*a table for canest.estimate"
        ):
            canest.replay(given, vehicle)


@pytest.mark.parametrize(
    ("facts", "text"),
    [
        ({"mass_min_kg": 1}, "vehicle.mass_min_kg, found 1, expected greater than 50"),
        (
            {"wheel_radius": 1},
            "vehicle.wheel_radius: unknown key, expected a key of vehicle:, perhaps wheel_radius_m",
        ),
        ({"mass_min_kg": 9000}, "vehicle.mass_min_kg: found 9000, expected less than mass_max_kg, 3500"),
    ],
)
def test_facts_of_a_vehicle_are_checked(facts, text):
    with pytest.raises(canest.ConfigError, match=text):
        canest.Vehicle(**(VAN.model_dump() | facts))


@pytest.mark.parametrize(
    ("facts", "text"),
    [
        (
            {},
            r"vehicle.mass_min_kg: is missing, .*\(and 5 more: mass_max_kg, wheel_radius_m, final_drive, dra",
        ),
        (
            {"mass_min_kg": 1},
            r"found 1, expected greater than 50 \(and 5 more: mass_max_kg, wheel_radius_m, fin",
        ),
        (
            {"wheel_radius": 1},
            r"unknown key, .*perhaps wheel_radius_m .*\(and 6 more: mass_min_kg, mass_max_kg, ",
        ),
        (
            VAN.model_dump() | {"mass_min_kg": 1, "final_drive": 0},
            r"found 1, expected greater than 50 \(and 1 more\)",
        ),
    ],
)
def test_all_facts_that_a_vehicle_lacks_are_named_beside_another_mistake(facts, text):
    with pytest.raises(canest.ConfigError, match=text):
        canest.Vehicle(**facts)


def test_fact_without_a_name_is_refused():
    with pytest.raises(
        canest.ConfigError, match="vehicle: a fact without a name, found 3500, expected facts by"
    ):
        canest.Vehicle(3500)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"mass_kg": -5}, "mass_kg: no such number, found -5, expected 50 kg or more"),
        ({"mass_kg": 3.5}, "mass_kg: no such number, found 3.5"),
        ({"mass_kg": float("nan")}, "mass_kg: no such number, found nan"),
        ({"mass_kg": "3000"}, "mass_kg: no such number, found '3000'"),
        ({"mass_kg": 3000, "after_s": -1}, "after_s: no such number, found -1, expected 0 or more"),
    ],
)
def test_what_is_no_true_mass_is_refused(arguments, text):
    with pytest.raises(canest.UsageError, match=text):
        canest.estimate(columns(), VAN, **arguments)
    with pytest.raises(canest.UsageError, match=text):
        canest.compare(columns(), VAN, **arguments)


def test_mass_of_a_diagnosis_is_checked():
    with pytest.raises(canest.UsageError, match="mass_kg: no such number, found -5"):
        canest.diagnose(columns(), VAN, mass_kg=-5)


@pytest.mark.parametrize("estimators", ["canest", 5])
def test_estimators_to_compare_are_a_list(estimators):
    with pytest.raises(canest.UsageError, match=r"estimators: no list, found .*, expected a list of names"):
        canest.compare(columns(), VAN, mass_kg=3000, estimators=estimators)


@pytest.mark.parametrize("frames", [None, [], b""])
def test_pipeline_takes_frames_alone(frames):
    with pytest.raises(canest.UsageError, match=r"push: no frames, found .* FrameBlock.from_messages"):
        canest.Pipeline("class8").push(frames)


@pytest.mark.parametrize(
    ("t_s", "can_id", "data", "text"),
    [
        ([0.0], ["0x1"], [b""], "no columns of frames, found .*0x1.*, expected seconds, whole numbers and"),
        (["x"], [1], [b""], "no columns of frames"),
        ([0.0], [1], ["ab"], "no columns of frames"),
        ([0.0], [1], [bytes(65)], "data of a frame is too long, expected at most 64 bytes"),
    ],
)
def test_what_is_no_column_of_frames_is_refused(t_s, can_id, data, text):
    with pytest.raises(canest.UsageError, match=text):
        canest.FrameBlock.from_arrays(t_s, can_id, data)


def test_frames_of_messages_and_of_arrays_are_the_same():
    import can

    messages = [
        can.Message(timestamp=1.5, arbitration_id=0x0CF00400, data=[1, 2, 3]),
        can.Message(timestamp=1.52, arbitration_id=0x123, data=[9], is_extended_id=False),
    ]
    found = canest.FrameBlock.from_messages(messages)
    expected = canest.FrameBlock.from_arrays([1.5, 1.52], [0x0CF00400, 0x123], [b"\1\2\3", b"\t"])
    assert found.can_id.tolist() == [0x8CF00400, 0x123]
    for name in ("t_us", "can_id", "length", "data"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    with pytest.raises(canest.UsageError, match="columns of frames do not fit together"):
        canest.FrameBlock.from_arrays([1.5], [1, 2], [b""])
    with pytest.raises(canest.UsageError, match="can_id of a frame is no identifier"):
        canest.FrameBlock.from_arrays([1.5], [1 << 30], [b""])


def test_a_column_whose_name_is_a_slip_is_noted():
    given = columns()
    given["pitchrate"], given["YawRate"] = np.zeros(len(given["t_s"])), np.zeros(len(given["t_s"]))
    found = canest.estimate(given, VAN)
    notes = [note for note in found.summary["notes"] if "not used" in note]
    assert notes == ["column YawRate is not used: perhaps it is yaw_rate"]


@pytest.mark.parametrize(
    ("role", "full", "text"),
    [
        (
            "wheel_torque",
            1100.0,
            r"wheel_torque is between -0\.\d+ and 0\.\d+ Nm while the .* in kN m \(unit: kNm",
        ),
        (
            "engine_torque_pct",
            1100.0,
            r"engine_torque_pct is between -0.* which takes a factor of 100 \(scale: 100",
        ),
        ("wheel_torque", 1.0, ""),
        ("engine_torque_pct", 11.0, ""),
    ],
)
def test_a_torque_that_is_a_ratio_is_noted(role, full, text):
    of = columns()
    of[role] = of.pop("wheel_torque") / full
    vehicle = canest.Vehicle(
        **(VAN.model_dump() | {"reference_torque_Nm": 1100 / 3.9, "gear_ratios": {1: 1.0}})
    )
    notes = [
        note
        for note in canest.estimate(of, vehicle).summary["notes"]
        if "factor of" in note or "ratio" in note
    ]
    assert len(notes) == bool(text)
    assert re.match("signals." + text, "".join(notes)) or not text


RATES = re.findall(r"^\| (\d+) \| ([\d.]+) % \| ([\d.]+) % \| ([\d.]+) % \|$", API_PAGE, re.M)


@pytest.mark.parametrize("place", range(3), ids=["demo", "launches-flat", "mixed-9t"])
def test_a_table_of_any_rate_is_as_right_as_the_page_says_and_valid_is_true(place):
    """At 1 Hz a shift between two rows was no shift: masses were 23 % too high, and valid."""
    pytest.importorskip("pandas")
    assert len(RATES) == 5
    drive = canest.simulate(("demo", "launches-flat", "mixed-9t")[place])
    table = canest.read_signals(drive, drive.config).to_pandas()
    for hz, *shown in RATES:
        found = canest.estimate(table.iloc[:: 50 // int(hz)], drive.config, truth=drive.truth)
        assert found.summary["errors"]["mass_rms_pct"] == pytest.approx(float(shown[place]), abs=0.1)
        true_kg = np.interp(found.t_s, drive.truth["t_s"], drive.truth["mass_kg"])
        off = np.abs(found.mass_kg - true_kg)[found.status == canest.Status.VALID]
        assert (off < 3.0 * found.mass_std_kg[found.status == canest.Status.VALID]).all()
