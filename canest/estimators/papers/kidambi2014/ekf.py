"""Mass and grade by one extended Kalman filter (`ekf`): 2014 paper, eqs. 6-10.

Slips in the paper, put right here: "100 tan^-1 beta" for the grade in percent is 100 tan beta; "acausal"
processing is causal. The filter itself is in `ekf_filter`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import field_validator

from canest.core.frames import FloatColumn
from canest.core.samples import RATE_HZ, EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.description import Description, option
from canest.estimators.papers.inverse_mass import InverseMassEstimator, InverseMassOptions
from canest.estimators.papers.kidambi2014.ekf_filter import EkfCore, Rows
from canest.estimators.papers.prior import prior_mass_kg


class EkfOptions(InverseMassOptions):
    """Options of the filter; Q and R are those of one step at ``rate_hz``."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        #: the paper gives no initial P for the filter; this is the one it gives for RLS
        "2014": {"q": (0.1, 1e-5, 25.0), "r": 100.0, "rate_hz": 30.0, "p0": (0.001, 10.0)},
    }

    q: tuple[float, float, float] = option(
        (1e-7, 1e-15, 2e-7),
        "process noise variances of v, (m/s)², of 1/M, 1/kg², and of sin(β + β_mu)",
        allowed="three numbers, none negative",
    )
    r: float = option(1e-3, "variance of the measured speed", unit="(m/s)²", gt=0.0)
    rate_hz: float = option(
        RATE_HZ,
        "rate that q and r belong to; at another the same noise densities hold",
        unit="Hz",
        gt=0.0,
    )

    @field_validator("q")
    @classmethod
    def _not_negative(cls, q: tuple[float, float, float]) -> tuple[float, float, float]:
        if min(q) < 0.0:
            raise ValueError("three variances, none negative")
        return q


class EkfBase(InverseMassEstimator):
    """What `ekf` and `ekf-select` share: how they start, and that they pause while a gate is closed."""

    wants_excitation_gate = True

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        super().__init__(name, facts, options)
        self._before = False
        self._begin(prior_mass_kg(facts), None)

    def _begin(self, mass_kg: float, std_kg: float | None) -> None:
        theta, variance = self._prior_theta(mass_kg), self.options.p0 or self.box.variance
        if std_kg is not None:
            variance = (min(variance[0], (std_kg / mass_kg**2) ** 2), variance[1])
        self._start(theta, variance)
        self._hold_start(theta, variance)

    @abstractmethod
    def _start(self, theta: tuple[float, float], variance: tuple[float, float]) -> None:
        """Make the filter or filters, at theta with its variances."""


class Ekf(EkfBase):
    """One extended Kalman filter; paused while a gate is closed, restarted at the measured speed after it."""

    descriptions = (
        Description(
            "ekf",
            "extended Kalman filter of speed, inverse mass and grade",
            "2014, eqs. 6-10",
            options=EkfOptions,
        ),
    )

    def _start(self, theta: tuple[float, float], variance: tuple[float, float]) -> None:
        self._core = EkfCore(self.options, self.box, theta, variance)

    @property
    def state(self) -> FloatColumn:
        """Return v (m/s), 1/m (1/kg) and sin(beta + beta_mu) after the last sample, shape (3,)."""
        return np.array(self._core.state[:3])

    @property
    def covariance(self) -> FloatColumn:
        """Return P of the state, shape (3, 3), before its scaling by how well the innovations fit it."""
        p11, p12, p13, p22, p23, p33 = self._core.state[3:9]
        return np.array([[p11, p12, p13], [p12, p22, p23], [p13, p23, p33]])

    def _update(self, block: ModelBlock) -> EstimateBlock:
        rows = Rows(block, self._before)
        self._before = rows.after
        known = self._core.run(rows, 0, len(rows.at))
        return self._hold(rows.at, self._numbers(known[:4], rows.mu), len(block))
