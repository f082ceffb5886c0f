"""The curves of one drive, with a cursor, all samples and the track."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS, Status
from canest.offline.extra_columns import engaged
from canest.offline.leg_text import CALENDAR_END_S, EPOCH_S
from canest.pipeline.build import model_spec
from canest.report import figure as look
from canest.report.figure import Rows, numbers, with_gaps
from canest.report.gate_colours import look as gate_look
from canest.report.gate_colours import spans_of
from canest.report.page import Section
from canest.report.recorder import Recorder
from canest.road.sphere import EARTH_RADIUS_M
from canest.vehicle.model import LongitudinalModel
from canest.vehicle.residual import residual_N

if TYPE_CHECKING:
    from canest.config import Config
    from canest.offline.scoring import Score

#: downhill blue, uphill orange, level pale: colour-blind readers can read it
_GRADE_SCALE = [[0.0, "#0072b2"], [0.5, "#c9ced3"], [1.0, "#d55e00"]]


def drive_section(
    stamps: IntColumn,
    columns: dict[str, FloatColumn],
    config: Config,
    recorder: Recorder,
    score: Score | None,
) -> Section:
    """Return the curves of a drive with their cursor, all samples, and the track where it is known."""
    origin = recorder.first_us or 0
    truth = {}
    if score is not None:
        truth["mass_true"], truth["grade_true"] = score.truth_at(columns["clock_us"].astype(np.int64))
    stamps, columns = with_gaps(stamps, columns | truth)
    x = numbers((stamps - origin) * 1e-6, 2)
    rows = Rows(
        ["mass, t", "grade, %", "speed, km/h", "torque, N m", "gear", "force, kN", "residual, kN"],
        [1.5, 1.3, 0.9, 0.9, 0.45, 0.9, 0.8],
        "seconds since the start",
    )
    mass_true, grade_true = columns.get("mass_true"), columns.get("grade_true")
    _estimate(rows, 1, x, columns, Estimate("mass", "mass_kg", 1e-3, look.BLUE, "t"))
    if mass_true is not None and np.isfinite(mass_true).any():
        rows.line(
            1,
            x,
            numbers(mass_true / 1e3, 3),
            "true mass",
            look.Stroke(look.INK, dash="dash"),
            hover="%{y:.2f} t",
        )
    _estimate(rows, 2, x, columns, Estimate("grade", "grade", 1e2, look.GREEN, "%"))
    if grade_true is not None and np.isfinite(grade_true).any():
        rows.line(
            2,
            x,
            numbers(grade_true * 1e2, 3),
            "true grade",
            look.Stroke(look.INK, dash="dash"),
            hover="%{y:.2f} %",
        )
    _motion(rows, x, columns, config)
    residual = residual_N(
        columns["mass_kg"], columns["accel_mps2"], columns["grade"], columns["mu"], columns["force_N"]
    )
    residual = np.where(columns["gate"] == 0, residual, np.nan)
    rows.line(
        7, x, numbers(residual / 1e3, 3), "residual", look.Stroke(look.RED, width=1.0), hover="%{y:.2f} kN"
    )
    rows.follow("residual_N", 1e-3)
    spans = spans_of(recorder.closures(), origin)
    for gate in sorted(spans, key=lambda name: sum(end - first for first, end in spans[name])):
        rows.spans(spans[gate], f"gate: {gate}", gate_look(gate)[0])
    _link(rows, x, stamps, columns, config, recorder)
    return Section(
        "The drive",
        text="Bands are two standard deviations. Shaded: a gate is closed, the estimator keeps what it "
        "knows. The residual is m (a + g sin β + g μ cos β) - F with the estimate of the moment, where open.",
        figure=rows.to_json(),
    )


def _motion(rows: Rows, x: list[float | None], columns: dict[str, FloatColumn], config: Config) -> None:
    """Draw what the model was given, rows 3 to 6; a gap where it is not known."""
    rows.line(
        3,
        x,
        numbers(columns["raw_speed_mps"] * 3.6, 2),
        "speed",
        look.Stroke(look.ORANGE),
        hover="%{y:.1f} km/h",
    )
    rows.follow("speed_mps", 3.6)
    torque = (
        "torque at the wheels" if LongitudinalModel(model_spec(config)).at_wheels else "net engine torque"
    )
    rows.line(
        4,
        x,
        numbers(columns["raw_torque_Nm"], 0),
        torque,
        look.Stroke(look.GREEN, width=1.2),
        hover="%{y:,.0f} N m",
    )
    rows.follow("torque_Nm", 1.0)
    rows.line(
        5, x, numbers(engaged(columns["gear"]), 0), "gear", look.Stroke(look.MUTED, width=1.3, shape="hv")
    )
    rows.follow("gear", 1.0)
    # the filter repeats the last force where there is none
    known = np.where(np.isfinite(columns["raw_force_N"]), 1e-3, np.nan)
    rows.line(
        6,
        x,
        numbers(columns["traction_N"] * known, 2),
        "traction",
        look.Stroke(look.ORANGE, width=1.2, dash="dot"),
        hover="%{y:.1f} kN",
    )
    rows.follow("traction_N", 1e-3)
    rows.line(
        6,
        x,
        numbers(columns["force_N"] * known, 2),
        "net force",
        look.Stroke(look.BLUE, width=1.2),
        hover="%{y:.1f} kN",
    )
    rows.follow("force_N", 1e-3)


class Estimate(NamedTuple):
    """How an estimate is drawn: its column and the factor to the unit of its row."""

    name: str
    column: str
    factor: float
    colour: str
    unit: str

    @property
    def std(self) -> str:
        """Return the column of its standard deviation."""
        return {"mass_kg": "mass_std_kg", "grade": "grade_std"}[self.column]


def _estimate(
    rows: Rows, row: int, x: list[float | None], columns: dict[str, FloatColumn], drawn: Estimate
) -> None:
    """Draw an estimate with its band of two standard deviations, to three decimals."""
    value, std = drawn.factor * columns[drawn.column], drawn.factor * columns[drawn.std]
    rows.band(row, x, numbers(value - 2 * std, 3), numbers(value + 2 * std, 3), drawn.colour, drawn.name)
    rows.follow(drawn.column, drawn.factor, 2.0, drawn.std)
    rows.traces[-2]["meta"] = {**rows.traces[-1]["meta"], "times": -2.0}
    stroke = look.Stroke(drawn.colour)
    rows.line(row, x, numbers(value, 3), drawn.name, stroke, hover="%{y:.2f} " + drawn.unit)
    rows.follow(drawn.column, drawn.factor, 0.0, drawn.std)


def _link(
    rows: Rows,
    x: list[float | None],
    stamps: IntColumn,
    columns: dict[str, FloatColumn],
    config: Config,
    recorder: Recorder,
) -> None:
    """Give the rows their cursor, with all samples behind it."""
    origin_s = (recorder.first_us or 0) * 1e-6
    v = config.vehicle
    more: dict[str, Any] = {"detail": recorder.detail.to_json()}
    track = track_of(recorder.track.columns(), stamps, columns, recorder.first_us or 0)
    if track:
        more["track"] = track
    rows.link(
        x,
        columns["distance_m"] / 1e3,
        columns["status"] == Status.VALID,
        items=_items(config),
        start_s=origin_s if EPOCH_S < origin_s < CALENDAR_END_S else None,
        robust=["yaxis7"],
        limits={"yaxis": [0.9e-3 * v.mass_min_kg, 1.1e-3 * v.mass_max_kg]},
        smallest={"yaxis": 0.02e-3 * v.mass_max_kg, "yaxis2": 2.0, "yaxis3": 10.0, "yaxis5": 3.0},
        **more,
    )


def _items(config: Config) -> list[dict[str, Any]]:
    """Return what the cursor shows of a sample, in order."""

    def value(name: str, column: str, factor: float, unit: str, digits: int, **more: Any) -> dict[str, Any]:
        return {"name": name, "column": column, "factor": factor, "unit": unit, "digits": digits, **more}

    gates = {code: f"{label}: {gate_look(label)[1]}" for code, label in LABELS.items() if code}
    return [
        value("distance", "distance_m", 1e-3, "km", 3),
        value("mass", "mass_kg", 1.0, "kg", 0, std="mass_std_kg"),
        value("grade", "grade", 1e2, "%", 2, std="grade_std"),
        {"name": "status", "column": "status", "words": STATUS_LABELS},
        {"name": "gate", "column": "gate", "words": {0: "open: the estimator learns", **gates}},
        value("speed", "speed_mps", 3.6, "km/h", 1),
        value("torque", "torque_Nm", 1.0, "N m", 0),
        value("gear", "gear", 1.0, "", 0, optional=True),
        value("traction", "traction_N", 1e-3, "kN", 2),
        value("net force", "force_N", 1e-3, "kN", 2),
        value("residual", "residual_N", 1e-3, "kN", 2),
    ]


def track_of(
    positions: FloatColumn, stamps: IntColumn, columns: dict[str, FloatColumn], origin_us: int
) -> dict[str, Any]:
    """Return the track on a plane, km from its middle, with what colours it; empty without positions.

    positions: stamps, us, latitudes and longitudes, deg, (3, n).
    """
    t_us, latitude, longitude = positions
    if len(t_us) < 2:
        return {}
    middle_lat, middle_lon = float(np.median(latitude)), float(np.median(longitude))
    turned = (longitude - middle_lon + 180.0) % 360.0 - 180.0
    km = np.radians(1.0) * EARTH_RADIUS_M / 1e3
    # NaN where a curve breaks, and before the first estimate
    values = {name: np.interp(t_us, stamps, columns[name]) for name in ("grade", "mass_kg")}
    return {
        "t": numbers((t_us - origin_us) * 1e-6, 2),
        "east_km": numbers(turned * km * np.cos(np.radians(middle_lat)), 4),
        "north_km": numbers((latitude - middle_lat) * km, 4),
        "colours": {
            "grade": {"values": numbers(1e2 * values["grade"], 2), "unit": "%", "scale": _GRADE_SCALE},
            "mass": {"values": numbers(1e-3 * values["mass_kg"], 3), "unit": "t", "scale": "Cividis"},
        },
    }
