"""The command from outside: files, keys, exit codes, one-line errors."""

import json
from types import SimpleNamespace

import pytest

from canest import __version__
from canest.cli.diagnose import show
from canest.cli.main import run
from canest.config import load_config
from canest.diagnosis.entries import Entry
from canest.diagnosis.search.candidates import Candidate
from canest.vehicle.effects import EFFECTS

VERDICTS = {"explained", "partly", "unexplained", "nothing-to-explain"}
KENWORTH = "tests/data/kenworth/normal.log.xz"
GAIN = {"effect": "torque_gain", "gain": 0.90}
SCORES = ("residual_rms_N", "mass_kg", "mass_error_pct", "mass_rms_pct", "grade_rms_deg")


@pytest.fixture(scope="module")
def gain(drive):
    return drive(GAIN, seed=3)


@pytest.fixture(scope="module")
def out(gain, diagnosed):
    return diagnosed(gain, "--truth", "auto")


@pytest.fixture(scope="module")
def document(out):
    return json.loads((out / "diagnosis.json").read_text("utf-8"))


def test_the_json_has_the_contracts_keys_and_types(document):
    for side in ("baseline", "after"):
        row = document[side]
        for key in SCORES:
            assert isinstance(row[key], float), key
            low, high = row["interval_95"].get(key, (row[key], row[key]))
            assert low <= row[key] <= high, key
    assert document["verdict"] in VERDICTS
    assert isinstance(document["finding"], str) and "\n" not in document["finding"]
    names = {c["effect"] for c in document["candidates"]}
    assert set(document["selected"]) <= names <= set(EFFECTS)
    assert set(document["not_tried"]) == set(EFFECTS) - names
    for c in document["candidates"]:
        assert 0.0 <= c["explained"] <= 1.0
        assert set(c["equivalent"]) <= set(EFFECTS) - {c["effect"]}
        fitted = [p for p in c["parameters"].values() if p["std"] is not None]
        assert len(fitted) == 1 and fitted[0]["std"] > 0
        for name, p in c["parameters"].items():
            assert set(p) == {"value", "std", "unit"}, name


def test_the_json_says_which_canest_and_which_config_made_it(document, gain, tmp_path):
    assert document["canest"] == __version__
    assert document["config"] == str(gain.with_suffix(".yaml"))
    assert run(["diagnose", "tests/data/ip332/bike.log.xz", "-c", "kenworth", "-o", str(tmp_path)]) == 0
    empty = json.loads((tmp_path / "diagnosis.json").read_text("utf-8"))
    assert (empty["canest"], empty["config"]) == (__version__, "kenworth")


def test_candidates_come_best_first_and_the_selected_ones_lead(document):
    scores = [c["score"] for c in document["candidates"]]
    assert scores == sorted(scores, reverse=True)
    first = [c["effect"] for c in document["candidates"]][: len(document["selected"])]
    assert first == document["selected"]


def test_the_planted_gain_is_found_with_its_value(document):
    assert document["verdict"] == "explained"
    assert document["selected"][0] == "torque_gain"
    gain = document["candidates"][0]["parameters"]["gain"]
    assert gain["value"] == pytest.approx(0.90, abs=0.015)
    assert abs(gain["value"] - 0.90) < 6 * gain["std"]
    assert document["after"]["residual_rms_N"] < 0.5 * document["baseline"]["residual_rms_N"]
    assert document["after"]["mass_rms_pct"] < 0.5 * document["baseline"]["mass_rms_pct"]


def test_the_revised_config_repairs_another_drive(gain, out, drive, tmp_path):
    other = drive(GAIN, seed=4, mass_kg=17000)
    errors = {}
    for name, config in (("before", gain.with_suffix(".yaml")), ("after", out / "revised.yaml")):
        summary = tmp_path / f"{name}.json"
        arguments = ["replay", str(other), "-c", str(config), "--truth", "auto", "--json", str(summary)]
        assert run(arguments) == 0
        errors[name] = json.loads(summary.read_text())["errors"]["mass_rms_pct"]
    assert errors["before"] > 5.0
    assert errors["after"] < 0.4 * errors["before"]


def test_the_revised_config_is_the_old_one_with_effects(gain, out):
    old, new = load_config(gain.with_suffix(".yaml")), load_config(out / "revised.yaml")
    assert new.effects and new.model_copy(update={"effects": old.effects}) == old


def test_the_report_stands_alone_and_has_the_finding(out, document):
    html = (out / "report.html").read_text("utf-8")
    assert document["finding"].split(":")[0] in html
    assert "src=" not in html.split("<main>")[1] and "torque_gain" in html
    for heading in ("Before and after", "What explains it", "against its cause", "Every effect tried"):
        assert heading in html, heading


def test_a_log_of_half_a_minute_is_too_short_for_a_candidate(tmp_path, capsys):
    assert run(["diagnose", KENWORTH, "-c", "kenworth", "-o", str(tmp_path)]) == 0
    document = json.loads((tmp_path / "diagnosis.json").read_text("utf-8"))
    assert (
        document["verdict"] == "nothing-to-explain"
        and document["selected"] == []
        and document["candidates"] == []
    )
    assert "s with open gates" in document["finding"] and document["finding"] in capsys.readouterr().out
    assert document["baseline"]["residual_rms_N"] > 0
    assert load_config(tmp_path / "revised.yaml") == load_config("kenworth")


@pytest.mark.parametrize("config", ["kenworth", "class8"])  # class8 finds an altitude, and no speed
def test_a_log_without_open_gates_has_that_finding(config, tmp_path, capsys):
    assert run(["diagnose", "tests/data/ip332/bike.log.xz", "-c", config, "-o", str(tmp_path)]) == 0
    document = json.loads((tmp_path / "diagnosis.json").read_text("utf-8"))
    assert document["verdict"] == "nothing-to-explain" and document["baseline"]["residual_rms_N"] is None
    assert "too little driving" in document["finding"] and document["finding"] in capsys.readouterr().out
    assert load_config(tmp_path / "revised.yaml") == load_config(config)
    assert document["finding"].split("`")[0] in (tmp_path / "report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["-c", "kenworth"], 2, "nothing to diagnose"),
        ([KENWORTH], 2, "--config"),
        ([KENWORTH, "-c", "kenworth", "--mass", "21.25"], 2, "--mass"),  # tonnes
        ([KENWORTH, "-c", "kenworth", "--mass", "-3"], 2, "expected a number from 50 kg on"),
        ([KENWORTH, KENWORTH, "-c", "kenworth", "--truth", "x.csv"], 2, "auto"),
        ([KENWORTH, "-c", "no-such"], 2, "no-such"),
        ([KENWORTH, "-c", "kenworth", "--truth", "auto"], 1, "truth.csv"),
        (["missing.log", "-c", "kenworth"], 1, "missing.log"),
        (["--recorded", "missing", "-c", "kenworth"], 1, "missing"),
    ],
)
def test_mistakes_are_one_line(arguments, code, says, tmp_path, capsys):
    assert run(["diagnose", *arguments, "-o", str(tmp_path / "out")]) == code
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and says in error
    assert not (tmp_path / "out").exists()


def test_a_directory_that_cannot_be_made_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(["diagnose", KENWORTH, "-c", "kenworth", "-o", str(tmp_path / "file" / "out")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("signal", ["fan [/min]", "fan [kW]", "[bold]"])
def test_a_bracket_in_a_signals_name_is_printed(signal, capsys):
    shape = (("signal", signal), ("exponent", 0.0), ("threshold", 0.5))
    candidate = Candidate("switched_load", "switched_load", "power_kW", shape)
    nothing = SimpleNamespace(**dict.fromkeys(SCORES))
    diagnosis = SimpleNamespace(
        finding=f"Load of {signal}.", details=(), verdict="explained", before=nothing, after=nothing,
        references=[SimpleNamespace(text="known grade")],
        problem=SimpleNamespace(parts=[None], mass_known=True, rows=9),
    )  # fmt: skip
    show(diagnosis, [Entry(candidate, 30.0, 1.0, 0.8, 0.8, True, ())])
    assert f"(signal {signal})" in capsys.readouterr().out


def test_help_teaches(capsys):
    assert run(["diagnose", "--help"]) == 0
    text = capsys.readouterr().out
    for word in ("--truth", "--mass", "--recorded", "revised.yaml", "canest replay"):
        assert word in text


def test_a_folder_that_cannot_be_made_is_named_before_the_work(gain, tmp_path, monkeypatch, capsys):
    def work(*_, **__):
        raise AssertionError("minutes of work")

    monkeypatch.setattr("canest.diagnosis.run.diagnose", work)
    (tmp_path / "file").touch()
    config = gain.with_suffix(".yaml")
    assert run(["diagnose", str(gain), "-c", str(config), "-o", str(tmp_path / "file" / "found")]) == 1
    assert "cannot make the directory" in capsys.readouterr().err
