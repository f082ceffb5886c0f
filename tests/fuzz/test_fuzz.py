"""The fuzz targets for seconds with fixed seeds, and every input that once did harm."""

from __future__ import annotations

from pathlib import Path

import pytest

from .engine import fuzz, run_one
from .shrinking import fuzz_by_hypothesis
from .targets import TARGETS, all_targets

FOUND = Path(__file__).parent / "found"
SECONDS = 2.5


@pytest.mark.parametrize("name", TARGETS)
def test_a_few_seconds_of_random_mutations_find_nothing(name):
    assert "nothing found" in fuzz(TARGETS[name], SECONDS, seed=1)


@pytest.mark.parametrize("name", ["bam", "decoder", "pipeline"])
def test_seeds_do_get_through(name, monkeypatch):
    """A target whose frames nobody wants would find nothing for ever."""
    from canest.decode import Decoder

    received, decode = set(), Decoder.decode

    def listening(self, block):
        result = decode(self, block)
        received.update(result.samples)
        return result

    monkeypatch.setattr(Decoder, "decode", listening)
    for data in TARGETS[name].seeds():
        run_one(TARGETS[name], data)
    assert {"bam": {"reference_torque"}, "decoder": {"engine_speed"}, "pipeline": {"gear"}}[name] <= received


#: twice what an input may take: on a busy machine the same work takes more seconds of CPU
BUSY_CPU_S = 2.0


@pytest.mark.parametrize("path", sorted(FOUND.glob("*-*")), ids=lambda p: p.name)
def test_what_once_did_harm_does_none(path):
    target = all_targets()[path.name.split("-")[0]]
    target.run(next(iter(target.seeds())))  # imports what it needs, which takes longer than any input may
    run_one(target, path.read_bytes(), BUSY_CPU_S)


@pytest.mark.parametrize("name", sorted(all_targets().keys() - TARGETS.keys()))
def test_hypothesis_finds_nothing_in_a_second_of_one_parser(name):
    if name == "slcan":
        pytest.importorskip("serial")
    assert "nothing found" in fuzz_by_hypothesis(all_targets()[name], 1.0, first_seed=1)


def test_the_command_offers_every_target():
    from runpy import run_path

    names = run_path(str(Path(__file__).parents[2] / "benchmarks" / "fuzz.py"))["NAMES"]
    assert set(names) == all_targets().keys()
