"""Section 3.3 of the 2005 paper: rolling radius, drag and rolling resistance from drives of known mass.

The paper tunes drag and rolling resistance by hand until model and measurement "roughly match"; here they
are the least-squares solution of the same comparison, with standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canest.core.errors import CanestError
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, RATE_HZ, ModelBlock
from canest.estimators.regression import usable

#: errors of neighbouring samples belong together; those of stretches this long hardly do
CLUSTER_S = 10.0
#: residuals beyond so many robust standard deviations are slip, jumps, wrong gears
OUTLIER_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class RadiusFit:
    """Dynamic rolling radius of the driven wheels: value, standard deviation, samples used."""

    radius_m: float
    std_m: float
    samples: int


@dataclass(frozen=True, slots=True)
class RoadLoadFit:
    """Drag and rolling resistance.

    drag_factor: true over declared drag area. rolling_resistance: coefficient. Both with standard deviations.
    correlation: of the two (near -1: this drive's speeds hardly part them). residual_rms_N: what is left.
    """

    drag_factor: float
    drag_factor_std: float
    rolling_resistance: float
    rolling_resistance_std: float
    correlation: float
    residual_rms_N: float


def rolling_radius(wheel_radps: FloatColumn, ground_mps: FloatColumn, use: BoolColumn) -> RadiusFit:
    """Fit v = r w: driven wheel speed (output shaft over final drive) against GPS or an undriven axle.

    wheel_radps, ground_mps: (n,). use: (n,), samples without slip (no shift, no braking, steady speed for a
    slow GPS). Errors: CanestError with fewer than 50 usable samples above walking pace.
    """
    good = use & np.isfinite(wheel_radps) & np.isfinite(ground_mps) & (ground_mps > 2.0) & (wheel_radps > 0.5)
    w, v = wheel_radps[good], ground_mps[good]
    if len(w) < 50:
        raise CanestError(
            "too few samples to find the rolling radius", found=len(w), expected="at least 50 above 2 m/s"
        )
    radius = float(np.median(v / w))
    for _ in range(3):
        error = v - radius * w
        spread = 1.4826 * float(np.median(np.abs(error))) + 1e-9
        inside = np.abs(error) <= OUTLIER_SIGMAS * spread
        radius = float(w[inside] @ v[inside] / (w[inside] @ w[inside]))
    scores = w[inside] * (v[inside] - radius * w[inside])
    variance = _clustered(scores[:, None], np.flatnonzero(inside))[0, 0] / float(w[inside] @ w[inside]) ** 2
    return RadiusFit(radius, float(np.sqrt(variance)), int(inside.sum()))


def road_load(block: ModelBlock, mass_kg: float, grade: FloatColumn) -> RoadLoadFit:
    """Fit drag and rolling resistance on open samples of a drive whose mass and grade are known.

    F + Faero - M (a + g sin beta) = factor Faero + mu M g cos beta, with F and Faero of the model samples.
    grade: (n,), tan(beta). Errors: CanestError when fewer than 500 samples are open.
    """
    open_ = usable(block) & np.isfinite(grade) & np.isfinite(block.aero_N)
    if open_.sum() < 500:
        raise CanestError(
            "too few open samples to find the road load", found=int(open_.sum()), expected="at least 500"
        )
    cosine = 1.0 / np.sqrt(1.0 + grade[open_] ** 2)
    weight, aero = mass_kg * GRAVITY_MPS2 * cosine, block.aero_N[open_]
    rows = np.column_stack((aero, weight))
    left = block.force_N[open_] + aero - mass_kg * block.accel_mps2[open_] - weight * grade[open_]
    inside = np.ones(len(left), np.bool_)
    for _ in range(3):
        x = np.linalg.lstsq(rows[inside], left[inside], rcond=None)[0]
        error = left - rows @ x
        spread = 1.4826 * float(np.median(np.abs(error - np.median(error)))) + 1e-9
        inside = np.abs(error - np.median(error)) <= OUTLIER_SIGMAS * spread
    bread = np.linalg.inv(rows[inside].T @ rows[inside])
    scores = rows[inside] * error[inside, None]
    cov = bread @ _clustered(scores, np.flatnonzero(open_)[inside]) @ bread
    std = np.sqrt(np.diag(cov))
    return RoadLoadFit(
        drag_factor=float(x[0]),
        drag_factor_std=float(std[0]),
        rolling_resistance=float(x[1]),
        rolling_resistance_std=float(std[1]),
        correlation=float(cov[0, 1] / (std[0] * std[1])),
        residual_rms_N=float(np.sqrt(np.mean(error[inside] ** 2))),
    )


def model_acceleration(block: ModelBlock, mass_kg: float, grade: FloatColumn, mu: float) -> FloatColumn:
    """Return the acceleration by eq. 1, (n,), m/s2: the other curve of Figure 2."""
    cosine = 1.0 / np.sqrt(1.0 + grade * grade)
    return np.asarray(block.force_N / mass_kg - GRAVITY_MPS2 * cosine * (grade + mu))


def _clustered(scores: FloatColumn, index: IntColumn) -> FloatColumn:
    """Return the sum over clusters of the outer products of their summed scores, (q, q)."""
    cluster = index // round(CLUSTER_S * RATE_HZ)
    sums = np.stack([np.bincount(cluster, weights=column) for column in scores.T], axis=1)
    return np.asarray(sums.T @ sums)
