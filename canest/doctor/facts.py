"""What in a log contradicts the config: for `canest check`, and for a replay beside its estimates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.core.roles import ROLES
from canest.decode.database import is_j1939
from canest.decode.validity import highest_valid
from canest.decode.value_table import labels_of
from canest.doctor.consistency import ConsistencyCheck
from canest.doctor.declared_range import DeclaredRangeCheck
from canest.doctor.gearbox_states import GearboxStateCheck
from canest.doctor.held_torque import HeldTorqueCheck
from canest.doctor.raw_values import means_no_value
from canest.doctor.reasons import why_no_time
from canest.doctor.reference_torque import ReferenceTorqueCheck
from canest.doctor.road_speeds import RoadSpeedCheck
from canest.doctor.signs import SignCheck
from canest.doctor.silent_brake import SilentBrakeCheck
from canest.doctor.stretches import Samples, Stretches, comparable
from canest.doctor.switches import SwitchCheck
from canest.doctor.torque_course import TorqueCourseCheck
from canest.doctor.torque_samples import TorqueSampleCheck
from canest.pipeline.signal_map import signal_of

if TYPE_CHECKING:
    from canest.config import Config
    from canest.decode.counters import Counters
    from canest.pipeline.intake import Intake

#: reserved numbers of this share of the samples are worth a note
_RESERVED_SHARE = 0.01
#: fields of so many bits end in "not available" on other buses too
_WIDE = 8


class FactsCheck:
    """Takes the decoded samples of a stream; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._config, self._stretches = config, Stretches(ROLES)
        self._consistency, self._torque = ConsistencyCheck(config), TorqueCourseCheck(config)
        self._reference_torque = ReferenceTorqueCheck(config)
        self._checks = (
            self._consistency, SwitchCheck(config), SilentBrakeCheck(config), self._torque,
            TorqueSampleCheck(config), DeclaredRangeCheck(config), RoadSpeedCheck(config), SignCheck(config),
            GearboxStateCheck(config), HeldTorqueCheck(config),
        )  # fmt: skip

    def push(self, samples: Samples) -> None:
        """Take the samples of a block: role -> t_us, values (n,)."""
        stretch = self._stretches.push(samples)
        if stretch is not None:
            self._compare(stretch)

    def _compare(self, stretch: Samples) -> None:
        compared = comparable(stretch)
        for check in (*self._checks, self._reference_torque):
            check.push(compared)

    def hints(self) -> list[str]:
        """Return what does not fit, one sentence each."""
        self._compare(self._stretches.rest())
        return [hint for check in self._checks for hint in check.hints()]

    def unfit(self) -> str:
        """Return why no estimate can be right, '' where it may be; of what `hints` has compared."""
        return self._consistency.missing_table() or self._torque.fault()

    def unconfirmed(self) -> list[str]:
        """Return what may be right or wrong, as nothing shows it, one sentence each."""
        return self._reference_torque.notes()

    def notes(self, intake: Intake) -> list[str]:
        """Return the hints, where time passes, and what no value came of. intake: that of the same stream."""
        hints = [] if why_no_time(intake.clock) else self.hints()
        return hints + self.unconfirmed() + reserved_notes(self._config, intake.decoder.counters)


def reserved_notes(config: Config, counters: Counters) -> list[str]:
    """Return which signals lose samples by the rule of J1939 though their message is none of J1939."""
    notes = []
    for role, source in config.signals.items():
        seen = counters.of_role(role).values()
        lost = sum(counts.not_available + counts.error_value for counts in seen)
        count = lost + sum(counts.valid for counts in seen)
        if lost >= max(1.0, _RESERVED_SHARE * count) and _is_guarded(config, role):
            notes.append(
                f"{role}: {lost:,} of {count:,} samples hold a number that J1939 reserves and count as no "
                f"value, but {source.message}.{source.signal} is no J1939 signal: if they are values, "
                f"signals.{role} needs validity: full (canest check shows the numbers)"
            )
    return notes


def _is_guarded(config: Config, role: str) -> bool:
    """Return whether numbers count as no value by a rule that the DBC does not make."""
    source, known = config.signals[role], signal_of(config, role)
    if known is None or source.map:
        return False
    message, signal = known
    if is_j1939(message) or source.validity not in ("j1939", "gear"):
        return False
    if signal.is_signed or signal.is_float or signal.length >= _WIDE:
        return False
    highest = highest_valid(signal.length, source.validity, signal.spn)
    reserved = [label for raw, label in labels_of(signal).items() if raw > highest]
    return not reserved or not all(map(means_no_value, reserved))
