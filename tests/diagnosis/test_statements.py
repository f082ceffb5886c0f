"""What a diagnosis reports: one short sentence, dangers first, and never more than the data shows."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from canest.diagnosis.entries import Entry
from canest.diagnosis.report.format import entry_value
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.choice import Chosen
from canest.diagnosis.search.evidence import (
    Evidence,
    errors_shown,
    likeliest_errors,
    likely_sets,
    without_idle_members,
)
from canest.diagnosis.search.fitted_sets import FittedSet
from canest.diagnosis.search.set_search import Search
from canest.diagnosis.sentences import MAX_WORDS, Context, by_urgency, statement_of
from canest.diagnosis.verdict import verdict_of
from canest.vehicle.effects import EFFECTS


def candidate(effect):
    return Candidate(effect, effect, EFFECTS[effect].fitted_parameter())


def chosen(effect, deviation, *equivalent):
    return Chosen(candidate(effect), deviation, 0.1, 0.5, equivalent=[candidate(e) for e in equivalent])


TYRES = chosen("rolling_resistance", 0.004, "headwind", "brake_drag")


def test_a_brake_that_may_drag_is_named_before_the_tyres_that_were_taken():
    statement = statement_of("explained", [TYRES], 1609.0, 57.0)
    assert statement.finding.startswith("A dragging brake, rolling resistance or wind explains the residual")
    assert any("a dragging brake" in line and "with another load" in line for line in statement.details)
    assert by_urgency(["headwind", "rolling_resistance", "brake_drag"])[0] == "brake_drag"


def test_a_pair_that_is_as_likely_is_named_beside_the_single_effect():
    wind = chosen("headwind", 9.0)
    pair = FittedSet([chosen("headwind", 5.0), chosen("brake_drag", 800.0)], 0.0, 0.0)
    statement = statement_of(
        "explained", [wind], 1500.0, 300.0, Context(rivals=[pair, FittedSet([wind], 3.0, 3.0)])
    )
    assert statement.finding.startswith("A dragging brake or wind explains")
    assert "About as likely: a dragging brake with wind." in statement.details


@pytest.mark.parametrize(
    ("effect", "deviation", "limit"),
    [
        ("headwind", 29.99, "30 m/s is the most that is tried"),
        ("headwind", -29.9, "-30 m/s is the least that is tried"),
        ("torque_gain", -0.6999, "0.3 is the least that is tried"),
        ("headwind", 25.0, ""),
        ("brake_drag", 20.0, ""),  # near the end that means none of it
    ],
)
def test_a_value_at_the_end_of_its_range_is_called_so(effect, deviation, limit):
    found = chosen(effect, deviation)
    details = statement_of("explained", [found], 1500.0, 300.0).details
    assert any("the true value may lie beyond it" in line for line in details) == bool(limit)
    assert any(limit in line for line in details)
    entry = Entry(found.candidate, deviation, 0.1, 0.5, 0.5, True, ())
    assert entry_value(entry).endswith("(end of range)") == bool(limit)


def test_a_cause_that_may_be_a_danger_is_named_first_wherever_it_was_found():
    statement = statement_of("explained", [chosen("headwind", 4.9), TYRES], 1637.0, 76.0)
    assert statement.finding.startswith("A dragging brake")


def test_each_choice_has_its_own_equivalents():
    statement = statement_of(
        "explained", [TYRES, chosen("torque_gain", -0.1, "driveline_loss")], 1500.0, 60.0
    )
    lines = [line for line in statement.details if "cannot separate it" in line]
    assert len(lines) == 2 and "driveline loss" in lines[1] and "driveline loss" not in lines[0]


@pytest.mark.parametrize("verdict", ["explained", "partly", "unexplained"])
def test_the_headline_has_one_sentence_of_few_words_and_no_numbers(verdict):
    many = [chosen(e, 0.01, "headwind", "brake_drag", "rolling_warmup", "torque_offset") for e in EFFECTS]
    for n in range(1, 6):
        finding = statement_of(verdict, many[:n], 1857.0, 1486.0, Context(hints=["FD.Fan"])).finding
        assert len(finding.split()) <= MAX_WORDS and finding.endswith(".") and finding.count(". ") == 0
        assert not any(letter.isdigit() for letter in finding)


@pytest.mark.parametrize("effects", [("wheel_radius", "drag_area"), ("torque_offset", "rotating_inertia")])
def test_no_cause_is_named_twice_where_one_effect_may_stand_for_both(effects):
    """It read: misreported torque or others, and misreported torque or others explain the residual."""
    rest = ("torque_gain", "driveline_loss", "rolling_resistance", "rolling_warmup")
    causes = [chosen(effect, 0.05, *rest) for effect in effects]
    finding = statement_of("partly", causes, 1857.0, 700.0).finding
    named = re.split(r", and | and | explain", finding.casefold())[:2]
    assert named[0] != named[1], finding
    assert len(finding.split()) <= MAX_WORDS


def test_a_late_torque_alone_names_no_other_cause():
    other = FittedSet([chosen("headwind", 1.0)], 0.0, 0.0)
    statement = statement_of(
        "explained", [chosen("torque_delay", 0.06)], 110.0, 60.0, Context(rivals=[other])
    )
    assert statement.finding == "Late torque explains the residual."


def verdict(before_N, after_N, wanders_N=0.0):
    n = 400
    problem = SimpleNamespace(
        weight_N=290_000.0, torque_step_N=4000.0, mass_known=True, rows=n, chunk=np.arange(n) // 8
    )
    left = wanders_N * np.where(np.arange(n) // 8 % 2, 1.0, -1.0)
    search = SimpleNamespace(chosen=[TYRES], residual_N=left)
    before, after = (SimpleNamespace(residual_rms_N=x) for x in (before_N, after_N))
    return verdict_of(problem, search, before, after)


def test_most_of_a_residual_that_is_left_is_never_called_explained():
    """A truck of 29.5 t whose torque steps are coarse: what is left hid in them, and was 80 % of it."""
    assert verdict(1857.0, 1486.0, wanders_N=200.0) in ("partly", "unexplained")
    assert verdict(5000.0, 400.0, wanders_N=200.0) == "explained"


def problem_of(wind_mps, brake_N, spread_mps=1.7, seed=1):
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(8.0, 25.0, 60), 6)
    wind, brake = -7.5 * speed / 80.0, -np.ones(len(speed)) / 80.0
    residual = -(wind_mps * wind + brake_N * brake) + rng.normal(size=len(speed))
    evidence = Evidence(spread_mps * wind[:, None], np.zeros((len(speed), 0)), 1.0, 1.0)
    names = [candidate("headwind"), candidate("brake_drag")]
    return without_idle_members(likely_sets(evidence, residual, names, [wind, brake]), 300.0)


def test_a_brake_and_a_wind_are_a_pair_where_their_speeds_part_them():
    assert problem_of(6.0, 800.0)[0].members == (0, 1)


def test_a_wind_as_it_always_blows_is_no_evidence_for_anything():
    assert problem_of(1.5, 0.0)[0].members == ()
    assert problem_of(9.0, 0.0)[0].members == (0,)


def test_evidence_comes_from_where_a_cause_acts():
    """One curve of a minute among twenty minutes of straight road."""
    rng = np.random.default_rng(2)
    bend = np.zeros(1200)
    bend[500:560] = -1.0
    residual = 1.5 * -bend + rng.normal(size=1200)
    evidence = Evidence(np.zeros((1200, 0)), np.ones((1200, 1)), 1.0, 1.0)
    best = likely_sets(evidence, residual, [candidate("cornering_drag")], [bend])[0]
    assert best.members == (0,) and best.values[0] == pytest.approx(1.5, abs=0.4)


def test_two_large_faults_that_undo_each_other_are_no_explanation():
    """Torque 17 % too low on wheels that are 9 % too small leave next to nothing: no truck is like that."""
    rng = np.random.default_rng(4)
    torque = rng.normal(size=400)
    radius = -2.0 * torque + 0.05 * rng.normal(size=400)  # a force that the gain nearly undoes
    residual = -(0.17 * torque + 0.09 * radius) * 40.0 + rng.normal(size=400)
    columns = [40.0 * torque, 40.0 * radius]
    evidence = Evidence(np.zeros((400, 0)), np.zeros((400, 0)), 1.0, 1.0)

    def best(*scales):
        names = [
            Candidate("gain", "torque_gain", "gain", scale=scales[0]),
            Candidate("radius", "wheel_radius", "factor", scale=scales[1]),
        ]
        return likely_sets(evidence, residual, names, columns)[0].members

    assert best(np.inf, np.inf) == (0, 1)
    assert best(0.04, 0.015) != (0, 1)


def test_what_a_drive_cannot_rule_out_is_said_dangers_first():
    context = Context(not_excluded=["headwind", "brake_drag"], usual=True)
    statement = statement_of("partly", [chosen("torque_gain", -0.1)], 1600.0, 500.0, context)
    assert statement.details[-1] == "Not ruled out in the size of an ordinary fault: a dragging brake, wind."
    assert statement.finding.endswith("the rest is within usual errors.")
    assert not any("Not ruled out" in d for d in statement_of("partly", [TYRES], 9.0, 5.0).details)


def test_one_effect_that_explains_all_may_not_be_alone():
    """A brake of 1,235 N and tyres worse with speed: the second looked like the wind that always blows."""
    context = Context(not_excluded=["rolling_resistance_speed", "headwind", "rolling_resistance"])
    brake = chosen("brake_drag", 1394.0, "rolling_resistance")
    finding = statement_of("explained", [brake], 1640.0, 324.0, context).finding
    assert finding == (
        "A dragging brake or rolling resistance explains the residual; "
        "wind or speed-dependent rolling resistance may be there besides."
    )
    assert "besides" not in statement_of("partly", [brake], 1640.0, 900.0, context).finding
    two = [brake, chosen("torque_gain", -0.1)]
    assert "besides" not in statement_of("explained", two, 1640.0, 324.0, context).finding


def gears_of(gears, strength, seed=5):
    """Return the best set where one gear of several has a loss, each in windows of its own."""
    rng = np.random.default_rng(seed)
    place = np.arange(400) % gears
    columns = [np.where(place == g, -10.0, 0.0) for g in range(gears)]
    noise = rng.normal(size=400)
    noise -= sum(column * (column @ noise) / (column @ column) for column in columns)
    residual = strength / np.sqrt(columns[0] @ columns[0]) * -columns[0] + noise
    evidence = Evidence(np.zeros((400, 0)), np.zeros((400, 0)), 1.0, 1.0)
    names = [
        Candidate(f"driveline_loss gear {g}", "driveline_loss", "loss", (("gear", g),)) for g in range(gears)
    ]
    return likely_sets(evidence, residual, names, columns)


def test_the_best_of_many_gears_is_judged_as_one_of_many():
    """A loss of 1.8 % in gear 8 of a drive without any: among its gears one was likely to look so."""
    one, ten = gears_of(1, 3.0), gears_of(10, 3.0)
    single = next(s for s in ten if s.members == (0,))
    assert one[0].members == (0,) and one[0].forms == 0.0
    # nine gears without any evidence: the tenth is worth a tenth, and what they have by chance
    assert single.forms == pytest.approx(2.0 * np.log(10.0), abs=0.4)
    assert ten[0].members == () and gears_of(10, 6.0)[0].members == (0,)


def test_forms_of_one_effect_that_fit_alike_cost_nothing():
    """Cold tyres that warm up in 300 or in 600 s: whichever it is, it is the tyres."""
    column = -1000.0 * np.exp(-np.arange(400) / 300.0)
    evidence = Evidence(np.zeros((400, 0)), np.zeros((400, 0)), 1.0, 1.0)
    names = [
        Candidate(f"rolling_warmup tau {s} s", "rolling_warmup", "crr_cold", (("tau_s", s),))
        for s in (300.0, 300.1)
    ]
    residual = -0.003 * column + np.random.default_rng(1).normal(size=400)
    best = likely_sets(evidence, residual, names, [column, column])[0]
    assert len(best.members) == 1 and best.forms == pytest.approx(0.0, abs=1e-6)


def errors_of(wind_mps, crr, seed=3):
    """Return small errors (n, 2), a residual (n,) with these, and a drag area's column (n, 1) beside them."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(8.0, 25.0, 350)
    columns = np.column_stack([1.7 * speed / 2.0, 12.0 * np.ones(350)])
    residual = -columns @ (wind_mps / 1.7, crr) + 0.6 * rng.normal(size=350)
    return columns, residual, speed[:, None] ** 2 / 25.0


def test_a_small_error_that_the_drive_does_not_show_takes_no_part_in_the_values():
    nothing = np.zeros(2, np.bool_)
    assert errors_shown(*errors_of(0.0, 0.0), 0.36, nothing).tolist() == [False, False]
    assert errors_shown(*errors_of(2.5, 0.0), 0.36, nothing).tolist() == [True, False]
    assert errors_shown(*errors_of(0.0, 0.0), 0.36, np.array([False, True])).tolist() == [False, True]


def test_how_large_a_small_error_is_comes_out_in_its_usual_spreads():
    size, std = likeliest_errors(*errors_of(5.0, 0.0), 0.36)
    assert size[0] == pytest.approx(5.0 / 1.7, abs=0.2) and size[0] - std[0] > 2.0
    assert abs(likeliest_errors(*errors_of(1.5, 0.0), 0.36)[0][0]) < 1.2


@pytest.mark.parametrize(
    ("effect", "deviation", "std", "needed", "force_N", "evident"),
    [
        ("torque_offset", 13.7, 23.0, 0.21, 118.0, False),  # what a step of the reported torque hides
        ("retarder_unreported", 24.0, 13.7, 0.0, 40.0, False),  # too small to notice
        ("cornering_drag", 0.0345, 0.0368, 0.23, 400.0, True),  # uncertain, and not small
        ("torque_gain", -0.08, 0.02, 0.01, 900.0, True),  # of no use out of sample
    ],
)
def test_what_is_dropped_for_being_small_leaves_nothing_to_explain(
    effect, deviation, std, needed, force_N, evident
):
    """Three clean drives of sixty were called unexplained for a rounding of torque."""
    search = object.__new__(Search)
    dropped = replace(chosen(effect, deviation), std=std, needed=needed, force_N=force_N)
    search.chosen, search.evident = [dropped], False
    search.problem = SimpleNamespace(torque_step_N=196.0)
    search.weigh = search.refit = lambda: None  # the values are those above
    search._prune()
    assert search.chosen == [] and search.evident is evident
