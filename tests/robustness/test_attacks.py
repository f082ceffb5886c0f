"""Real attacks and full-load noise in a drive whose mass is valid: the mass stays, the counters show it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config
from canest.core.frames import FrameBlock
from canest.logs.format_detection import open_log
from canest.pipeline.pipeline import Pipeline
from canest.simulation.reading import load_scenario
from canest.simulation.run import simulate

from .attacks import (
    FULL_LOAD_PER_S,
    MINUTE_S,
    assert_sane,
    attack_frames,
    deviation_pct,
    estimated,
    identifiers,
    merged,
    noise,
)

pytestmark = pytest.mark.usefixtures("compiled")

KENWORTH = Path(__file__).parents[1] / "data" / "kenworth"
TSC1_PGN, CLAIM_PGN = 0x0000, 0xEE00
MOST_PCT = 2.0  #: a valid mass may change by this much


@pytest.fixture(scope="module")
def config():
    return load_config("class8")


@pytest.fixture(scope="module")
def frames():
    scenario = load_scenario("mixed-36t")
    return simulate(scenario.model_copy(update={"duration_s": 300.0})).frames


@pytest.fixture(scope="module")
def clean(config, frames):
    return estimated(config, frames)


@pytest.fixture(scope="module")
def begin_us(frames):
    """Three minutes in: the mass has been valid for one."""
    return int(frames.t_us[0]) + 180_000_000


def same_bits(a, b):
    return all(getattr(a, n).tobytes() == getattr(b, n).tobytes() for n in type(a).__slots__)


@pytest.mark.parametrize(("log", "pgn"), [("tsc1", TSC1_PGN), ("address_claim", CLAIM_PGN)])
def test_real_attack_frames_change_nothing(config, frames, clean, begin_us, log, pgn):
    attack = attack_frames(KENWORTH / f"{log}.log.xz", pgn, begin_us)
    assert len(attack)
    pipeline, attacked = estimated(config, merged(frames, attack))
    assert pipeline.decoder.counters.frames == len(frames) + len(attack)
    assert same_bits(attacked, clean[1])


@pytest.mark.parametrize(("log", "pgn"), [("tsc1", TSC1_PGN), ("address_claim", CLAIM_PGN)])
def test_logs_of_real_attacks_replay_as_if_their_attack_frames_were_not_there(log, pgn):
    kenworth = load_config("kenworth")
    whole = FrameBlock.concatenate(list(open_log(KENWORTH / f"{log}.log.xz")))
    attack = attack_frames(KENWORTH / f"{log}.log.xz", pgn, int(whole.t_us[0]))
    without = whole[~np.isin(whole.can_id, np.unique(attack.can_id))]
    assert len(without) < len(whole)
    attacked = estimated(kenworth, whole)[1]
    assert_sane(kenworth, attacked)
    assert same_bits(attacked, estimated(kenworth, without)[1])


def test_a_minute_of_full_load_noise_and_wrong_addresses_changes_no_bit(config, frames, clean, begin_us):
    rng = np.random.default_rng(1)
    right, wrong = identifiers(Pipeline(config), frames)
    count = round(FULL_LOAD_PER_S * MINUTE_S / 2)
    anything = rng.integers(0, 1 << 32, 4096, dtype=np.uint64).astype(np.uint32)  # also remote, error frames
    anything = anything[~np.isin(anything & 0x03FFFFFF, np.array(right) & 0x03FFFFFF)]
    strangers = noise(rng, anything, count, begin_us)
    wrong_senders = noise(rng, wrong, count, begin_us)
    pipeline, attacked = estimated(config, merged(frames, strangers, wrong_senders))
    assert same_bits(attacked, clean[1])
    counters = pipeline.decoder.counters
    assert sum(counters.other_senders.values()) > 0.8 * len(wrong_senders)  # the rest: transport packets
    assert counters.error_frames > 0


@pytest.mark.parametrize("per_s", [10, 100, FULL_LOAD_PER_S])
def test_random_payloads_from_the_right_addresses_leave_a_valid_mass(config, frames, clean, begin_us, per_s):
    right, _ = identifiers(Pipeline(config), frames)
    forged = noise(np.random.default_rng(2), right, round(per_s * MINUTE_S), begin_us)
    pipeline, attacked = estimated(config, merged(frames, forged))
    assert_sane(config, attacked)
    assert deviation_pct(clean[1], attacked) < MOST_PCT
    assert pipeline.intake.range_rate_check.refused["output_shaft_speed"] > 0
    # a forged brake has precedence, and under full load one is forged at every tick
    assert pipeline.gates["brake" if per_s == FULL_LOAD_PER_S else "implausible"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("per_s", [10, 100, 1000, FULL_LOAD_PER_S])
def test_each_needed_message_forged_alone_leaves_a_valid_mass(config, frames, clean, begin_us, per_s, seed):
    right, _ = identifiers(Pipeline(config), frames)
    assert len(right) > 10
    for can_id in right:
        forged = noise(np.random.default_rng(seed), [can_id], round(per_s * MINUTE_S), begin_us)
        _, attacked = estimated(config, merged(frames, forged))
        assert_sane(config, attacked)
        assert deviation_pct(clean[1], attacked) < MOST_PCT, hex(can_id)


def test_any_cut_of_an_attack_gives_the_same_bits(config, frames, begin_us):
    right, _ = identifiers(Pipeline(config), frames)
    rng = np.random.default_rng(3)
    part = frames[
        np.searchsorted(frames.t_us, begin_us) : np.searchsorted(frames.t_us, begin_us + 20_000_000)
    ]
    mixed = merged(part, noise(rng, right, 20_000, begin_us, 18.0))
    whole = estimated(config, mixed)[1]
    pipeline, done, at = Pipeline(config), [], 0
    while at < len(mixed):
        size = int(rng.choice([1, 7, 40, 300, 3000]))
        done.append(pipeline.push(mixed[at : at + size]))
        at += size
    assert same_bits(type(whole).concatenate(done), whole)
