"""The section `gates`: when nothing is learned, one section per gate."""

from __future__ import annotations

from pydantic import Field

from canest.core.section import Number, Section, empty_section


class GateSection(Section):
    """One gate: on or off, and how long it stays closed after its cause has cleared."""

    enabled: bool = True
    recovery_s: Number = Field(1.0, ge=0, le=60)


class BrakeGate(GateSection):
    """Service brake by switch or pedal; ABS; parking brake."""

    pedal_pct: Number = Field(1.0, ge=0, le=100)
    #: for a vehicle that reports no friction brake: a released accelerator may mean braking
    assume_when_pedal_released: bool = False


class PossibleBrakeGate(GateSection):
    """Only where no brake and no pedal is mapped: driving without propulsion, which may be braking.

    Such deceleration looks like a hill, or like a heavier vehicle. A grade that no road has is a brake too.
    """

    #: traction below this, as specific force on the lightest vehicle, is no propulsion
    propulsion_mps2: Number = Field(0.1, ge=0, le=5)
    steepest_grade: Number = Field(0.25, gt=0, le=1)


class LowSpeedGate(GateSection):
    """Below this speed clutch and tyre behaviour are not in the model."""

    recovery_s: Number = Field(0.5, ge=0, le=60)
    min_mps: Number = Field(2.0, ge=0, le=30)


class ShiftGate(GateSection):
    """A shift in process, or a ratio that is another than just before."""

    recovery_s: Number = Field(0.6, ge=0, le=60)


class DrivelineGate(GateSection):
    """Driveline not engaged, converter not locked, clutch slipping, or shaft speeds not in ratio."""

    recovery_s: Number = Field(0.6, ge=0, le=60)
    clutch_slip_pct: Number = Field(5.0, ge=0, le=100)
    #: engine speed against the speed in use x ratio: largest relative difference of an engaged driveline
    ratio_mismatch: Number = Field(0.06, gt=0, le=1)


class RetarderGate(GateSection):
    """Retarder torque beyond this share: its reported torque is too coarse to learn from."""

    torque_pct: Number = Field(2.0, ge=0, le=100)


class TurningGate(GateSection):
    """Curves scrub the tyres: lateral acceleration (speed x yaw rate, or measured) beyond this."""

    recovery_s: Number = Field(0.5, ge=0, le=60)
    lateral_mps2: Number = Field(1.0, gt=0, le=20)


class ExcitationGate(Section):
    """Too little variation of the force to separate mass from grade (for methods that wind up)."""

    #: None: on for the estimators that need it, off for those that handle it themselves
    enabled: bool | None = None
    window_s: Number = Field(8.0, gt=0.5, le=120)
    #: standard deviation of force over the window, as share of mid-range weight
    force_share: Number = Field(0.004, ge=0, le=1)


class Gates(Section):
    """All gates, by name.

    Shifts and the driveline recover while the filter settles (0.6 s at 2 Hz): a launch is little else than
    the seconds between shifts, and its torque shows more of the mass than minutes of steady driving.
    """

    shift: ShiftGate = empty_section()
    driveline: DrivelineGate = empty_section()
    brake: BrakeGate = empty_section()
    possible_brake: PossibleBrakeGate = empty_section()
    retarder: RetarderGate = empty_section()
    low_speed: LowSpeedGate = empty_section()
    reverse: GateSection = empty_section()
    turning: TurningGate = empty_section()
    pto: GateSection = empty_section()
    stale: GateSection = empty_section()
    invalid: GateSection = empty_section()
    implausible: GateSection = empty_section()
    low_excitation: ExcitationGate = empty_section()
