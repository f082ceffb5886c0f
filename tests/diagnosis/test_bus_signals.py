"""What the bus offers beside the signal map, whatever kind of bus it is."""

from types import SimpleNamespace

import numpy as np
import pytest

from canest.config import parse_config, read_databases
from canest.config.sections import Source
from canest.diagnosis.data.drive import Run
from canest.diagnosis.data.residual_windows import windows_of
from canest.diagnosis.search.bus_signals import Ranked, _repeats, held_on_windows, signals_of
from canest.diagnosis.search.driven_data import _level_between
from canest.diagnosis.search.switches import with_switches
from canest.pipeline.signal_map import decoder_for
from canest.system.shipped_files import shipped

OWN_DBC = """VERSION ""

BU_: X

BO_ 259 Aux: 8 X
 SG_ AcOn : 8|1@1+ (1,0) [0|1] "" X

BO_ 260 Odd: 8 X
 SG_ Half : 0|16@1- (1,0) [0|0] "" X

BO_ 2566844926 Wide: 8 X
 SG_ Lamp : 0|2@1+ (1,0) [0|3] "" X

SIG_VALTYPE_ 260 Half : 1;
"""


def test_messages_that_are_no_j1939_come_under_their_own_identifier(tmp_path):
    """Such a signal may become a switch of the revised config, which then must not name an address."""
    (tmp_path / "own.dbc").write_text(OWN_DBC)
    log = tmp_path / "car.log"
    frames = ("103#0001000000000000", "203#0000000000000000", "104#00", "18FEF1FE#01", "18FEF117#01",
              "0CF00400#F1CD86451400FFFF")  # fmt: skip
    log.write_text("".join(f"({0.1 * i:.6f}) can0 {frame}\n" for i in range(9) for frame in frames))
    text = (shipped("configs") / "class8.yaml").read_text()
    text = text.replace("[j1939.dbc]", f"[{tmp_path / 'own.dbc'}, j1939.dbc]")
    config = read_databases(parse_config(text))
    found = signals_of(log, config)
    assert {"Aux.AcOn", "EEC1.EngSpeed from 0x00"} <= set(found)
    assert not {name for name in found if name.startswith(("Odd", "Aux.AcOn ")) or name.endswith("0xfe")}
    source, stamps, values = found["Aux.AcOn"]
    assert (source.source, len(stamps), set(values.tolist())) == (None, 9, {1.0})
    decoder_for(config.model_copy(update={"signals": config.signals | {"acon": source}}))


def test_more_messages_than_one_decoder_takes_and_two_lengths_of_one_group(tmp_path):
    many = 'VERSION ""\n\nBU_: X\n\n'
    many += "".join(f'BO_ {i} M{i}: 8 X\n SG_ S{i} : 0|8@1+ (1,0) [0|255] "" X\n\n' for i in range(1, 301))
    many += 'BO_ 2566834699 Short: 2 X\n SG_ A : 0|8@1+ (1,0) [0|255] "" X\n\n'
    many += 'BO_ 2566834700 Long: 4 X\n SG_ B : 24|8@1+ (1,0) [0|255] "" X\n\n'
    many += 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    many += 'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
    many += "".join(f'BA_ "VFrameFormat" BO_ {i} 3;\n' for i in (2566834699, 2566834700))
    (tmp_path / "many.dbc").write_text(many)
    frames = [f"{i:03X}#{i % 256:02X}00000000000000" for i in range(1, 301)]
    frames += ["18FECA0B#0700", "18FECA0C#00000009", "0CF00400#F1CD86451400FFFF"]
    log = tmp_path / "car.log"
    lines = [f"({t + 0.001 * i:.6f}) can0 {frame}\n" for t in range(3) for i, frame in enumerate(frames)]
    log.write_text("".join(lines))
    text = (shipped("configs") / "class8.yaml").read_text()
    text = text.replace("[j1939.dbc]", f"[{tmp_path / 'many.dbc'}, j1939.dbc]")
    config = read_databases(parse_config(text))
    found = signals_of(log, config)
    assert {f"M{i}.S{i}" for i in range(1, 301)} <= set(found)
    assert {"Short.A from 0x0b", "Long.B from 0x0c", "EEC1.EngSpeed from 0x00"} <= set(found)
    assert found["M300.S300"][2].tolist() == [300 % 256] * 3


def test_a_signal_is_held_onto_windows_on_both_sides_of_a_clock_set_back():
    t_us = 20_000 * np.arange(100 * 50) - 3_600_000_000 * (np.arange(100 * 50) >= 40 * 50)
    run = Run(SimpleNamespace(t_us=t_us), *4 * [None])
    windows = windows_of(np.ones(len(t_us), np.bool_), run.t_s, np.ones(len(t_us), np.bool_))
    problem = SimpleNamespace(parts=[SimpleNamespace(run=run, windows=windows)])
    column = held_on_windows(problem, [(t_us[::10], np.arange(500.0))])
    assert column == pytest.approx(5.0 * np.arange(100) + 2.0, abs=1.0)


def test_a_signal_that_repeats_what_the_model_knows_is_the_cause_of_nothing():
    """A navigation's speed and the driver's demand of torque went with what a wind had left."""
    rng = np.random.default_rng(1)
    known = np.column_stack([np.ones(300), rng.uniform(5, 25, 300), rng.normal(0, 500, 300)])
    assert _repeats(known, 3.6 * known[:, 1] + rng.normal(0, 0.5, 300))
    assert _repeats(known, 0.04 * known[:, 2] + 8.0)
    assert not _repeats(known, (rng.uniform(size=300) > 0.5).astype(float))


def test_a_signal_becomes_a_role_of_its_own_whatever_it_is_called():
    config = parse_config((shipped("configs") / "class8.yaml").read_text())
    assert "clutch_switch" not in config.signals and "pto_state" in config.signals
    columns = ["clutch_switch", "PTO_state", "Aircon [kW]", "aircon (kW)", "[/]"]
    ranked = [Ranked(name, Source(column=name), 0.5, True, False) for name in columns]
    extended = with_switches(config, ranked)
    new = {s.column: role for role, s in extended.signals.items() if role not in config.signals}
    roles = ["other_clutch_switch", "other_pto_state", "aircon_kw", "other_aircon_kw", "signal"]
    assert new == dict(zip(columns, roles, strict=True))


def test_a_table_has_columns_whatever_dbc_its_config_lists(tmp_path):
    log = tmp_path / "trip.csv"
    log.write_text("seconds,v,lamp\n" + "".join(f"{0.1 * i},10,{i % 2}\n" for i in range(9)))
    text = (shipped("configs") / "bmw-i3.yaml").read_text().replace("dbc: []", "dbc: [j1939.dbc]")
    found = signals_of(log, parse_config(text, overrides=["sampling.time_column=seconds"]))
    assert set(found) == {"v", "lamp"}
    assert found["lamp"][0].column == "lamp"


@pytest.mark.parametrize(
    ("off", "on", "level"),
    [(0.0, 1.0, 0.5), (0.3173, 17.2891, 9.0), (101.32517, 101.39283, 101.359), (-4.0, 1316.7, 700.0)],
)
def test_the_level_of_a_switch_has_the_digits_that_off_and_on_tell_apart(off, on, level):
    run = SimpleNamespace(signals={"fan": np.repeat([off, on, np.nan], 100)})
    problem = SimpleNamespace(parts=[SimpleNamespace(run=run)])
    assert _level_between(problem, "fan") == level
