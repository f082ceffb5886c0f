"""revised.yaml: the user's own text with the additions, and nothing else changed."""

import shutil
from types import SimpleNamespace

import pytest
import yaml

from canest.config import load_config
from canest.config.load import parse_config
from canest.config.sections import Source
from canest.diagnosis.report.revised_config import revised_config, revised_text
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.choice import Chosen
from canest.system.shipped_files import shipped

WIND = Chosen(Candidate("headwind", "headwind", "wind_mps"), 6.47956, 0.0256, 0.93)
GAIN = Chosen(Candidate("torque_gain", "torque_gain", "gain"), -0.08, 0.001, 0.5)
GEAR = Chosen(Candidate("driveline_loss gear 9", "driveline_loss", "loss", (("gear", 9),)), 0.06, 0.002, 0.9)
SHAPE = (("signal", "estpercentfanspeed"), ("exponent", 3.0), ("threshold", 40.0))
FAN = Chosen(Candidate("switched_load", "switched_load", "power_kW", SHAPE), 30.0, 1.0, 0.8)
FAN_SOURCE = Source(message="FD", signal="EstPercentFanSpeed", source=0)


def diagnosis(config, *chosen):
    return SimpleNamespace(
        config=config,
        search=SimpleNamespace(chosen=list(chosen)),
        problem=SimpleNamespace(parts=[SimpleNamespace(drive=SimpleNamespace(name="monday"))]),
        finding="Something of this size: 12 ± 3 m/s, 40 % less.",
        details=("Held-out residual 100 N before, 60 N after.",),
    )


def written(text, *chosen, config=None, name="mine.yaml"):
    d = diagnosis(config or parse_config(text), *chosen)
    wanted = revised_config(d)
    return wanted, revised_text(d, wanted, text, name)


@pytest.fixture
def text():
    return (shipped("configs") / "class8.yaml").read_text(encoding="utf-8")


def test_the_users_text_is_kept_line_by_line(text):
    wanted, out = written(text, WIND, GEAR)
    lines = out.splitlines()
    kept = iter(lines)
    assert all(line in kept for line in text.splitlines()), "every line of the user's, in order"
    assert parse_config(out) == wanted
    assert [e["effect"] for e in wanted.effects] == ["headwind", "driveline_loss"]
    assert wanted.effects[1]["gear"] == 9
    assert lines[0].startswith("# mine.yaml as revised by `canest diagnose` from monday")
    assert any("headwind" in line and "± 0.026 m/s" in line and "93.0 %" in line for line in lines)


def test_values_are_rounded_to_what_is_known_of_them(text):
    wanted, _ = written(text, WIND)
    assert wanted.effects[0]["wind_mps"] == 6.4796


def test_effects_of_the_config_stay_and_come_first(text):
    own = "effects:\n  # summer tyres\n  - effect: rolling_resistance\n    crr_delta: 0.0004\n\n"
    own += "sampling: {hold_s: 3.0}\n"
    wanted, out = written(text + own, GAIN)
    assert [e["effect"] for e in wanted.effects] == ["rolling_resistance", "torque_gain"]
    again = parse_config(out)
    assert again == wanted and again.sampling.hold_s == 3.0


@pytest.mark.parametrize("inline", ["effects: []\n", "effects: [{effect: headwind, wind_mps: 1.0}]\n"])
def test_an_inline_list_of_effects_becomes_one_with_lines(text, inline):
    wanted, out = written(text + inline, GAIN)
    assert parse_config(out) == wanted and "gain: 0.92" in out


def test_a_load_brings_its_signal_and_unused_signals_stay_out(text):
    config = parse_config(text)
    more = {
        "estpercentfanspeed": FAN_SOURCE,
        "engoiltemp": Source(message="ET1", signal="EngOilTemp1", source=0),
    }
    config = config.model_copy(update={"signals": config.signals | more})
    wanted, out = written(text, FAN, config=config)
    assert "engoiltemp" not in wanted.signals
    assert parse_config(out).signals["estpercentfanspeed"] == FAN_SOURCE
    assert "# a learned mass belongs to" in out or "what a learned mass belongs to" in out, "comments survive"


@pytest.mark.parametrize("role", ["on", "12", "null", "fan: on", "# fan", "[kw] heat", "it's", "größe"])
@pytest.mark.parametrize("change", ["filter.cutoff_hz=2.0", "filter.cutoff_hz=1.5"])
def test_a_signal_of_any_name_survives_in_the_users_text_and_in_a_new_one(text, role, change):
    config = parse_config(text, overrides=[change])
    config = config.model_copy(update={"signals": config.signals | {role: FAN_SOURCE}})
    shape = (("signal", role), ("exponent", 3.0), ("threshold", 40.0))
    fan = Chosen(Candidate("switched_load", "switched_load", "power_kW", shape), 30.0, 1.0, 0.8)
    wanted, out = written(text, fan, config=config)
    assert parse_config(out) == wanted and wanted.signals[role] == FAN_SOURCE


def test_changes_by_the_command_line_are_in_the_result(text):
    config = parse_config(text, overrides=["filter.cutoff_hz=1.5", "estimator.name=rlsmf"])
    wanted, out = written(text, WIND, config=config)
    again = parse_config(out)
    assert again == wanted and again.filter.cutoff_hz == 1.5 and again.estimator.name == "rlsmf"
    sections = list(yaml.safe_load(out))
    assert sections == [s for s in type(wanted).model_fields if s in sections], "in the schema's order"


def test_nothing_found_leaves_the_config_as_it_was(text):
    wanted, out = written(text)
    assert wanted == parse_config(text) and out.endswith(text) and "Nothing was added" in out


def test_a_dbc_of_ones_own_is_found_from_anywhere(text, tmp_path, monkeypatch):
    shutil.copy(shipped("dbc") / "j1939.dbc", tmp_path / "own.dbc")
    monkeypatch.chdir(tmp_path)
    wanted, out = written(text.replace("dbc: [j1939.dbc]", "dbc: [own.dbc]"), WIND)
    assert wanted.dbc == (str(tmp_path / "own.dbc"),)
    assert parse_config(out) == wanted


def test_shipped_configs_all_survive():
    for path in sorted(shipped("configs").glob("*.yaml")):
        original = path.read_text(encoding="utf-8")
        wanted, out = written(original, WIND, GAIN, config=load_config(path))
        assert parse_config(out) == wanted, path.name
        assert original.splitlines()[0] in out
