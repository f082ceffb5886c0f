"""The default estimator under its public name."""

from __future__ import annotations

from canest.estimators.canest_0_1.estimator import Canest, CanestOptions
from canest.estimators.description import Description


class DefaultEstimator(Canest):
    """The estimator `canest`, with the description that lists and pages show."""

    descriptions = (
        Description(
            "canest",
            "two mixed Kalman filters over momentum, height and accelerometer, linear in the inverse mass",
            "this project, the default",
            options=CanestOptions,
        ),
    )
