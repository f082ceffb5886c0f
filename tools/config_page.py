"""Writes docs/config.md from the schema: every key with unit, default and bounds, so it cannot be wrong.

``python tools/config_page.py --write``; a test holds page and schema together.
"""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from canest.config.schema import Config, Source
from canest.core.roles import ROLES, UNITS
from canest.decode.validity import RULES
from canest.estimators.base import REGISTRY
from canest.vehicle.effects import EFFECTS
from canest.vehicle.facts import Retarder

PAGE = Path(__file__).resolve().parent.parent / "docs" / "config.md"

RECOVERY = "stays closed this long after its cause has cleared, s"
ENABLED = "false: this gate never closes"

MEANINGS: dict[str, str] = {
    "vehicle.name": "for people",
    "vehicle.key": "what a learned mass belongs to: VIN or fleet number",
    "vehicle.mass_min_kg": "lightest the vehicle can be, kg; bounds every estimate",
    "vehicle.mass_max_kg": "heaviest it can be, kg",
    "vehicle.wheel_radius_m": "dynamic rolling radius of the driven wheels, m",
    "vehicle.wheel_inertia_kgm2": "all wheels together, kg m²",
    "vehicle.final_drive": "ratio of the driven axle",
    "vehicle.gear_ratios": "gear number: transmission ratio; needed unless the bus sends the ratio",
    "vehicle.driveline_efficiency": "crank to wheels, where `gear_efficiency` says nothing else",
    "vehicle.gear_efficiency": "gear number: efficiency, where a gear differs (a direct gear)",
    "vehicle.engine_inertia_kgm2": "at the crank, with flywheel, kg m²",
    "vehicle.reference_torque_Nm": "100 % of the engine's percent torques, N m; SPN 544 wins once heard",
    "vehicle.friction_torque_pct": "engine friction where SPN 514 is not sent, % of reference",
    "vehicle.retarder": "leave out when there is none, or when its torque is not reported",
    "vehicle.retarder.reference_torque_Nm": "100 % of the retarder's percent torque, N m",
    "vehicle.retarder.location": "where its torque acts",
    "vehicle.drag_area_m2": "drag coefficient times frontal area, m²",
    "vehicle.air_density_kgpm3": "used until ambient pressure and temperature are heard, kg/m³",
    "vehicle.rolling_resistance": "coefficient, N per N",
    "vehicle.accelerometer.pitch_rad_per_mps2": "body pitch (squat), rad per m/s²; null: learned",
    "dbc": "files, beside the config or among the shipped ones; an empty list for tables",
    "signals": "role: where it comes from; see below",
    "sampling.hold_s": "ticks go on this long after the last wanted frame, then the grid sleeps, s",
    "sampling.max_backward_s": "a clock set back further starts a new epoch; less is mended and counted, s",
    "sampling.time_column": "column of decoded tables that holds the time: seconds, or ISO 8601",
    "filter.order": "of the Butterworth that the whole regression passes",
    "filter.cutoff_hz": "its -3 dB frequency, below 25 Hz (half the sampling rate)",
    "gates.*.enabled": ENABLED,
    "gates.*.recovery_s": RECOVERY,
    "gates.driveline.clutch_slip_pct": "closes beyond this slip, %",
    "gates.driveline.ratio_mismatch": "closes when engine and shaft speed differ this much from the ratio",
    "gates.brake.pedal_pct": "closes beyond this pedal position, %",
    "gates.brake.assume_when_pedal_released": "a released accelerator counts as possible braking",
    "gates.retarder.torque_pct": "closes beyond this torque, % of the retarder's reference",
    "gates.low_speed.min_mps": "closes below this speed, m/s",
    "gates.turning.lateral_mps2": "closes beyond this lateral acceleration, m/s²",
    "gates.low_excitation.enabled": "null: on for the estimators that wind up without excitation",
    "gates.low_excitation.window_s": "how far back variation counts, s",
    "gates.low_excitation.force_share": "least standard deviation of the force, as share of the weight",
    "estimator.name": "one of " + ", ".join(REGISTRY),
    "estimator.initial_mass_kg": "start value, kg; null: the estimator chooses",
    "estimator.initial_grade": "start value, ratio",
    "estimator.options": "the estimator's own options; see estimators.md",
    "effects": "what the plain model lacks; see below",
    "bus.interface": "as python-can names it: socketcan, udp_multicast, virtual, slcan, pcan, ...",
    "bus.channel": "as python-can names it: can0, vcan0, ...",
    "bus.bitrate": "bit/s, for the interfaces that set it themselves",
    "bus.options": "further arguments for python-can",
    "broadcast.enabled": "null: only on a virtual bus; a physical bus must be asked for",
    "broadcast.listen_only": "no transmission at all, not even an address claim",
    "broadcast.pgn": "proprietary-B group of `CanestEstimate`",
    "broadcast.priority": "J1939 priority",
    "broadcast.rate_hz": "frames per second",
    "broadcast.preferred_address": "claimed first; another free one is taken on conflict",
    "broadcast.name.identity": "identity number of the J1939 NAME",
    "broadcast.name.manufacturer": "manufacturer code",
    "broadcast.name.ecu_instance": "ECU instance",
    "broadcast.name.function_instance": "function instance",
    "broadcast.name.function": "function code",
    "broadcast.name.vehicle_system": "vehicle system",
    "broadcast.name.vehicle_system_instance": "vehicle system instance",
    "broadcast.name.industry_group": "industry group",
    "broadcast.name.arbitrary_address_capable": "may take another address on conflict",
    "broadcast.cvw": "send the mass as SPN 1760 in PGN 65136 too, only while valid",
    "broadcast.pcc1": "send the grade as SPN 7432 in PGN 61651 too: map-based controllers may act on it",
    "service.learn": "off: neither restore nor save what was learned; on: restore; on+save: both",
    "service.state_dir": "null: systemd's $STATE_DIRECTORY, else ~/.local/state/canest",
    "service.save_every_s": "how often what was learned is saved, s",
    "service.restore_std": "least relative doubt of a remembered mass",
    "service.metrics_file": "Prometheus text file for node_exporter; null: canest.prom in the runtime "
    "directory under systemd, else none",
    "service.metrics_port": "serve the same over HTTP on this port",
    "service.record": "candump log of everything received",
    "service.log_estimates": "est.csv of every estimate, 50 Hz",
    "service.residual_dir": "bounded recording for `canest diagnose --recorded`; null: in the state "
    "directory under systemd, else none",
    "service.residual_max_mb": "bound of that recording, MB",
}

SOURCE_MEANINGS: dict[str, str] = {
    "message": "DBC message",
    "signal": "DBC signal of that message",
    "source": "J1939 address that counts; without it the first address with valid values does",
    "column": "instead of message and signal: column of a decoded table",
    "unit": "of the source, where the DBC does not say it (tables)",
    "delay_s": "the value describes the vehicle this much earlier than it is stamped, s",
    "stale_s": "a sample older than this counts as missing, s; null: the role's own limit (below)",
    "validity": "which raw values count; see below",
    "optional": "false: the stale gate closes when this role is missing",
    "scale": "factor on top of everything, e.g. -1 for a sensor mounted backwards",
}

HEAD = """# Config

One YAML file describes a vehicle, where its signals are, and what the daemon does. Unknown keys, numbers
out of range, units of another dimension and signals that no DBC has are refused with file, line and key;
`canest check` says so without running anything. `--set dotted.key=value` overrides any key for one call.

Start from a shipped config (`class8`, `class8-j1587`, `kenworth`, `bmw-i3`, `testcar`, `vcan`): their names
work wherever a path does. This page is made by `python tools/config_page.py --write`.
"""


def keys(model: type[BaseModel], instance: Any = None, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield (dotted key, field, default) of every key that holds a value."""
    for name, field in model.model_fields.items():
        default = (
            getattr(instance, name) if instance is not None else field.get_default(call_default_factory=True)
        )
        section = _section(field.annotation)
        if section is None:
            yield path + name, field, default
            continue
        if default == {}:  # as if it stood empty in the config
            default = section()
        if not isinstance(default, BaseModel):
            if section is Retarder:
                yield path + name, field, None
            default = None
        yield from keys(section, default, f"{path}{name}.")


def _section(annotation: Any) -> type[BaseModel] | None:
    options = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    return next((o for o in options if isinstance(o, type) and issubclass(o, BaseModel)), None)


def meaning(key: str) -> str:
    """Return what a key means. Errors: KeyError for a key that nobody has described."""
    if key in MEANINGS:
        return MEANINGS[key]
    head, _, last = key.rpartition(".")
    return MEANINGS[f"{head.split('.')[0]}.*.{last}"]


def _default(value: Any) -> str:
    if value is PydanticUndefined or value is Ellipsis:
        return "**needed**"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if value in ({}, (), [], ""):
        return "empty"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(str, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _bounds(field: Any) -> str:
    signs = {"gt": "> ", "ge": "≥ ", "lt": "< ", "le": "≤ "}
    found = [
        f"{sign}{_default(getattr(m, name))}"
        for m in field.metadata
        for name, sign in signs.items()
        if hasattr(m, name)
    ]
    annotation = field.annotation
    if get_origin(annotation) is Literal:
        return ", ".join(get_args(annotation))
    return ", ".join(found)


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def page() -> str:
    """Return the page's text."""
    parts = [HEAD]
    section = ""
    rows: list[list[str]] = []
    for key, field, default in [*keys(Config), ("", None, None)]:
        top = key.split(".")[0] if "." in key or not key else "top"
        if top != section:
            if rows:
                title = f"`{section}`" if section != "top" else "Top level" if rows[1:] else rows[0][0]
                parts.append(f"## {title}\n\n" + _table(["key", "default", "allowed", "meaning"], rows))
            section, rows = top, []
        if key:
            shown = _default(PydanticUndefined if field.is_required() else default)
            if key.startswith("broadcast.pgn"):
                shown = hex(default).upper().replace("X", "x")
            rows.append([f"`{key}`", shown, _bounds(field), meaning(key)])
    parts.append(_signals())
    parts.append(_effects())
    return "\n".join(parts)


def _signals() -> str:
    rows = [
        [f"`{name}`", _default(PydanticUndefined if field.is_required() else field.default), _bounds(field),
         SOURCE_MEANINGS[name]]
        for name, field in Source.model_fields.items()
    ]  # fmt: skip
    text = "## One entry of `signals`\n\n"
    text += (
        "`role: {message: EEC1, signal: EngSpeed, source: 0x00}` or `role: {column: v_kmh, unit: km/h}`.\n\n"
    )
    text += _table(["key", "default", "allowed", "meaning"], rows)
    text += "\nValidity rules:\n\n" + _table(["rule", "accepts"], [[f"`{k}`", v] for k, v in RULES.items()])
    rows = [
        [
            f"`{r.name}`",
            r.unit or "-",
            "never" if r.stale_s == float("inf") else f"{r.stale_s:g}",
            r.text,
        ]
        for r in ROLES.values()
    ]
    text += (
        "\n## Roles\n\nOne torque and one speed are needed, and where a vehicle has several gears one way "
        "to the ratio\n(`gear_ratio`, `gear`, or `engine_speed` with `output_shaft_speed` or "
        "`vehicle_speed`); everything else helps\nor guards, but for "
        "`selected_gear`, `input_shaft_speed`,\n`steering_angle` and `reported_mass`, which only "
        "`canest check` shows.\nEEC1 and CCVS1 alone are enough.\n\n"
    )
    text += _table(["role", "unit", "stale after, s", "what it is"], rows)
    rows = [[inside or "none", ", ".join(u for u in units if u)] for inside, units in UNITS.items() if inside]
    return text + "\nUnits that are converted:\n\n" + _table(["into", "from"], rows)


def _effects() -> str:
    rows = []
    for effect in EFFECTS.values():
        parameters = "; ".join(
            f"`{name}` ({p.unit or 'ratio'}, neutral {p.neutral:g}, {p.low:g} to {p.high:g})"
            for name, p in effect.parameters.items()
        )
        rows.append([f"`{effect.name}`", parameters, effect.text])
    text = (
        "## Effects\n\nA list, e.g. `effects: [{effect: torque_gain, gain: 0.95}]`; `canest diagnose` writes "
    )
    text += "it. At its neutral value an effect changes nothing.\n"
    text += "`driveline_loss` may name one `gear` of `vehicle.gear_ratios`; without one it acts in all.\n"
    text += (
        "`switched_load` needs `signal`, the role that switches it: it acts above `threshold` (0.5), with a\n"
        "power that goes with engine speed to the `exponent` (0; 3 for a fan) and is `power_kW` at\n"
        "`reference_rpm` (1500). `retarder_unreported` acts while its `cause` is on (default `pedal_up`).\n"
        "Both know three regimes beside roles: `pedal_up` (`accelerator`), `brake` (`brake_switch`) and\n"
        "`request` (`retarder_request`).\n\n"
    )
    return text + _table(["effect", "parameters", "meaning"], rows)


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page())
