"""What acts at the crank or is reported of it: gain, offset, delay, retarder, switched loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from canest.core.frames import BoolColumn
from canest.core.roles import RADPS_PER_RPM
from canest.vehicle.effects.base import Added, Effect, Parameter, Scaled, Stage
from canest.vehicle.effects.trials import DrivenData, Trial
from canest.vehicle.role_sources import AT_WHEELS
from canest.vehicle.working_columns import ModelColumns


@dataclass(frozen=True)
class TorqueGain(Scaled):
    """The engine gives another torque than it reports, in proportion."""

    name: ClassVar[str] = "torque_gain"
    words: ClassVar[str] = "misreported torque"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "true over reported net torque"
    column: ClassVar[str] = "torque_Nm"
    rarity: ClassVar[int] = 30
    cause_quantity: ClassVar[str] = "torque"
    separated_by: ClassVar[str] = "a drive with much overrun, or a coast-down"
    scales_traction: ClassVar[bool] = True
    parameters: ClassVar[dict[str, Parameter]] = {
        "gain": Parameter("", 1.0, 0.3, 2.0, 0.01, usual=0.02, fault=0.08)
    }
    gain: float = 1.0

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"true torque {self.gain:.3f} ± {std:.1g} of the reported"


@dataclass(frozen=True)
class TorqueOffset(Added):
    """Something takes a constant torque at the crank."""

    name: ClassVar[str] = "torque_offset"
    words: ClassVar[str] = "torque lost at the crank"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "torque lost at the crank"
    column: ClassVar[str] = "torque_Nm"
    sign: ClassVar[float] = -1.0
    rarity: ClassVar[int] = 80
    cause_quantity: ClassVar[str] = "torque"
    separated_by: ClassVar[str] = "the same speeds in other gears"
    parameters: ClassVar[dict[str, Parameter]] = {
        "torque_Nm": Parameter("Nm", 0.0, -1000.0, 1000.0, 10.0, fault=100.0)
    }
    torque_Nm: float = 0.0

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"{self.amount(std)} lost at the crank"


@dataclass(frozen=True)
class TorqueDelay(Effect):
    """Torque is reported later than it acts (the grid waits for it: see `canest.grid`)."""

    name: ClassVar[str] = "torque_delay"
    words: ClassVar[str] = "late torque"
    stage: ClassVar[Stage] = "sampling"
    text: ClassVar[str] = "torque reported this much later than it acts"
    rarity: ClassVar[int] = 10
    separated_by: ClassVar[str] = "throttle steps at very different speeds"
    parameters: ClassVar[dict[str, Parameter]] = {"delay_s": Parameter("s", 0.0, 0.0, 1.0, 0.04, fault=0.2)}
    delay_s: float = 0.0
    untried_reason: ClassVar[str] = "torque measured at the wheels is no late report of an engine"

    @classmethod
    def trials(cls, drives: DrivenData) -> Sequence[Trial]:
        """Return it where the engine reports its torque."""
        return [] if any(role in drives.roles for role in AT_WHEELS) else super().trials(drives)

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"torque reported {1000 * self.delay_s:.0f} ± {1000 * std:.0f} ms late"


#: accelerator position below which a pedal counts as up, %: less than half a step of SPN 91
PEDAL_UP_PCT = 0.2
#: retarder demand that is one: half a step of SPN 1715, %
_DEMANDED_PCT = 0.5
#: regimes that something may act in -> the role that shows them; else a role by its name
REGIMES = {"pedal_up": "accelerator", "brake": "brake_switch", "request": "retarder_request"}
_WHEN = {"pedal_up": "with the pedal up", "brake": "under the brake", "request": "when it is requested"}


def _acts(c: ModelColumns, cause: str, threshold: float = 0.5) -> BoolColumn:
    """Return where a regime is on, or a role above a threshold (n,)."""
    if cause == "pedal_up":
        return c.signal("accelerator", missing=100.0) < PEDAL_UP_PCT
    if cause == "request":
        return np.abs(c.signal("retarder_request", missing=0.0)) > _DEMANDED_PCT
    return c.on(REGIMES[cause]) if cause in REGIMES else c.on(cause, threshold)


@dataclass(frozen=True)
class RetarderUnreported(Effect):
    """An engine brake or retarder that acts without reporting its torque."""

    name: ClassVar[str] = "retarder_unreported"
    words: ClassVar[str] = "an unreported retarder"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "retarding torque at the crank while its cause is on"
    rarity: ClassVar[int] = 110
    separated_by: ClassVar[str] = "overrun with the retarder switched off"
    parameters: ClassVar[dict[str, Parameter]] = {
        "torque_Nm": Parameter("Nm", 0.0, 0.0, 5000.0, 50.0, fault=400.0)
    }
    torque_Nm: float = 0.0
    #: pedal_up, brake, request, or the name of a role that is on (above 0.5) while it acts
    cause: str = "pedal_up"

    @property
    def signal(self) -> str | None:
        """Return the role behind the cause."""
        return REGIMES.get(self.cause, self.cause)

    def apply(self, c: ModelColumns) -> None:
        """Take it off the net torque while the cause is on."""
        c.torque_Nm = c.torque_Nm - self.torque_Nm * _acts(c, self.cause)

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it with the pedal up, where the pedal is known."""
        known = REGIMES["pedal_up"] in drives.roles
        return [Trial(f"{cls.name} pedal up", (("cause", "pedal_up"),))] if known else []

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        when = _WHEN.get(self.cause, f"while {self.cause} is on")
        return f"an unreported retarder of {self.amount(std)} at the crank {when}"


@dataclass(frozen=True)
class SwitchedLoad(Effect):
    """Something takes power at the crank while a signal (fan, compressor, PTO) or a regime is on."""

    name: ClassVar[str] = "switched_load"
    words: ClassVar[str] = "a switched load"
    stage: ClassVar[Stage] = "crank"
    text: ClassVar[str] = "power taken at the crank while a signal or a regime is on"
    rarity: ClassVar[int] = 50
    separated_by: ClassVar[str] = "longer on and off times of its signal"
    several_by: ClassVar[str] = "signal"
    untried_reason: ClassVar[str] = "no signal of the bus that goes on and off explains anything"
    parameters: ClassVar[dict[str, Parameter]] = {
        "power_kW": Parameter("kW", 0.0, 0.0, 400.0, 2.0, fault=30.0)
    }
    settings: ClassVar[dict[str, Parameter]] = {
        "threshold": Parameter("", 0.5, -1e6, 1e6, 0.1),
        "exponent": Parameter("", 0.0, -3.0, 3.0, 1.0),
        "reference_rpm": Parameter("rpm", 1500.0, 100.0, 20_000.0, 100.0),
    }
    required: ClassVar[tuple[str, ...]] = ("signal",)
    power_kW: float = 0.0
    #: the role that switches it (as the signal map names it), or a regime: pedal_up, brake, request
    on_signal: str | None = None
    #: on above this value of the signal
    threshold: float = 0.5
    #: power follows engine speed to this power, `power_kW` at `reference_rpm` (3 for a fan, 0 constant)
    exponent: float = 0.0
    reference_rpm: float = 1500.0

    @property
    def signal(self) -> str | None:
        """Return the switching role."""
        return None if self.on_signal is None else REGIMES.get(self.on_signal, self.on_signal)

    def apply(self, c: ModelColumns) -> None:
        """Take power / speed off the net torque while on."""
        if self.on_signal is None:
            return
        # below idle there is no power to take: bounds the torque while the engine starts or stops
        speed = np.maximum(c.engine_radps, 50.0)
        reference = self.reference_rpm * RADPS_PER_RPM
        power_W = 1000.0 * self.power_kW * (speed / reference) ** self.exponent
        c.torque_Nm = c.torque_Nm - np.where(_acts(c, self.on_signal, self.threshold), power_W / speed, 0.0)

    @classmethod
    def trials(cls, drives: DrivenData) -> list[Trial]:
        """Return it for each switching signal, with constant power and with a fan's."""
        forms = ((0.0, "constant power"), (3.0, "cubic in engine speed"))
        return [
            Trial(
                f"{cls.name} {role} {form}",
                (("signal", role), ("exponent", exponent), ("threshold", level)),
            )
            for role, level in drives.switches.items()
            for exponent, form in forms
        ]

    def describe(self, std: float) -> str:
        """Return it as a part of a sentence."""
        return f"{self.amount(std)} taken while {self.on_signal} is on"
