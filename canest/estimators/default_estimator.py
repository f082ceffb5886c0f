"""The default estimator under its public name."""

from __future__ import annotations

from canest.estimators.canest_0_1.estimator import Canest, CanestOptions
from canest.estimators.description import Description


class DefaultEstimator(Canest):
    """The estimator `canest`, and its version 0.1 under a name of its own."""

    descriptions = (
        Description(
            "canest",
            "two mixed Kalman filters over momentum, height and accelerometer, linear in the inverse mass",
            "this project, the default",
            options=CanestOptions,
        ),
        Description(
            "canest-0.1",
            "the default of version 0.1, unchanged",
            "this project, version 0.1",
            options=CanestOptions,
        ),
    )
