"""A parked truck, a silent controller, a frozen signal, a bus with nothing on it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pipeline_helpers import Value, bundled, bus

from canest.config import load_config
from canest.core.estimates import Estimates
from canest.core.frames import FrameBlock
from canest.core.gates import Gate
from canest.core.samples import Status
from canest.pipeline.pipeline import Pipeline

CONFIG = load_config("class8")
FINAL_DRIVE, RADIUS_M = 3.73, 0.5
DIRECT_GEAR = 9  # ratio 1


def shaft_rpm(speed_mps: float) -> float:
    return speed_mps / RADIUS_M * FINAL_DRIVE * 30 / math.pi


def drive(**changes: Value) -> dict[str, Value]:
    """A truck in its direct gear whose speed swings; brakes, clutch and retarder at rest."""

    def speed(t: float) -> float:
        return 15.0 + 2.0 * math.sin(0.7 * t)

    return {
        "ActualEngPercentTorque": lambda t: 50 + 25 * math.cos(0.7 * t),
        "NominalFrictionPercentTorque": 8.0,
        "EngSpeed": lambda t: shaft_rpm(speed(t)),
        "Trans1OutputShaftSpeed": lambda t: shaft_rpm(speed(t)),
        "TransDrivelineEngaged": 1.0,
        "TransTorqueConverterLockupEngaged": 1.0,
        "TransShiftInProcess": 0.0,
        "PercentClutchSlip": 0.0,
        "TransActualGearRatio": 1.0,
        "TransCurrentGear": DIRECT_GEAR,
        "WheelBasedVehicleSpeed": lambda t: speed(t) * 3.6,
        "FrontAxleSpeed": lambda t: speed(t) * 3.6,
        "BrakeSwitch": 0.0,
        "ParkingBrakeSwitch": 0.0,
        "BrakePedalPos": 0.0,
        "AntiLockBrakingActive": 0.0,
        "ActualRetarderPercentTorque": 0.0,
        "AccelPedalPos1": 40.0,
        **changes,
    }


PARKED = drive(
    ActualEngPercentTorque=10.0,
    EngSpeed=650.0,
    Trans1OutputShaftSpeed=0.0,
    WheelBasedVehicleSpeed=0.0,
    FrontAxleSpeed=0.0,
    TransCurrentGear=0.0,
    TransActualGearRatio=None,
    TransDrivelineEngaged=0.0,
    ParkingBrakeSwitch=1.0,
)


def estimate(frames: FrameBlock) -> tuple[Pipeline, Estimates]:
    pipeline = Pipeline(CONFIG)
    done = [pipeline.push(frames), pipeline.finish()]
    return pipeline, Estimates.concatenate(done)


def after(e: Estimates, seconds: float) -> np.ndarray:
    return e.t_us > e.t_us[0] + seconds * 1e6


def test_a_truck_that_drives_is_learned_from() -> None:
    pipeline, e = estimate(bus(20, drive()))
    assert pipeline.samples == len(e) == sum(pipeline.gate_counts.values()) + pipeline.updated
    assert np.array_equal(np.diff(e.t_us), np.full(len(e) - 1, 20_000))
    assert (e.gate[after(e, 2)] == Gate.OPEN).all()
    assert e.status[-1] >= Status.CONVERGING
    assert np.clip(e.mass_kg[-1], 7_000, 40_000) == pytest.approx(e.mass_kg[-1])


def test_a_parked_truck_teaches_nothing() -> None:
    pipeline, e = estimate(bus(20, PARKED))
    assert pipeline.updated == 0
    assert pipeline.samples == len(e) > 900
    assert (e.gate != Gate.OPEN).all()
    assert (e.status == Status.UNESTIMATED).all()
    assert np.isnan(e.mass_kg).all()


def test_an_engine_that_falls_silent_closes_the_gate_as_stale_and_freezes_the_mass() -> None:
    frames = bus(30, drive())
    silent = bus(30, drive(), silent={"EEC1"})
    cut = frames.t_us[0] + 15_000_000
    joined = FrameBlock.concatenate([frames[frames.t_us < cut], silent[silent.t_us >= cut]])
    pipeline, e = estimate(joined)
    gone = e.t_us > cut + 250_000 + 20_000  # EEC1 may be 0.25 s old
    assert (e.gate[gone] == Gate.STALE).all()
    assert (e.gate[(e.t_us < cut) & after(e, 2)] == Gate.OPEN).all()
    assert len(np.unique(e.mass_kg[gone][25:])) == 1
    assert pipeline.gate_counts["stale"] >= gone.sum()


def test_an_engine_that_sends_not_available_closes_the_gate_as_invalid() -> None:
    torque = drive()["ActualEngPercentTorque"]
    assert callable(torque)
    _, e = estimate(bus(20, drive(ActualEngPercentTorque=lambda t: torque(t) if t < 10 else None)))
    gone = after(e, 10.1)
    assert (e.gate[gone] == Gate.INVALID).all()
    assert len(np.unique(e.mass_kg[gone][25:])) == 1


def test_a_frozen_shaft_speed_disagrees_with_the_engine_and_closes_the_driveline_gate() -> None:
    def speed(t: float) -> float:
        return 12.0 + 0.4 * t

    rising = {
        "EngSpeed": lambda t: shaft_rpm(speed(t)),
        "Trans1OutputShaftSpeed": lambda t: shaft_rpm(speed(min(t, 8.0))),
    }
    _, e = estimate(bus(20, drive(**rising), silent={"CCVS1", "EBC2"}))
    assert (e.gate[~after(e, 8) & after(e, 2)] == Gate.OPEN).all()
    # 6 % of 15.2 m/s and 5 rad/s of the engine: 1.6 m/s, reached 4 s after the freeze
    assert (e.gate[after(e, 12.5)] == Gate.DRIVELINE).all()


def test_optional_signals_that_are_never_sent_close_nothing() -> None:
    _, e = estimate(bus(10, drive(), silent={"VDC2", "EBC1", "EBC2", "ERC1", "AMB", "EEC2"}))
    assert (e.gate[after(e, 2)] == Gate.OPEN).all()


def test_brake_and_shift_close_their_gates_and_dwell() -> None:
    frames = bus(
        20,
        drive(
            BrakePedalPos=lambda t: 20.0 if 5 <= t < 7 else 0.0,
            TransShiftInProcess=lambda t: 1.0 if 11 <= t < 12 else 0.0,
        ),
    )
    _, e = estimate(frames)
    t_s = (e.t_us - frames.t_us[0]) * 1e-6
    for begin, end, gate, dwell in ((5, 7, Gate.BRAKE, 1.0), (11, 12, Gate.SHIFT, 0.6)):
        assert (e.gate[(t_s > begin + 0.2) & (t_s < end)] == gate).all()
        assert (e.gate[(t_s > end + 0.2) & (t_s < end + dwell - 0.1)] == Gate.RECOVERY).all()
        assert (e.gate[(t_s > end + dwell + 0.2) & (t_s < end + dwell + 1)] == Gate.OPEN).all()


def test_a_bus_without_any_wanted_frame_gives_no_rows() -> None:
    block = bundled("kenworth/normal.log.xz")[:500]
    foreign = FrameBlock(block.t_us, np.full(500, 0x123, np.uint32), block.length, block.data)
    pipeline, e = estimate(foreign)
    assert len(e) == 0
    assert pipeline.decoder.counters.frames == 500
    assert len(pipeline.advance_to(int(block.t_us[-1]) + 10**9)) == 0


def test_time_that_passes_on_a_silent_bus_ends_in_sleep() -> None:
    pipeline = Pipeline(CONFIG)
    frames = bus(3, drive())
    pipeline.push(frames)
    last = int(frames.t_us[-1])
    ticks = np.concatenate([pipeline.advance_to(last + k * 20_000).t_us for k in range(1, 3000)])
    assert ticks[-1] < last + round(CONFIG.sampling.hold_s * 1e6) <= ticks[-1] + 20_000
    assert len(pipeline.finish()) == 0


def test_a_restored_mass_is_where_the_estimate_starts() -> None:
    pipeline = Pipeline(CONFIG)
    pipeline.restore(31_000.0, 900.0)
    e = pipeline.push(bus(1, PARKED))
    assert np.allclose(e.mass_kg, 31_000.0, rtol=1e-3)
    assert pipeline.snapshot()["mass_kg"] > 0
