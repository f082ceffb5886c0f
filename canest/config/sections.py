"""The smaller sections: one signal's source, the grid, the filter, the estimator and the daemon's life."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, model_validator

from canest.core.roles import KNOWN_UNITS
from canest.core.section import MisplacedError, Number, Section, Whole

#: reports that come more seldom leave a whole launch or stop between them, s
SLOWEST_PERIOD_S = 2.0
#: and of an accelerometer: the moments that it shows are no mean of what happened between them, s
SLOWEST_ACCELEROMETER_S = 0.5
#: no signal is scaled further: larger factors are slips of the pen, and overflow what is computed of them
MOST_SCALE = 1e9
Validity = Literal["j1939", "full", "source_address", "gear", "ascii"]


def _labels(entries: Any) -> Any:
    """Return a value table with every key as text: YAML reads ``1`` as a number and ``on`` as true."""
    if not isinstance(entries, dict):
        return entries
    if not entries:
        raise ValueError("found no entry, expected labels or raw numbers with the number of each")
    return {_word_of_switch(key) if isinstance(key, bool) else str(key): n for key, n in entries.items()}


class Source(Section):
    """Where one role comes from: a DBC signal, or a column of a decoded table."""

    message: str | None = None
    signal: str | None = None
    source: Whole | None = Field(None, ge=0, le=253)
    column: str | None = None
    unit: Annotated[str, StringConstraints(strip_whitespace=True)] | None = None
    #: the value describes the vehicle this much earlier than its frame is stamped
    delay_s: Number = Field(0.0, ge=0, le=2.0)
    stale_s: Number | None = Field(None, gt=0)
    #: time between two reports of a slow signal, which are then joined; null: the last one is held
    period_s: Number | None = Field(None, gt=0, le=SLOWEST_PERIOD_S)
    validity: Validity = "j1939"
    optional: bool = True
    scale: Number = 1.0
    offset: Number = 0.0
    #: label of the DBC or text of the cell, or raw number -> number; what is not listed holds no value
    map: Annotated[dict[str, Number], BeforeValidator(_labels)] | None = Field(None, min_length=1)
    invert: bool = False

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
        if not 1.0 / MOST_SCALE <= abs(self.scale) <= MOST_SCALE:
            expected = f"expected a factor between {1.0 / MOST_SCALE:g} and {MOST_SCALE:g}"
            raise MisplacedError(f"found {self.scale:g}, {expected}", "scale")
        if self.unit is not None and self.unit not in KNOWN_UNITS:
            raise MisplacedError(
                f"unknown unit, found {self.unit!r}, expected one of {', '.join(KNOWN_UNITS)}", "unit"
            )
        return self


class Sampling(Section):
    """The 50 Hz grid."""

    #: ticks go on this long after the last wanted frame (at least 2.5 `period_s` of the rarest), then they
    #: stop until the next one
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


class EstimatorSection(Section):
    """Which estimator, from which start, with which of its own options."""

    name: str = "canest"
    initial_mass_kg: Number | None = Field(None, gt=0)
    initial_grade: Number | None = Field(None, ge=-0.5, le=0.5)
    #: one standard deviation of the mass, not two: what the estimator reports
    valid_std_pct: Number = Field(4.5, gt=0, le=20)
    options: dict[str, Any] = Field(default_factory=dict)


def _word_of_switch(value: Any) -> Any:
    """Return the word that was written: YAML reads a bare ``on`` or ``off`` as true or false."""
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


def _at_home(path: str) -> str:
    """Refuse a path that begins with the home of somebody who has none here."""
    try:
        Path(path).expanduser()
    except RuntimeError:
        home = Path(path).parts[0]
        raise ValueError(f"found {path!r}, expected a path: its {home} is nobody's home here") from None
    return path


HomePath = Annotated[str, AfterValidator(_at_home)]


class Service(Section):
    """The daemon's life."""

    learn: Annotated[Literal["off", "on", "on+save"], BeforeValidator(_word_of_switch)] = "on+save"
    #: None: $STATE_DIRECTORY of systemd, else ~/.local/state/canest
    state_dir: HomePath | None = None
    save_every_s: Number = Field(60.0, ge=1)
    #: least relative standard deviation of a mass that is restored
    restore_std: Number = Field(0.03, ge=0, le=1)
    metrics_file: HomePath | None = None
    metrics_port: Whole | None = Field(None, gt=0, lt=65536)
    #: candump log of what was received, for replay
    record: HomePath | None = None
    #: est.csv of what was estimated
    log_estimates: HomePath | None = None
    #: bounded recording of the wanted frames for `canest diagnose --recorded`
    residual_dir: HomePath | None = None
    residual_max_mb: Number = Field(200.0, gt=0)
