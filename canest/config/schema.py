"""What a config may say, with units in the names and bounds on every number.

`extra="forbid"` everywhere: a misspelt key is an error, never a silent default.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from canest.config.agreement import MisplacedError, refuse_contradictions
from canest.config.origins import Origins
from canest.roles import KNOWN_UNITS


class Section(BaseModel):
    """Base of all sections: unknown keys refused, values immutable, no silent type juggling."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, str_strip_whitespace=True, defer_build=True
    )


def _number_not_bool(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("found yes/no, expected a number")  # noqa: TRY004 - pydantic wants ValueError
    return value


def _word_of_switch(value: Any) -> Any:
    """Return the word that was written: YAML reads a bare ``on`` or ``off`` as true or false."""
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


def _word_of_number(value: Any) -> Any:
    """Return a name that was written as a whole number."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _section() -> Any:
    """Return the default of a section: as if it stood empty in the config, and validated with it.

    An instance would build a validator of its own at import, 1 ms each.
    """
    return Field(default_factory=dict, validate_default=True)


Number = Annotated[float, BeforeValidator(_number_not_bool)]
Whole = Annotated[int, BeforeValidator(_number_not_bool)]


class Retarder(Section):
    """A retarder that reports its torque (ERC1)."""

    reference_torque_Nm: Number = Field(gt=0, le=10_000)
    #: where its torque acts: at the crank (through the gear) or at the transmission output shaft
    location: Literal["crank", "output_shaft"] = "crank"


class Accelerometer(Section):
    """Facts of the longitudinal accelerometer, where known."""

    pitch_rad_per_mps2: Number | None = Field(None, ge=0, le=0.1)


class Vehicle(Section):
    """Facts of the vehicle that an engineer would know."""

    name: str = "vehicle"
    key: str = ""
    mass_min_kg: Number = Field(gt=50, le=500_000)
    mass_max_kg: Number = Field(gt=50, le=500_000)
    wheel_radius_m: Number = Field(gt=0.1, lt=2.0)
    wheel_inertia_kgm2: Number = Field(0.0, ge=0, le=2_000)
    final_drive: Number = Field(gt=0.1, lt=30)
    gear_ratios: dict[int, Number] = Field(default_factory=dict)
    driveline_efficiency: Number = Field(0.96, gt=0.5, le=1.0)
    gear_efficiency: dict[int, Number] = Field(default_factory=dict)
    engine_inertia_kgm2: Number = Field(0.0, ge=0, le=50)
    reference_torque_Nm: Number | None = Field(None, gt=1, le=65_000)
    friction_torque_pct: Number = Field(0.0, ge=-125, le=125)
    retarder: Retarder | None = None
    drag_area_m2: Number = Field(gt=0, lt=30)
    air_density_kgpm3: Number = Field(1.2, gt=0.5, lt=1.6)
    rolling_resistance: Number = Field(gt=0, lt=0.1)
    accelerometer: Accelerometer = _section()

    @model_validator(mode="after")
    def _consistent(self) -> Vehicle:
        if self.mass_min_kg >= self.mass_max_kg:
            raise MisplacedError(
                f"found {self.mass_min_kg:g}, expected less than mass_max_kg, {self.mass_max_kg:g}",
                "mass_min_kg",
            )
        for gear, ratio in self.gear_ratios.items():
            if not 0.1 < ratio < 50:
                raise MisplacedError(f"found {ratio:g}, expected between 0.1 and 50", "gear_ratios", gear)
        for gear, efficiency in self.gear_efficiency.items():
            if not 0.5 < efficiency <= 1:
                raise MisplacedError(
                    f"found {efficiency:g}, expected above 0.5 and up to 1", "gear_efficiency", gear
                )
        return self


Validity = Literal["j1939", "full", "source_address", "gear", "ascii"]


class Source(Section):
    """Where one role comes from: a DBC signal, or a column of a decoded table."""

    message: str | None = None
    signal: str | None = None
    source: Whole | None = Field(None, ge=0, le=253)
    column: str | None = None
    unit: str | None = None
    #: the value describes the vehicle this much earlier than its frame is stamped
    delay_s: Number = Field(0.0, ge=0, le=2.0)
    stale_s: Number | None = Field(None, gt=0)
    validity: Validity = "j1939"
    optional: bool = True
    scale: Number = 1.0

    @model_validator(mode="after")
    def _one_source(self) -> Source:
        dbc = self.message is not None and self.signal is not None
        if dbc == (self.column is not None) or (self.message is None) != (self.signal is None):
            raise ValueError("give either message and signal, or column")
        if self.column is not None and self.source is not None:
            raise MisplacedError(
                f"found {self.source}, expected no such key: a column has no address", "source"
            )
        if self.scale == 0:
            raise MisplacedError("found 0, expected a factor: with 0 every value is lost", "scale")
        if self.unit is not None and self.unit not in KNOWN_UNITS:
            raise MisplacedError(
                f"unknown unit, found {self.unit!r}, expected one of {', '.join(KNOWN_UNITS)}", "unit"
            )
        return self


class Sampling(Section):
    """The 50 Hz grid."""

    #: ticks go on this long after the last wanted frame, then the grid sleeps until the next one
    hold_s: Number = Field(2.0, ge=0.1, le=60)
    #: a stamp that goes back further than this starts a new epoch; less is clamped and counted
    max_backward_s: Number = Field(0.5, ge=0, le=60)
    #: name of the time column (seconds) of decoded tables
    time_column: str = "t_s"


class FilterSection(Section):
    """The Butterworth that the whole regression passes (order and -3 dB frequency)."""

    order: Whole = Field(2, ge=1, le=6)
    cutoff_hz: Number = Field(2.0, ge=0.05)

    @model_validator(mode="after")
    def _below_nyquist(self) -> FilterSection:
        if self.cutoff_hz >= 25:
            raise MisplacedError(
                f"found {self.cutoff_hz:g} Hz, expected below 25 Hz, half the 50 Hz sampling rate: "
                "no digital Butterworth exists there; choose e.g. 2",
                "cutoff_hz",
            )
        return self


class GateSection(Section):
    """One gate: on or off, and how long it stays closed after its cause has cleared."""

    enabled: bool = True
    recovery_s: Number = Field(1.0, ge=0, le=60)


class BrakeGate(GateSection):
    """Service brake by switch or pedal; ABS; parking brake."""

    pedal_pct: Number = Field(1.0, ge=0, le=100)
    #: for a vehicle that reports no friction brake: a released accelerator may mean braking
    assume_when_pedal_released: bool = False


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
    #: engine speed against output shaft x ratio: largest relative difference of an engaged driveline
    ratio_mismatch: Number = Field(0.06, gt=0, le=1)


class RetarderGate(GateSection):
    """Retarder torque beyond this share: its reported torque is too coarse to learn from."""

    torque_pct: Number = Field(2.0, ge=0, le=100)


class TurningGate(GateSection):
    """Curves scrub the tyres: lateral acceleration (speed x yaw rate, or measured) beyond this."""

    recovery_s: Number = Field(0.5, ge=0, le=60)
    lateral_mps2: Number = Field(1.0, gt=0, le=20)


class ExcitationGate(Section):
    """Too little variation of the force to tell mass from grade (for methods that wind up)."""

    #: None: on for the estimators that need it, off for those that handle it themselves
    enabled: bool | None = None
    window_s: Number = Field(8.0, gt=0.5, le=120)
    #: standard deviation of force over the window, as share of mid-range weight
    force_share: Number = Field(0.004, ge=0, le=1)


class Gates(Section):
    """All gates, by name.

    Shifts and the driveline recover while the filter settles (0.6 s at 2 Hz): a launch is little else than
    the seconds between shifts, and its torque tells more of the mass than minutes of steady driving.
    """

    shift: ShiftGate = _section()
    driveline: DrivelineGate = _section()
    brake: BrakeGate = _section()
    retarder: RetarderGate = _section()
    low_speed: LowSpeedGate = _section()
    reverse: GateSection = _section()
    turning: TurningGate = _section()
    pto: GateSection = _section()
    stale: GateSection = _section()
    invalid: GateSection = _section()
    implausible: GateSection = _section()
    low_excitation: ExcitationGate = _section()


class EstimatorSection(Section):
    """Which estimator, from which start, with which of its own options."""

    name: str = "canest"
    initial_mass_kg: Number | None = Field(None, gt=0)
    initial_grade: Number | None = Field(None, ge=-0.5, le=0.5)
    options: dict[str, Any] = Field(default_factory=dict)


class Bus(Section):
    """The CAN interface, as python-can names it."""

    interface: str = "socketcan"
    #: some interfaces number theirs (kvaser, vector, ...)
    channel: Annotated[str, BeforeValidator(_word_of_number)] = "vcan0"
    bitrate: Whole | None = Field(None, gt=0)
    options: dict[str, Any] = Field(default_factory=dict)


class Name(Section):
    """The 64-bit J1939 NAME (ISO 11783-5): who we say we are."""

    identity: Whole = Field(1, ge=0, lt=2**21)
    manufacturer: Whole = Field(0, ge=0, lt=2**11)
    ecu_instance: Whole = Field(0, ge=0, lt=8)
    function_instance: Whole = Field(0, ge=0, lt=32)
    #: 33 = system monitor, valid for any industry group
    function: Whole = Field(33, ge=0, lt=256)
    vehicle_system: Whole = Field(0, ge=0, lt=128)
    vehicle_system_instance: Whole = Field(0, ge=0, lt=16)
    industry_group: Whole = Field(0, ge=0, lt=8)
    arbitrary_address_capable: bool = True


class Broadcast(Section):
    """What goes back on the bus."""

    #: None: only on a virtual bus (vcan, virtual, udp_multicast); a physical bus must be asked for
    enabled: bool | None = None
    #: no transmission at all, not even an address claim
    listen_only: bool = False
    pgn: Whole = Field(0xFF5A, ge=0xFF00, le=0x1FFFF)
    priority: Whole = Field(6, ge=0, le=7)
    #: `canest` learns five times a second; between, grade is carried on
    rate_hz: Number = Field(5.0, gt=0, le=50)
    preferred_address: Whole = Field(158, ge=128, le=247)
    name: Name = _section()
    #: also as SPN 1760 in PGN 65136, 1 Hz, only while valid
    cvw: bool = False
    #: also as SPN 7432 in PGN 61651: map-based controllers may act on it
    pcc1: bool = False

    @model_validator(mode="after")
    def _proprietary_b(self) -> Broadcast:
        if not (0xFF00 <= self.pgn <= 0xFFFF or 0x1FF00 <= self.pgn <= 0x1FFFF):
            raise MisplacedError(
                f"found {self.pgn:#x}, expected a proprietary-B group, 0xFF00..0xFFFF or 0x1FF00..0x1FFFF",
                "pgn",
            )
        return self


class Service(Section):
    """The daemon's life."""

    learn: Annotated[Literal["off", "on", "on+save"], BeforeValidator(_word_of_switch)] = "on+save"
    #: None: $STATE_DIRECTORY of systemd, else ~/.local/state/canest
    state_dir: str | None = None
    save_every_s: Number = Field(60.0, ge=1)
    #: a remembered mass is restored with at least this much doubt, relative
    restore_std: Number = Field(0.03, ge=0, le=1)
    metrics_file: str | None = None
    metrics_port: Whole | None = Field(None, gt=0, lt=65536)
    #: candump log of what was received, for replay
    record: str | None = None
    #: est.csv of what was estimated
    log_estimates: str | None = None
    #: bounded recording of the wanted frames for `canest diagnose --recorded`
    residual_dir: str | None = None
    residual_max_mb: Number = Field(200.0, gt=0)


def _named(signals: object) -> object:
    """Leave out roles that are set to nothing: `--set signals.altitude=null` takes a signal away."""
    if isinstance(signals, dict):
        return {role: source for role, source in signals.items() if source is not None}
    return signals


class Config(Section):
    """A whole config."""

    _origins: Origins = PrivateAttr(default_factory=Origins)

    vehicle: Vehicle
    dbc: tuple[str, ...] = ("j1939.dbc",)
    signals: Annotated[dict[str, Source], BeforeValidator(_named)]
    sampling: Sampling = _section()
    filter: FilterSection = _section()
    gates: Gates = _section()
    estimator: EstimatorSection = _section()
    effects: tuple[dict[str, Any], ...] = ()
    bus: Bus = _section()
    broadcast: Broadcast = _section()
    service: Service = _section()

    def note_origins(self, origins: Origins) -> None:
        """Remember where keys were written, for messages."""
        self._origins = origins

    def at(self, key: str) -> str:
        """Return a key behind the place where it was written: "truck.yaml:31: signals.gear"."""
        return ": ".join(part for part in (self._origins.of(tuple(key.split("."))), key) if part)

    @model_validator(mode="after")
    def _sections_agree(self) -> Config:
        refuse_contradictions(self)
        return self
