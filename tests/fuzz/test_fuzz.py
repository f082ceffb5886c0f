"""The fuzz targets for seconds with fixed seeds, and every input that once did harm."""

from __future__ import annotations

from pathlib import Path

import pytest

from .engine import fuzz, run_one
from .targets import TARGETS

FOUND = Path(__file__).parent / "found"
SECONDS = 2.5


@pytest.mark.parametrize("name", TARGETS)
def test_a_few_seconds_of_random_mutations_find_nothing(name):
    assert "nothing found" in fuzz(TARGETS[name], SECONDS, seed=1)


@pytest.mark.parametrize("name", ["bam", "decoder", "pipeline"])
def test_seeds_do_get_through(name, monkeypatch):
    """A target whose frames nobody wants would find nothing for ever."""
    from canest.decode import Decoder

    heard, decode = set(), Decoder.decode

    def listening(self, block):
        result = decode(self, block)
        heard.update(result.samples)
        return result

    monkeypatch.setattr(Decoder, "decode", listening)
    for data in TARGETS[name].seeds():
        run_one(TARGETS[name], data)
    assert {"bam": {"reference_torque"}, "decoder": {"engine_speed"}, "pipeline": {"gear"}}[name] <= heard


@pytest.mark.parametrize("path", sorted(FOUND.glob("*-*")), ids=lambda p: p.name)
def test_what_once_did_harm_does_none(path):
    run_one(TARGETS[path.name.split("-")[0]], path.read_bytes())
