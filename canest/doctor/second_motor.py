"""A motor that no role takes: its message has a torque and a speed, as that of the mapped one has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.roles import UNITS
from canest.decode.compile import FRAME_BYTES
from canest.decode.decoder import Decoder
from canest.decode.groups import Want
from canest.doctor.stretches import Samples, Stretches, at, comparable
from canest.doctor.unused_signals import is_motor_speed
from canest.pipeline.signal_map import wants_of
from canest.vehicle.role_sources import torque_role

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canest.config import Config
    from canest.core.frames import FrameBlock

#: two motors of a vehicle drive and brake together, as no other torques of it do
_LEAST_CORRELATION, _FEWEST = 0.5, 1000
#: torques at the wheels are those of all motors
_CRANK_TORQUES = ("engine_torque", "engine_torque_pct")


class SecondMotorCheck:
    """Correlates torques with the one that counts. Streams frames; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._torque = torque_role(config.signals, config.vehicle)
        wanted = wants_of(config).get(self._torque) if self._torque in _CRANK_TORQUES else None
        others = {want.role: want for want in _other_motors(config)} if wanted else {}
        roles = {self._torque: wanted, **others} if wanted and others else {}
        self._decoder = Decoder(roles, config.databases) if roles else None
        self._stretches = Stretches(roles)
        #: signal -> number of pairs, sums of both torques, of their squares and of their product
        self._sums = {name: np.zeros(6) for name in others}

    def push(self, block: FrameBlock) -> None:
        """Take the frames of a block."""
        if self._decoder is not None:
            stretch = self._stretches.push(comparable(self._decoder.push(block).samples))
            self._compare(stretch or {})

    def _compare(self, stretch: Samples) -> None:
        for name in self._sums.keys() & stretch.keys():
            if self._torque in stretch:
                stamps, x = stretch[self._torque]
                y = at(stamps, stretch[name])
                both = np.isfinite(x) & np.isfinite(y)
                x, y = x[both], y[both]
                self._sums[name] += [len(x), x.sum(), y.sum(), x @ x, y @ y, x @ y]

    def hints(self) -> list[str]:
        """Return which torque of each message goes with the one that counts, one sentence each."""
        self._compare(self._stretches.rest())
        nearest: dict[str, tuple[float, str]] = {}
        for name, sums in self._sums.items():
            message = name.split(".")[0]
            nearest[message] = max(nearest.get(message, (0.0, "")), (abs(_correlation(*sums)), name))
        return [
            f"no role takes {name}, which goes with {self._torque} and has a speed beside it: is it a "
            "second motor, whose torque the mass lacks? docs/config.md has how two of them are added (motors "
            "on two axles)"
            for correlation, name in nearest.values()
            if correlation > _LEAST_CORRELATION
        ]


def _correlation(n: float, x: float, y: float, xx: float, yy: float, xy: float) -> float:
    """Return the correlation of two quantities by their sums, 0 where there is none to speak of."""
    variances = (n * xx - x * x) * (n * yy - y * y)
    return float((n * xy - x * y) / np.sqrt(variances)) if n >= _FEWEST and variances > 0.0 else 0.0


def _other_motors(config: Config) -> Iterator[Want]:
    """Yield the torques without a role of messages that have the speed of a motor, without a role too.

    What the decoder could refuse is left out.
    """
    mapped = {(source.message, source.signal) for source in config.signals.values()}
    used = config.signals[torque_role(config.signals, config.vehicle)].message
    for message in (message for database in config.databases for message in database.messages):
        free = [s for s in message.signals if (message.name, s.name) not in mapped]
        if message.name == used or message.length > FRAME_BYTES or not any(map(is_motor_speed, free)):
            continue
        for signal in free:
            unit = (signal.unit or "").strip()
            if unit and unit in UNITS["Nm"] and not (signal.is_float or signal.multiplexer_ids):
                yield Want(f"{message.name}.{signal.name}", message.name, signal.name)
