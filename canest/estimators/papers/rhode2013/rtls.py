"""Recursive total least squares (`rtls`) and generalized total least squares (`rgtls`) of mass and grade."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from canest.core.frames import FloatColumn
from canest.estimators.description import Description, option
from canest.estimators.papers.rhode2013.rsvd import Rsvd
from canest.estimators.papers.rhode2013.tls import GeneralizedOptions, bounded, noise_covariance, prior_rows
from canest.estimators.papers.rhode2013.tls_math import NoiseScale, covariance
from canest.estimators.papers.two_parameter import TwoParameter


class RecursiveTlsOptions(GeneralizedOptions):
    """Options of both."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        #: the paper's lambda of 0.997 scales rows; in squares it is this
        "2013": {"forgetting": 0.997**2},
    }

    forgetting: float = option(0.9995, "weight of a row's square against the next, as in RLS", gt=0.5, le=1.0)


class Rtls(TwoParameter):
    """RTLS (2013, Alg. 4) and RGTLS (Alg. 5: rows scaled by W, results carried back)."""

    descriptions = (
        Description(
            "rtls",
            "recursive total least squares, with forgetting",
            "2013, Alg. 4",
            options=RecursiveTlsOptions,
        ),
        Description(
            "rgtls",
            "recursive total least squares with a noise covariance, with forgetting",
            "2013, Alg. 5",
            options=RecursiveTlsOptions,
        ),
    )
    wants_excitation_gate = True

    def _start(self, theta: tuple[float, float], p: tuple[float, float, float], variance: float) -> None:
        self._scale = NoiseScale.of(noise_covariance(self.name, self.options))
        self._svd = Rsvd(2, self.options.forgetting)
        self._svd.add(self._scale.rows(prior_rows(theta, p)))

    def _learn(self, y: FloatColumn, phi1: FloatColumn, phi2: FloatColumn) -> FloatColumn:
        rows = self._scale.rows(np.stack((phi1, phi2, y), axis=1))
        x, smallest, gram, weight = self._svd.add(rows)
        cov = self._scale.covariance_back(covariance(x, gram, smallest, weight))
        return bounded(self, self._scale.back(x).T, np.stack((cov[:, 0, 0], cov[:, 1, 1])))
