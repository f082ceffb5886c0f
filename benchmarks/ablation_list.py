"""The mechanisms of the default estimator, and what switches each of them off."""

from __future__ import annotations

from functools import partial

from judging import without_accelerometer
from variants import Variant, without

#: a variance, limit or time that is never reached
NEVER = 1e12

MECHANISMS = (
    # -- the load
    Variant("another load in motion", {"load.moving_probability": 0.0}),
    Variant("a load that drifts", {"load.drift_probability": 0.0}),
    Variant("another load after a stop", {"load.stop_s": NEVER}),
    Variant("several normal densities for an unknown load", {"load.banks": 1}),
    # -- the driver
    Variant("torque that answers the road", {"driver.answered_share": 0.0}),
    Variant("limit of the road's answer", {"driver.most_1pm": 1.0}),
    Variant("evidence of fast torque", {"driver.weight": 0.0}),
    Variant("response other than u", {"driver.response_share": 0.0}),
    Variant("scatter of an answer", {"driver.scatter_share": 0.0}),
    # -- the road and the wind
    Variant("curved roads", {"road.straight_m": NEVER}),
    Variant("steps of the road", {"road.step_nis": NEVER}),
    Variant("roughness of a straight", {"road.roughness_1pm": 1e-12}),
    Variant("roughness that follows the innovations", {"road.whiteness": 0.0}),
    Variant("wind", {"wind.wind_mps": 1e-3}),
    Variant("wind and errors of the drag area", {"wind.wind_mps": 1e-3, "wind.usual_mps": 0.0}),
    # -- states of the signals
    Variant("remaining delay of the torque", {"prior.delay_s": 0.0}),
    Variant("slip of the wheels", {"prior.slip_per_mps2": 0.0}),
    Variant("windup of the driveline", {"prior.windup_s2": 0.0}),
    Variant("lag of the accelerometer", {"prior.lag_s": 0.0}),
    # -- noise
    Variant("the driveline's swing", {"noise.swing_mpN": 0.0}),
    Variant("jitter of the torque's delay", {"noise.jitter_s": 0.0}),
    Variant("gusts", {"noise.gust_mps": 0.0}),
    Variant("force that the model lacks", {"noise.force_share": 0.0, "noise.overrun_share": 0.0}),
    Variant("force lacking in overrun as in drive", {"noise.overrun_share": 0.02}),
    Variant("rounding errors that last", {"noise.longest_windows": 1.0}),
    Variant("rounding errors of the torque", {"noise.longest_windows": 0.0}),
    Variant("noise levels that follow", {"noise.windows": NEVER, "noise.first_windows": NEVER}),
    Variant("doubted innovations", {"noise.doubted": NEVER}),
    Variant("outliers cut", {"noise.outlier": NEVER}),
    Variant("dependent windows (power 1)", {"noise.power": 1.0}),
    # -- signals and gated samples
    Variant("retarders, bends and dwells while gated", {"closed.force_share": 1e6}),
    Variant("coasting", edit=partial(without, "coasting_N")),
    Variant("altitude", edit=partial(without, "altitude_m")),
    Variant("accelerometer", edit=without_accelerometer),
)
