"""Verdicts: what stands beside a statistic is what a reader can act on."""

from __future__ import annotations

import math

import pytest

from canest.report import verdicts


@pytest.mark.parametrize(
    ("verdict", "tone", "words"),
    [
        (verdicts.of_runs(-7.8), "bad", "keep their sign too long: an effect is missing; canest diagnose"),
        (verdicts.of_runs(0.7), "good", "no effect is seen to be missing"),
        (verdicts.of_runs(7.8), "warn", "change sign too often"),
        (verdicts.of_runs(math.nan), "", "too few"),
        (verdicts.of_correlation(0.6), "warn", "the model lacks something slow"),
        (verdicts.of_correlation(0.02), "good", "nothing systematic"),
        (verdicts.of_correlation(-0.6), "warn", "shifted in time"),
        (verdicts.of_nis(3.1), "bad", "too narrow"),
        (verdicts.of_nis(1.0), "good", "can be trusted"),
        (verdicts.of_nis(0.2), "", "wider than needed"),
        (verdicts.of_residual(300.0, 200e3), "good", "a slope of 0.1 %"),
        (verdicts.of_residual(6000.0, 200e3), "warn", "check wheel radius"),
        (verdicts.of_residual(300.0, 0.0), "", "no mass"),
        (verdicts.of_mass_error(1.6, 1.3), "good", "the band holds"),
        (verdicts.of_mass_error(5.0, 1.0), "bad", "too narrow"),
        (verdicts.of_count(10), "warn", "with care"),
    ],
)
def test_a_statistic_has_a_sentence_and_a_tone(verdict, tone, words):
    assert verdict.tone == tone
    assert words in verdict.text


def summary(**changes):
    gates = {"brake": 6000, "shift": 100}
    known = {"status": "converging", "updated": 2000, "samples": 10_000, "gates": gates,
             "mass_kg": 20_000.0, "mass_std_kg": 2000.0}  # fmt: skip
    return known | changes


def test_a_mass_that_is_not_valid_has_its_reasons():
    text = " ".join(verdicts.why_not_valid(summary()))
    assert "learned from 40 s of driving, standard deviation 10.0 % of the mass" in text
    assert "The gate brake (braking) took 60 % of the time" in text
    assert "What helps" in text


def test_a_valid_mass_has_none_and_a_missing_one_that_of_the_summary():
    assert verdicts.why_not_valid(summary(status="valid")) == []
    text = verdicts.why_not_valid(summary(status="unestimated", reason="the log is empty"))
    assert text == ["At the end there is no estimate: the log is empty."]
