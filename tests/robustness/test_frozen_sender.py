"""A controller that repeats its last frame for a minute, or comes and goes, while the mass is valid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.config import load_config
from canest.core.samples import Status
from canest.decode import j1939
from canest.simulation.reading import load_scenario
from canest.simulation.run import simulate

from .attacks import estimated

ETC1, EEC1, VDC2 = 61442, 61444, 61449
MINUTE_US = 60_000_000


@pytest.fixture(scope="module")
def config():
    return load_config("class8")


@pytest.fixture(scope="module")
def frames():
    return simulate(load_scenario("pulse-21t").model_copy(update={"duration_s": 240.0})).frames


@pytest.fixture(scope="module")
def clean(config, frames):
    return estimated(config, frames)[1]


def frozen(frames, pgn, begin_us):
    """Return the frames with one group's payload repeated for a minute."""
    groups = {i: j1939.pgn_of(i) for i in np.unique(frames.can_id).tolist()}
    of = np.array([groups[i] for i in frames.can_id.tolist()]) == pgn
    last = np.flatnonzero(of & (frames.t_us < begin_us))[-1]
    during = of & (frames.t_us >= begin_us) & (frames.t_us < begin_us + MINUTE_US)
    return replace(frames, data=np.where(during, frames.data[last], frames.data))


def test_an_accelerometer_that_repeats_itself_bends_little(config):
    """It is braked meanwhile: a frozen speed taken as true is a hill of 9 %."""
    frames = simulate(load_scenario("mixed-36t").model_copy(update={"duration_s": 300.0})).frames
    clean = estimated(config, frames)[1]
    begin_us = int(frames.t_us[0]) + 220_000_000
    pipeline, e = estimated(config, frozen(frames, VDC2, begin_us))
    valid = (e.status == Status.VALID) & (clean.status == Status.VALID)
    assert np.abs(e.grade - clean.grade)[valid].max() < 0.015
    assert pipeline.stuck_ticks["longitudinal_accel"] > 50 * 35


def test_a_sender_that_comes_and_goes_teaches_no_wrong_mass(config):
    """Another speed takes over and is left again, six times a minute: steps that are no acceleration."""
    drive = simulate(load_scenario("mixed-9t").model_copy(update={"seed": 4}))
    groups = {i: j1939.pgn_of(i) for i in np.unique(drive.frames.can_id).tolist()}
    of = np.array([groups[i] for i in drive.frames.can_id.tolist()]) == ETC1
    elapsed_s = (drive.frames.t_us - drive.frames.t_us[0]) // 1_000_000
    gone = of & ((elapsed_s + 6) % 10 < 3)
    _, e = estimated(config, drive.frames[~gone])
    valid = e.status == Status.VALID
    assert valid.mean() > 0.5
    assert np.abs(e.mass_kg[valid] / drive.truth["mass_kg"].max() - 1).max() < 0.05  # 0.09 with the steps
