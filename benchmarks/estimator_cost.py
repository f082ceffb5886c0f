"""What one sample costs every estimator, interpreted and compiled, beside padasip and filterpy.

    python benchmarks/estimator_cost.py

"kernel" is the recursion alone on prepared columns; "update" is everything an estimator does with a block
of model samples (rows, recursion, bounds, standard deviations, status). Processor time, so that other work
on the machine hardly shows; the best of several passes counts.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from canest.core import jit
from canest.core.samples import STEP_US, ModelBlock, VehicleFacts
from canest.estimators.papers.kidambi2014.ekf_filter import Filtered, Noise, Samples, ekf_steps
from canest.estimators.papers.rhode2013.multiple_forgetting import MultipleForgetting
from canest.estimators.papers.rhode2013.rsvd import Rsvd
from canest.estimators.papers.two_parameter import Known, Limits
from canest.estimators.papers.vahidi2005.rlsmf import Forgetting, forget_each
from canest.estimators.registry import BUILT_IN, create

FACTS = VehicleFacts(7_000.0, 40_000.0, has_accelerometer=True)
#: rows at a time, as the estimators take them (they stay in the processor's cache)
PIECE = 4096
#: the most a sample may cost: compiled and interpreted, ns
LIMITS = {
    "RLSMF, 2 parameters": (20.0, 1_000.0),
    "RLSMF, 4 parameters": (40.0, 2_000.0),
    "EKF": (100.0, 10_000.0),
    "RGTLS": (4_000.0, 30_000.0),
}


def samples(n: int) -> ModelBlock:
    """Throttle pulses of a 21 t truck on a level road, with noise."""
    rng = np.random.default_rng(1)
    force = 21_250.0 * (0.06 + 0.4 * np.sin(np.arange(n) / 70.0))
    accel = force / 21_250.0 - 0.006 * 9.80665 + 0.02 * rng.standard_normal(n)
    speed = 20.0 + np.cumsum(accel - accel.mean()) * 0.02
    zeros, nan = np.zeros(n), np.full(n, np.nan)
    restart = np.zeros(n, bool)
    restart[0] = True
    return ModelBlock(
        t_us=np.arange(n) * STEP_US,
        speed_mps=speed,
        accel_mps2=accel,
        force_N=force,
        mu=zeros + 0.006,
        traction_N=force,
        aero_N=zeros + 500.0,
        force_per_torque_1pm=zeros + 10.0,
        rotating_mass_kg=zeros + 600.0,
        coasting_N=nan,
        undriven_mps=nan,
        accelerometer_mps2=accel,
        slope=nan,
        altitude_m=nan,
        yaw_rate_radps=nan,
        raw_speed_mps=speed,
        raw_force_N=force,
        raw_torque_Nm=force / 10.0,
        gear=zeros,
        gate=np.zeros(n, np.uint8),
        restart=restart,
        stopped=np.zeros(n, bool),
        ax_ok=np.ones(n, bool),
    )


def best(action: Callable[[], object], n: int, passes: int = 5) -> float:
    """Return the least cost per sample of several passes, ns; one unmeasured pass first."""
    action()
    costs = []
    for _ in range(passes):
        begin = time.process_time()
        action()
        costs.append((time.process_time() - begin) / n * 1e9)
    return min(costs)


def each(action: Callable[[slice], object], pieces: list[slice]) -> None:
    """Call the action piece by piece, keeping no result."""
    for piece in pieces:
        action(piece)


def kernels(n: int) -> dict[str, Callable[[], object]]:
    """Return the recursions alone, on columns already in their containers."""
    block = samples(n)
    phi2 = np.full(n, -9.80665)
    wrap = (lambda c: c) if jit.enabled() else (lambda c: c.tolist())
    y, phi1, second = wrap(block.accel_mps2), wrap(block.force_N), wrap(phi2)
    out = [wrap(np.zeros(n)) for _ in range(6)]
    rlsmf = wrap(np.array([4.5e-5, 0.006, 1e-7, 10.0, 1e-3]))
    bounds, forgetting = (2.5e-5, 1.4e-4, -0.25, 0.25), Forgetting(False, 1 / 0.999, 1 / 0.99)
    speed, aero, fresh = wrap(block.speed_mps), wrap(block.aero_N), wrap(np.zeros(n))
    ekf = wrap(np.array([0.0, 4.5e-5, 0.006, 0.0, 0.0, 0.0, 1e-10, 0.0, 1e-2, 1.0, 1.0]))
    a = np.column_stack((np.full(n, 9.8), block.accel_mps2, 9.8 * block.speed_mps, block.aero_N))
    pieces = [slice(k, k + PIECE) for k in range(0, n, PIECE)]
    b, wide = block.force_N, np.full(4, 1e12)
    four = MultipleForgetting(np.ones(4), np.ones(4), np.full(4, 0.999), -wide, wide, wide, 1.0)
    svd = Rsvd(2, 0.9995)
    z = np.column_stack((block.force_N / 300.0, phi2 / 1e-4, block.accel_mps2 / 0.05))
    return {
        "RLSMF, 2 parameters": lambda: forget_each(
            y, phi1, second, forgetting, Limits(*bounds, 1e-6, 1e3), 2e-3, rlsmf, Known(*out[:4])
        ),
        "RLSMF, 4 parameters": lambda: each(lambda p: four.add(a[p], b[p]), pieces),
        "EKF": lambda: ekf_steps(
            Samples(speed, phi1, aero, second, fresh), Noise(1e-7, 1e-15, 2e-7, 1e-3),
            Limits(*bounds, 1e-8, 1.0), ekf, Filtered(*out),
        ),
        "RGTLS": lambda: each(lambda p: svd.add(z[p]), pieces),
    }  # fmt: skip


def peers(n: int) -> dict[str, float]:
    """Return what the same recursions cost in the libraries that have them, ns."""
    import padasip
    from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter

    block = samples(n)
    found = {}
    for size in (2, 4):
        x = np.random.default_rng(0).standard_normal((n, size))
        rls = padasip.filters.FilterRLS(n=size, mu=0.999, w=np.zeros(size))
        found[f"padasip FilterRLS, {size} parameters"] = best(
            lambda r=rls, x=x: r.run(block.accel_mps2, x), n, 3
        )
    kalman = KalmanFilter(3, 1)
    kalman.x, kalman.H, kalman.F = np.zeros((3, 1)), np.array([[1.0, 0, 0]]), np.eye(3)

    def linear() -> None:
        for v in block.speed_mps:
            kalman.predict()
            kalman.update(v)

    found["filterpy KalmanFilter, 3 states"] = best(linear, n, 3)
    extended = ExtendedKalmanFilter(3, 1)
    extended.x, extended.F = np.zeros((3, 1)), np.eye(3)
    h = np.array([[1.0, 0, 0]])

    def nonlinear() -> None:
        for v in block.speed_mps:
            extended.predict()
            extended.update(np.array([[v]]), lambda _: h, lambda x: x[:1])

    found["filterpy ExtendedKalmanFilter, 3 states"] = best(nonlinear, n, 3)
    return found


def main() -> int:
    """Measure and print; exit 1 when a limit is missed."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter).parse_args()
    results: dict[str, list[float]] = {}
    for compiled in (True, False):
        if compiled and not jit.available():
            print("numba is not installed: interpreted only")
            continue
        jit.enable(compiled)
        n = 100_000 if compiled else 10_000
        for name, action in kernels(n).items():
            results.setdefault(f"kernel  {name}", []).append(best(action, n))
        block = samples(n)
        for name in BUILT_IN:
            count = n if compiled or name not in ("rtls", "rgtls", "ekf-select") else n // 5
            method = create(name, FACTS)
            part = block[:count]
            results.setdefault(f"update  {name}", []).append(
                best(lambda m=method, p=part: m.update(p), count, 3)
            )
    jit.enable(False)
    missed = []
    print(f"{'ns per sample':<42}{'compiled':>10}{'interpreted':>13}   at most")
    for name, costs in results.items():
        limit = LIMITS.get(name.removeprefix("kernel  "))
        text = f"{limit[0]:,.0f} / {limit[1]:,.0f}" if limit else ""
        print(f"{name:<42}{costs[0]:>10,.0f}{costs[-1]:>13,.0f}   {text}")
        if limit and len(costs) == 2 and (costs[0] > limit[0] or costs[1] > limit[1]):
            missed.append(name)
    for name, cost in peers(5_000).items():
        print(f"{'peer    ' + name:<52}{cost:>13,.0f}")
    print("limits missed: " + ", ".join(missed) if missed else "all limits met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
