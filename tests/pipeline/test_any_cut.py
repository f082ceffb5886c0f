"""The whole pipeline says the same to the last bit however a stream is cut, faults and all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pipeline_helpers import Recorder, bundled, differences, everything, run

from canest.config import load_config
from canest.core import jit
from canest.core.frames import FrameBlock
from canest.pipeline.pipeline import Pipeline

#: config, log, and an index from which the first second has everything in it
DRIVES = {"class8": "vcan/cycle.log.xz", "kenworth": "kenworth/normal.log.xz"}
#: every stage that carries a state, in one config
EFFECTS = (
    "effects=[{effect: torque_delay, delay_s: 0.06}, {effect: wheel_slip, slip_per_mps2: 0.01},"
    " {effect: rolling_warmup, crr_cold: 0.002, tau_s: 20}, {effect: driveline_loss, loss: 0.02, gear: 4}]"
)
CASES = [
    (name, estimator, more)
    for name in DRIVES
    for estimator, more in (
        ("canest", ()),
        (
            "rlsmf",
            ("gates.low_excitation.enabled=true", "filter.order=3", "vehicle.wheel_radius_m=0.46", EFFECTS),
        ),
    )
]
cases = pytest.mark.parametrize(("name", "estimator", "more"), CASES, ids=[f"{n}-{e}" for n, e, _ in CASES])

fault = st.one_of(
    st.tuples(st.just("gap"), st.sampled_from([1_990_000, 2_100_000, 30_000_000])),
    st.tuples(st.just("back"), st.sampled_from([600_000, 40_000_000])),
    st.tuples(st.just("late"), st.sampled_from([1, 15_000, 480_000])),
    st.tuples(st.just("lost"), st.integers(1, 400)),
    st.tuples(st.just("na"), st.integers(1, 300)),
    st.tuples(st.just("garbled"), st.integers(1, 30)),
)


@st.composite
def streams(draw: st.DrawFn, name: str, length: int) -> FrameBlock:
    """A stretch of a bundled log with jumps of its clock, lost frames and damaged payloads."""
    log = bundled(DRIVES[name])
    begin = draw(st.integers(0, max(0, len(log) - length)))
    part = log[begin : begin + length]
    t_us, data, keep = part.t_us.copy(), part.data.copy(), np.ones(len(part), bool)
    for place, (kind, size) in draw(st.lists(st.tuples(st.floats(0.02, 0.98), fault), max_size=4)):
        at = int(place * len(part))
        match kind:
            case "gap":
                t_us[at:] += size
            case "back":
                t_us[at:] -= size
            case "late":
                t_us[at] -= size
            case "lost":
                keep[at : at + size] = False
            case "na":
                data[at : at + size] = np.uint64(2**64 - 1)
            case "garbled":
                data[at : at + size] ^= np.uint64(0x9E3779B97F4A7C15)
    return FrameBlock(t_us, part.can_id, part.length, data)[keep]


@cases
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_few_cuts_and_live_blocks(
    name: str, estimator: str, more: tuple[str, ...], data: st.DataObject
) -> None:
    config = load_config(name, [f"estimator.name={estimator}", *more])
    frames = data.draw(streams(name, 1500))
    whole = run(config, frames)
    cuts = data.draw(st.lists(st.integers(0, len(frames)), max_size=6))
    assert differences(whole, run(config, frames, cuts)) == []
    assert differences(whole, run(config, frames, range(7, len(frames), 7))) == []


@cases
@settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_one_frame_at_a_time(name: str, estimator: str, more: tuple[str, ...], data: st.DataObject) -> None:
    config = load_config(name, [f"estimator.name={estimator}", *more])
    frames = data.draw(streams(name, 500))
    assert differences(run(config, frames), run(config, frames, range(1, len(frames)))) == []


@cases
def test_live_with_time_passing_between_frames(name: str, estimator: str, more: tuple[str, ...]) -> None:
    """Slices of 20 ms, and the clock read after each, also while the bus is silent."""
    config = load_config(name, [f"estimator.name={estimator}", *more])
    log = bundled(DRIVES[name])
    late = log.t_us.copy()
    late[3000:] += 700_000
    late[4000:] += 5_000_000
    frames = FrameBlock(late, log.can_id, log.length, log.data)[:4900]
    recorder = Recorder()
    pipeline = Pipeline(config, listener=recorder)
    done, begin = [], 0
    for now in range(int(late[0]), int(late[4899]) - 100_000, 20_000):  # the log ends, the bus did not
        end = int(np.searchsorted(frames.t_us, now))
        done += [pipeline.push(frames[begin:end]), pipeline.advance_to(now)]
        begin = end
    done += [pipeline.push(frames[begin:]), pipeline.finish()]
    live = everything(pipeline, recorder, done)
    assert differences(run(config, frames), live) == []
    assert live["clock"]["gaps"] == 1  # type: ignore[index]


@pytest.mark.slow
@pytest.mark.skipif(not jit.available(), reason="needs numba")
@cases
def test_compiled_kernels_give_the_same_bits(name: str, estimator: str, more: tuple[str, ...]) -> None:
    config = load_config(name, [f"estimator.name={estimator}", *more])
    frames = bundled(DRIVES[name])
    plain = run(config, frames)
    jit.enable()
    try:
        assert differences(plain, run(config, frames)) == []
        assert differences(plain, run(config, frames, range(3000, len(frames), 3000))) == []
    finally:
        jit.enable(False)
