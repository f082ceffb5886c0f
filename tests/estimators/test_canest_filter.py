"""The kernel against an independent oracle: the same model as a dense matrix Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest

from canest import fast
from canest.estimators import canest_kernel as k
from canest.estimators.canest import Canest
from canest.estimators.canest_windows import COLUMNS, WINDOW_S
from canest.vehicle.samples import GRAVITY_MPS2

from .synthetic import FACTS

AT = {name: i for i, name in enumerate(COLUMNS)}


def random_windows(n, seed=0, **columns):
    rng = np.random.default_rng(seed)
    w = np.zeros((len(COLUMNS), n))
    truth_u, grade = 1 / 21000, 0.01
    traction = 6000 + 5000 * np.sin(np.arange(n) / 7) + rng.normal(0, 300, n)
    force = traction - 900.0
    accel = truth_u * force - 0.06 - GRAVITY_MPS2 * grade
    speed = 20 + np.cumsum(accel) * WINDOW_S + rng.normal(0, 0.002, n)
    w[AT["distance_m"]] = speed * WINDOW_S
    w[AT["before_mps"]], w[AT["speed_mps"]] = np.roll(speed, 1), speed
    w[AT["before_N"]], w[AT["traction_N"]] = np.roll(traction, 1), traction
    w[AT["force_N"]], w[AT["roll_mps2"]], w[AT["accel_mps2"]] = force, 0.06, accel
    w[AT["drag_N_per_mps"]], w[AT["gear_1pm"]] = 100.0, 7.0
    w[AT["before_mps"], 0] = speed[0] - accel[0] * WINDOW_S
    w[AT["before_N"], 0] = traction[0]
    w[AT["undriven_mps"]] = w[AT["sensed_mps2"]] = w[AT["altitude_m"]] = np.nan
    w[AT["open"]] = 1.0
    for name, column in columns.items():
        w[AT[name]] = column
    return w


class Dense:
    """The textbook filter on 12 states: x = F x, P = F P F' + Q; K = P h / s; nothing clever."""

    def __init__(self, estimator):
        self.x, self.P = np.array(estimator._x), np.array(estimator._P)
        self.wind_var = estimator._prior.std[k.WIND] ** 2
        self.curvature_var = estimator._prior.std[k.CURVATURE] ** 2

    def predict(self, F, Q):
        self.x, self.P = F @ self.x, F @ self.P @ F.T + Q

    def travel(self, ds):
        F, Q = np.eye(12), np.zeros((12, 12))
        F[k.HEIGHT, k.GRADE] = F[k.GRADE, k.CURVATURE] = ds
        keep, calm = np.exp(-ds / k._CURVE_M), np.exp(-ds / k._WIND_M)
        F[k.CURVATURE, k.CURVATURE], F[k.WIND, k.WIND] = keep, calm
        q = self.curvature_var * (1 - keep**2)
        Q[k.CURVATURE, k.CURVATURE], Q[k.GRADE, k.GRADE] = q, q * ds * ds / 3
        Q[k.GRADE, k.CURVATURE] = Q[k.CURVATURE, k.GRADE] = q * ds / 2
        Q[k.WIND, k.WIND] = self.wind_var * (1 - calm**2)
        Q[k.HEIGHT, k.HEIGHT] = k._HEIGHT_DRIFT * ds
        Q[k.U, k.U] = k._MASS_DRIFT * ds * self.x[k.U] ** 2
        self.predict(F, Q)

    def push(self, force, roll, drag, noise):
        F, Q = np.eye(12), np.zeros((12, 12))
        F[k.Q, k.U], F[k.Q, k.GRADE] = WINDOW_S * force, -WINDOW_S * GRAVITY_MPS2
        F[k.Q, k.WIND], Q[k.Q, k.Q] = -WINDOW_S * drag, noise
        self.predict(F, Q)
        self.x[k.Q] -= WINDOW_S * roll

    def correct(self, h, z, r, first=0):
        s = h @ self.P @ h + r
        e = z - h @ self.x
        gain = self.P @ h / max(s, e * e / k._OUTLIER)
        gain[:first] = 0.0
        total = r + max(s, e * e / k._OUTLIER) - s  # an outlier counts as a noisier measurement
        A = np.eye(12) - np.outer(gain, h)
        self.x = self.x + gain * e
        self.P = A @ self.P @ A.T + total * np.outer(gain, gain)
        return e, s


def h(**at):
    out = np.zeros(12)
    for name, value in at.items():
        out[getattr(k, name)] = value
    return out


@pytest.mark.parametrize("compiled", [False, True])
def test_momentum_balance_equals_the_dense_filter(compiled):
    fast.enable(compiled)
    try:
        n = 60
        w = random_windows(n)
        estimator = Canest("canest", FACTS)
        dense = Dense(estimator)
        out = estimator._filter(w)
    finally:
        fast.enable(False)
    noise_var = estimator._prior.noise_start[0] ** 2
    for i in range(n):
        memory = min(k._NOISE_MEMORY, k._NOISE_START + i)
        c = {name: w[AT[name], i] for name in COLUMNS}
        dense.travel(c["distance_m"])
        inverse = max(dense.x[k.U], k._LEAST_SHARE * estimator._prior.std[k.U])
        if i == 0:
            z, t = c["before_mps"], c["before_N"]
            lever = h(U=0.0, DELAY=-t, SLIP=-z * t)
            lever[k.Q] = 0.0
            dense.x[k.Q] = z + lever @ dense.x
            cross = dense.P @ lever
            dense.P[k.Q, :], dense.P[:, k.Q] = cross, cross
            dense.P[k.Q, k.Q] = noise_var + lever @ cross
            calm = z
        share = k._FORCE_SHARE if c["traction_N"] > 0 else k._OVERRUN_SHARE
        unknown = inverse * (estimator._prior.torque_std_Nm * 7.0 + share * abs(c["traction_N"]))
        dense.push(c["force_N"], c["roll_mps2"], c["drag_N_per_mps"], unknown**2 * k._FORCE_S * WINDOW_S)
        calm += max(k._CALM, min(1.0, k._FRESH / (i + 1))) * (c["speed_mps"] - calm)
        lever = h(Q=1.0, DELAY=c["traction_N"], SLIP=calm * c["traction_N"])
        e, s = dense.correct(lever, c["speed_mps"], noise_var)
        surplus = min(e * e, k._OUTLIER * s) - s
        noise_var = max(estimator._prior.noise_floor[0] ** 2, noise_var + surplus / memory)
        assert out[i, k.OUT_U] == pytest.approx(dense.x[k.U], rel=1e-6), i
        assert out[i, k.OUT_U_VAR] == pytest.approx(dense.P[k.U, k.U], rel=1e-5)
        assert out[i, k.OUT_GRADE] == pytest.approx(dense.x[k.GRADE], abs=1e-7)
        assert out[i, k.OUT_GRADE_VAR] == pytest.approx(dense.P[k.GRADE, k.GRADE], rel=1e-5)


def test_a_considered_state_keeps_its_value_and_variance_but_widens_the_others():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(12, 12))
    P0 = A @ A.T
    x0 = rng.normal(size=12)
    lever = h(GRADE=2.0, U=0.5, BIAS=1.0)
    dense = Dense(Canest("canest", FACTS))
    dense.x, dense.P = x0.copy(), P0.copy()
    dense.correct(lever, 0.3, 5.0, first=k.FREE)
    x, P, w = list(x0), [list(row) for row in P0], [0.0] * 12
    k.correct(x, P, list(range(12)), w, k.FREE, 0.3, 5.0, k.GRADE, 2.0, k.U, 0.5, k.BIAS, 1.0, k.Q, 0.0)
    np.testing.assert_allclose(x, dense.x, rtol=1e-9)
    np.testing.assert_allclose(P, dense.P, rtol=1e-9, atol=1e-12)
    assert x[: k.FREE] == list(x0[: k.FREE])
    np.testing.assert_array_equal(np.array(P)[: k.FREE, : k.FREE], P0[: k.FREE, : k.FREE])


def test_noise_free_windows_give_the_exact_mass_and_grade():
    n = 400
    w = random_windows(n)
    accel, speed = w[AT["accel_mps2"]], np.empty(n)
    speed[:] = 20 + np.cumsum(accel) * WINDOW_S
    w[AT["speed_mps"]], w[AT["before_mps"]] = speed, speed - accel * WINDOW_S
    estimator = Canest("canest", FACTS)
    out = estimator._filter(w)
    assert 1 / out[-1, k.OUT_U] == pytest.approx(21000, rel=3e-3)
    assert out[-1, k.OUT_GRADE] == pytest.approx(0.01, abs=1e-3)
    assert estimator.consistency()["nis"] < 1.0
