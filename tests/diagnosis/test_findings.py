"""What is found, on simulated drives whose config does not know the effect."""

import gzip
import json

import pytest

from canest.cli.main import run
from canest.config import load_config
from canest.diagnosis.sentences import Context, statement_of


def equivalents(document, effect):
    return next(set(c["equivalent"]) for c in document["candidates"] if c["effect"] == effect)


def value(document, effect, name):
    return next(c["parameters"][name]["value"] for c in document["candidates"] if c["effect"] == effect)


def test_a_dragging_brake_at_constant_mass_is_also_a_rolling_resistance(drive, found):
    document = found(drive({"effect": "brake_drag", "force_N": 800.0}), "--truth", "auto")
    first = document["selected"][0]
    same = {first} | equivalents(document, first)
    assert {"brake_drag", "rolling_resistance"} <= same
    assert value(document, "brake_drag", "force_N") == pytest.approx(800, rel=0.15)
    # the same force by the other name: 800 N on 21.25 t
    assert value(document, "rolling_resistance", "crr_delta") == pytest.approx(800 / 21250 / 9.81, rel=0.15)
    assert (
        "a dragging brake" in document["finding"].lower()
        and "rolling resistance" in document["finding"].lower()
    )
    assert any("cannot separate it from" in line for line in document["details"])


@pytest.mark.parametrize("known", [("--truth", "auto"), ("--mass", "21250")])
def test_a_brake_beside_a_wind_is_named_in_the_first_sentence(drive, found, diagnosed, known):
    log = drive({"effect": "brake_drag", "force_N": 800.0}, {"effect": "headwind", "wind_mps": 5.0})
    document = found(log, *known)
    assert "dragging brake" in document["finding"].lower() and len(document["finding"].split()) <= 25
    head = (diagnosed(log, *known) / "revised.yaml").read_text("utf-8").split("\n\n")[0]
    assert "dragging brake" in head.lower()
    assert document["steps"][-1]["residual_rms_N"] == document["after"]["residual_rms_N"]
    assert document["models"]


@pytest.mark.parametrize("known", [("--truth", "auto"), ("--mass", "21250")])
def test_a_drive_with_nothing_undeclared_has_nothing_to_explain(drive, found, known):
    document = found(drive(seed=5), *known)
    assert document["selected"] == [] and document["verdict"] == "nothing-to-explain"
    assert "nothing to add" in document["finding"]
    assert document["after"] == document["baseline"]


def test_the_delay_that_every_engine_has_is_a_line_and_no_finding(drive, found):
    """Every simulated engine reports 60 ms late."""
    document = found(drive(seed=5), "--truth", "auto")
    late = next(line for line in document["details"] if "late, as engines do" in line)
    assert float(late.split("delay_s: ")[1].rstrip("}.")) == pytest.approx(0.06, abs=0.02)
    assert (
        "torque_delay"
        in found(drive({"effect": "torque_delay", "delay_s": 0.2}), "--truth", "auto")["selected"]
    )


def test_small_errors_as_every_vehicle_has_them_are_nothing_to_explain(drive, found):
    """Torque within 2 %, wind within 3 m/s, tyres within 15 %, some slip: 400 N and more of residual."""
    for seed in (2, 7):
        document = found(drive(seed=seed, small_errors=True, duration_s=400), "--truth", "auto")
        assert document["selected"] == [] and document["verdict"] == "nothing-to-explain"


def test_a_drive_without_even_a_delay_has_nothing_to_explain(drive, found, diagnosed):
    log = drive(seed=6, sensors={"torque_delay_s": 0.0})
    document = found(log, "--truth", "auto")
    assert document["selected"] == [] and document["verdict"] == "nothing-to-explain"
    assert document["baseline"] == document["after"]
    revised = load_config(diagnosed(log, "--truth", "auto") / "revised.yaml")
    assert revised == load_config(log.with_suffix(".yaml"))


def test_shares_of_selected_effects_and_of_others_alone_are_of_one_measure(drive, found):
    """A rolling resistance at one mass does what a dragging brake does, and removes what that does."""
    document = found(drive({"effect": "brake_drag", "force_N": 800.0}), "--truth", "auto")
    share = {c["effect"]: c["explained"] for c in document["candidates"]}
    assert document["selected"][0] in ("brake_drag", "rolling_resistance")
    assert share["brake_drag"] == pytest.approx(share["rolling_resistance"], abs=0.1)


def test_what_an_effect_alone_would_do_is_reported_where_nothing_is_selected(drive, found):
    document = found(drive(seed=6, sensors={"torque_delay_s": 0.0}), "--truth", "auto")
    assert document["selected"] == []
    assert max(c["score"] for c in document["candidates"]) > 0.001


def test_effects_that_are_hidden_by_the_torque_s_rounding_are_not_called_no_explanation():
    text = " ".join(statement_of("unexplained", [], 146.0, 146.0, Context(hidden_N=104.0)).details)
    assert "below 104 N" in text and "one of the known effects" not in text
    assert "None of the known effects" in statement_of("unexplained", [], 146.0, 146.0).details[1]


def test_drafting_is_not_in_the_vocabulary_and_is_not_called_explained(drive, found):
    document = found(drive({"effect": "drafting", "reduction": 0.5, "period_s": 40.0}), "--truth", "auto")
    assert document["verdict"] in ("partly", "unexplained")
    assert document["after"]["residual_rms_N"] > 200


def test_drives_of_different_load_part_what_one_drive_cannot(drive, found):
    brake = {"effect": "brake_drag", "force_N": 800.0}
    logs = [drive(brake), drive(brake, seed=2, mass_kg=36000), drive(brake, seed=3, mass_kg=11000)]
    document = found(*logs, "--truth", "auto")
    assert document["data"]["drives"] == 3
    assert document["selected"][0] == "brake_drag"
    assert "rolling_resistance" not in equivalents(document, "brake_drag")
    assert value(document, "brake_drag", "force_N") == pytest.approx(800, rel=0.1)


def test_a_recording_of_the_daemon_is_pooled_in_the_order_of_its_segments(drive, found, tmp_path):
    gain = {"effect": "torque_gain", "gain": 0.9}
    log = drive(gain, seed=3)
    lines = log.read_bytes().splitlines(keepends=True)
    half = len(lines) // 2
    for name, part in (("20260102T030405Z-can0", lines[:half]), ("20260102T031905Z-can0", lines[half:])):
        (tmp_path / f"{name}.log.gz").write_bytes(gzip.compress(b"".join(part), 1))
    config, out = str(log.with_suffix(".yaml")), tmp_path / "out"
    arguments = ["diagnose", "--recorded", str(tmp_path), "-c", config, "--mass", "21250", "-o", str(out)]
    assert run(arguments) == 0
    document = json.loads((out / "diagnosis.json").read_text("utf-8"))
    assert [log.split("/")[-1][:16] for log in document["data"]["logs"]] == [
        "20260102T030405Z",
        "20260102T031905Z",
    ]
    assert document["reference"]["mass_known"] and document["reference"]["kind"] != "truth"


def test_a_truth_of_another_time_is_no_reason_to_find_anything(drive, tmp_path, capsys):
    truth = tmp_path / "other.csv"
    truth.write_text("t_s,grade,mass_kg\n1e6,0.1,21250\n1e7,0.2,21250\n")
    log = drive({"effect": "torque_gain", "gain": 0.9}, seed=3)
    arguments = [log, "-c", log.with_suffix(".yaml"), "--truth", truth, "-o", tmp_path / "out"]
    assert run(["diagnose", *map(str, arguments)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(
        f"error: {truth}: does not overlap the drive in time, expected mass_kg or grade between"
    )
    assert not (tmp_path / "out").exists()


def test_one_interface_of_a_log_is_diagnosed_as_if_it_were_alone(drive, found, tmp_path):
    log = drive({"effect": "torque_gain", "gain": 0.9}, seed=3)
    lines = log.read_text().splitlines(keepends=True)
    other = [line.replace(" can0 ", " can1 ") for line in lines[len(lines) // 2 :]]
    both = tmp_path / "both.log"
    both.write_text("".join(sorted([*lines, *other], key=lambda line: float(line[1:18]))))
    out, config = tmp_path / "out", log.with_suffix(".yaml")
    arguments = [both, "-c", config, "--mass", "21250", "--channel", "can0", "-o", out]
    assert run(["diagnose", *map(str, arguments)]) == 0
    document, alone = json.loads((out / "diagnosis.json").read_text("utf-8")), found(log, "--mass", "21250")
    assert (
        document["candidates"] == alone["candidates"]
        and document["unused_signals"] == alone["unused_signals"]
    )
    assert document["data"]["notes"] == {}


def test_what_the_truth_does_not_cover_takes_no_part(drive, found, tmp_path):
    log = drive({"effect": "torque_gain", "gain": 0.9}, seed=3)
    header, *rows = log.with_suffix(".truth.csv").read_text().splitlines()
    truth = tmp_path / "most.csv"
    truth.write_text("\n".join([header, *rows[: 2 * len(rows) // 3]]) + "\n")
    part, whole = found(log, "--truth", truth), found(log, "--truth", "auto")
    assert part["data"]["open_s"] < 0.75 * whole["data"]["open_s"]
    assert part["selected"][0] == whole["selected"][0] == "torque_gain"
    assert value(part, "torque_gain", "gain") == pytest.approx(0.9, abs=0.02)


def test_logs_that_cannot_be_used_are_named_and_the_others_diagnosed(drive, tmp_path, capsys):
    broken, idle, out = tmp_path / "broken.log", tmp_path / "idle.log", tmp_path / "out"
    broken.write_text("this is no candump\n" * 50)
    idle.write_text("(1700000000.000000) can0 0CF00400#FFFFFFFFFFFFFFFF\n" * 50)
    log = drive({"effect": "torque_gain", "gain": 0.9}, seed=3)
    arguments = [log, broken, idle, "-c", log.with_suffix(".yaml"), "--mass", "21250", "-o", out]
    assert run(["diagnose", *map(str, arguments)]) == 1
    document, printed = json.loads((out / "diagnosis.json").read_text("utf-8")), capsys.readouterr()
    assert document["data"]["drives"] == 1 and len(document["data"]["left_out"]) == 2
    assert printed.err.startswith(f"error: {broken}: nothing to read") and printed.err.count("\n") == 1
    assert f"left out: {idle}: is too short" in printed.out


def test_when_no_log_can_be_used_all_are_named(tmp_path, capsys):
    broken, missing = tmp_path / "broken.log", tmp_path / "missing.log"
    broken.write_text("this is no candump\n" * 50)
    arguments = [broken, missing, "-c", "kenworth", "-o", tmp_path / "out"]
    assert run(["diagnose", *map(str, arguments)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and str(broken) in error and str(missing) in error


def test_a_broken_log_beside_too_little_driving_is_not_forgotten(tmp_path, capsys):
    broken = tmp_path / "broken.log"
    broken.write_text("this is no candump\n" * 50)
    bike = "tests/data/ip332/bike.log.xz"
    assert run(["diagnose", bike, str(broken), "-c", "kenworth", "-o", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr()
    assert "too little driving" in printed.out and printed.err.startswith(f"error: {broken}: nothing")


EFFECTS = [
    ({"effect": "headwind", "wind_mps": 7.0}, "headwind", "wind_mps", 7.0),
    ({"effect": "rolling_resistance", "crr_delta": 0.0024}, "rolling_resistance", "crr_delta", 0.0024),
    ({"effect": "drag_area", "cda_delta_m2": 2.0}, "drag_area", "cda_delta_m2", 2.0),
    ({"effect": "torque_offset", "torque_Nm": 100.0}, "torque_offset", "torque_Nm", 100.0),
    ({"effect": "wheel_radius", "factor": 0.965}, "wheel_radius", "factor", 0.965),
    ({"effect": "torque_delay", "delay_s": 0.2}, "torque_delay", "delay_s", 0.26),
]


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "name", "parameter", "expected"), EFFECTS, ids=[e[1] for e in EFFECTS])
def test_each_effect_is_found_first_or_declared_equivalent(drive, found, effect, name, parameter, expected):
    document = found(drive(effect, seed=8, duration_s=400), "--truth", "auto")
    first = document["selected"][0]
    assert name in {first} | equivalents(document, first)
    neutral = 1.0 if name == "wheel_radius" else 0.0
    assert value(document, name, parameter) - neutral == pytest.approx(expected - neutral, rel=0.15)


@pytest.mark.slow
def test_what_is_reported_late_is_compared_with_the_road_of_the_same_moment(
    drive, found, diagnosed, tmp_path
):
    log = drive({"effect": "torque_delay", "delay_s": 0.2}, seed=8, duration_s=400)
    document = found(log, "--truth", "auto")
    # 0.26 s at 25 m/s are 6 m of a road whose slope changes by a percent in 10 m: more than 100 N
    assert document["after"]["residual_rms_N"] < 80
    revised = diagnosed(log, "--truth", "auto") / "revised.yaml"
    arguments = ["diagnose", log, "-c", revised, "--truth", "auto", "-o", tmp_path / "again"]
    assert run(list(map(str, arguments))) == 0
    again = json.loads((tmp_path / "again" / "diagnosis.json").read_text("utf-8"))
    assert again["selected"] == [] and again["baseline"]["residual_rms_N"] < 80
    # what halves the residual more than once removes most of its variance
    assert (
        document["candidates"][0]["effect"] == "torque_delay" and document["candidates"][0]["explained"] > 0.9
    )


def test_torque_measured_at_the_half_shafts_excludes_the_crank(drive, found):
    log = drive(
        {"effect": "rolling_resistance", "crr_delta": 0.004},
        vehicle="electric-car", mass_kg=1500, driver={"kind": "mixed"}, duration_s=120,
    )  # fmt: skip
    document = found(log, "--truth", "auto")
    assert document["selected"][0] == "rolling_resistance"
    crank = {"torque_gain", "torque_offset", "torque_delay", "rotating_inertia", "retarder_unreported"}
    assert crank <= set(document["not_tried"])
    assert not crank & {name for c in document["candidates"] for name in c["equivalent"]}


def test_what_no_vehicle_can_be_like_is_no_alternative(drive, found):
    document = found(drive({"effect": "headwind", "wind_mps": -6.0}), "--truth", "auto")
    assert document["selected"][0] == "headwind"
    # a brake that pushes, tyres that roll by themselves when cold
    impossible = {"brake_drag", "rolling_warmup"}
    assert not impossible & equivalents(document, "headwind")
    assert all(c["explained"] == 0 for c in document["candidates"] if c["effect"] in impossible)


def test_an_effect_is_described_by_the_parameters_of_the_vocabulary(drive, found):
    document = found(drive({"effect": "headwind", "wind_mps": -6.0}), "--truth", "auto")
    slip = next(c for c in document["candidates"] if c["effect"] == "wheel_slip")
    assert set(slip["parameters"]) == {"slip_per_mps2"} and slip["settings"] == {"mass_kg": 21250.0}


def test_an_unknown_mass_that_an_effect_goes_by_is_stated_in_whole_kilograms(drive, found):
    document = found(drive(seed=5))
    slip = next(c for c in document["candidates"] if c["effect"] == "wheel_slip")
    assert slip["settings"]["mass_kg"].is_integer()


@pytest.mark.parametrize("reference", [("--mass", "19000"), ()])
def test_a_load_that_changed_in_a_stop_is_no_loss_of_torque(drive, found, reference):
    log = drive(
        {"effect": "payload_change", "mass_delta_kg": 8000, "t_s": 260},
        seed=7, duration_s=600, mass_kg=19000, road={"kind": "highway", "grade_max": 0.03},
        driver={"kind": "stop-and-go", "long_stops": [[240, 75]]},
    )  # fmt: skip
    document = found(log, *reference)
    assert document["selected"][0] == "payload_change"
    assert value(document, "payload_change", "mass_delta_kg") == pytest.approx(8000, rel=0.05)
    assert value(document, "payload_change", "t_s") - 1.7e9 == pytest.approx(277.5, abs=15)
    contradicted = any("given mass is constant, and a changed load" in line for line in document["details"])
    assert contradicted == bool(reference)
    assert document["after"]["residual_rms_N"] < 0.2 * document["baseline"]["residual_rms_N"]
    assert document["verdict"] == "explained"


@pytest.mark.slow
def test_a_load_that_came_and_went_is_no_loss_of_torque_either(drive, found):
    loads = [(260, 12_000), (500, -17_000)]
    log = drive(
        *({"effect": "payload_change", "mass_delta_kg": kg, "t_s": t_s} for t_s, kg in loads),
        seed=7, duration_s=760, mass_kg=19000, road={"kind": "highway", "grade_max": 0.03},
        driver={"kind": "stop-and-go", "long_stops": [[240, 75], [480, 75]]},
    )  # fmt: skip
    document = found(log, "--mass", "19000")
    changes = [
        c["parameters"] for c in document["candidates"] if c["effect"] == "payload_change" and c["selected"]
    ]
    for at_s, kg in loads:
        [found_kg] = [c["mass_delta_kg"] for c in changes if abs(c["t_s"]["value"] - 1.7e9 - at_s) < 40]
        assert abs(found_kg["value"] - kg) < 3 * found_kg["std"] < 0.1 * abs(kg)
    assert "torque_gain" not in document["selected"] and document["verdict"] == "explained"


def test_a_given_mass_far_from_the_estimate_is_the_first_thing_to_check(drive, found):
    """A wrong --mass was explained by a torque of 0.57 times the reported one, without a word."""
    log = drive(seed=5)
    first = found(log, "--mass", "12000")["details"][0]
    assert "heavier than the given mass" in first and "if the mass is wrong, all of this is" in first
    assert not any("given mass" in line for line in found(log, "--mass", "21250")["details"])
