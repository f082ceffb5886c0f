"""Writes docs/config.md from the schema: every key with unit, default and bounds, so it cannot be wrong.

``python tools/config_page.py --write``; a test holds page and schema together.
"""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from config_vehicles import vehicles_text
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from canest.config.meanings import SOURCE_MEANINGS, meaning
from canest.config.schema import Config
from canest.config.sections import Source
from canest.core.roles import ROLES, UNITS
from canest.decode.validity import RULES
from canest.vehicle.effects import EFFECTS
from canest.vehicle.facts import Retarder, Vehicle

PAGE = Path(__file__).resolve().parent.parent / "docs" / "config.md"

HEAD = """# Config

One YAML file describes a vehicle, where its signals are, and what the daemon does. The terms are explained
in the [glossary](glossary.md).

These are refused with file, line and key: unknown keys, numbers out of range, units of another dimension,
and signals that no DBC has. `canest check` reports them without running anything. `--set dotted.key=value`
overrides any key for one call.

Start from a shipped config: `class8`, `class8-j1587`, `kenworth`, `bmw-i3`, `ztbus`, `obd-car`, `testcar`
or `vcan`. Their names work wherever a path does. `canest config show NAME` prints one as a beginning of
your own. This page is made by `python tools/config_page.py --write`.

An editor with yaml-language-server (VS Code with its YAML extension, Neovim, Helix, ...) completes and checks
keys as they are typed. Write the schema beside the config with `canest config schema > canest.schema.json`.
Begin the config with this line:

```yaml
# yaml-language-server: $schema=canest.schema.json
```

What is larger than these limits is refused before anything is built of it:

| file | limits |
|---|---|
| config | 256 kB, 32 levels, 100 aliases, 10,000 keys and values (repetitions by aliases counted each time) |
| database | 16 MB, 4096 bytes in a message, 256 kB in all messages |
"""

ACCURACIES_TEXT = """### Accuracies

Each `..._accuracy_pct` is how well a fact is known: two standard deviations, in percent of the fact.
Nineteen of twenty such vehicles are then within it. `unreported_torque_Nm` is the most that the engine
usually gives and the wheels do not get, though the reported torque contains it. Half of it is taken off the
torque, and as much is the standard deviation. Where the effect `torque_offset` says what is lacking,
nothing more is taken off.

Put there what you know, and leave the default where you know nothing. A torque or wheel radius that is 2 %
off makes the mass 2 % wrong, and no amount of driving shows it. Only a realistic accuracy puts that error
into the standard deviation. A worse accuracy widens it, and `valid` comes later or, beyond
`estimator.valid_std_pct`, never. An accuracy that is too good gives a narrow band around a wrong mass.

The accuracy must hold whenever the vehicle drives: while a filter regenerates, at altitude, with cold oil.
An engine whose report is 8 % too high for ten minutes has no accuracy of 2 %.
The coefficient of the rolling resistance alone is meant for warm tyres: what cold ones cost is added
(a quarter of the coefficient, one standard deviation), and makes the grade less certain, not the mass.

The methods of the papers and version 0.1 of the default estimator do not use these facts.

"""

#: key of `vehicle`, where its default comes from, what makes it better
ACCURACIES = (
    (
        "torque_accuracy_pct",
        "40 CFR 1065.915, table 1, asks of an engine controller's torque 5 % of the maximum or 8 % of the "
        "value; Regulation (EU) 582/2011, annex I, 5.2.5, allows 7 % at type approval",
        "measured on a dynamometer, or by strain gauges at the shafts",
    ),
    (
        "unreported_torque_Nm",
        "chosen: accessories (SAE J1343 names them) of 4 kW are 30 N m at 1,300 rpm, those of a bus or a "
        "large fan 100 and more, and a gearbox takes 10 to 20 without any load. Driving shows about half of "
        "it, and the rest is an error of the grade",
        "measured: twice what is usual",
    ),
    (
        "wheel_radius_accuracy_pct",
        "chosen: 12 mm of tread on a radius of half a metre are 2.4 % from new to worn, and load and "
        "pressure add to it; a larger default is safer and widens every standard deviation",
        "measured over a known distance with these tyres",
    ),
    (
        "rolling_resistance_accuracy_pct",
        "chosen, from three: a label class is about ±9 % wide (Regulation (EC) 1222/2009, C3); 20 K of air "
        "temperature make 12 % (UN Regulation 117, annex 6); Vahidi et al. (2005) call 50 % realistic",
        "fitted to coast-downs of this vehicle with warm tyres",
    ),
    (
        "drag_area_accuracy_pct",
        "chosen, from two: Vahidi et al. (2005) call 25 % feasible; trailer and load space change it from "
        "trip to trip",
        "measured, and always with the same trailer",
    ),
)

SIGNALS_TEXT = """
A role's value is `physical value, converted into the role's unit, * scale + offset`. With `invert`
it is 1 minus that. The physical value is what the DBC makes of the raw number, or the number in the
table's cell. Where neither the DBC nor `unit` has a unit, the number is taken in the role's unit. `check`
and `replay` then name the role, unless the entry has a `scale` (other than -1) or a `map`.

A `map` gives the physical value instead, for example `map: {Gang_1: 1, Gang_2: 2, R: -1, 15: 0}`. The
numbers are the physical values. A key is one of:

- a label of the DBC (`VAL_`),
- the text of a table's cell (`D3`, `N`; letter case does not count),
- a raw number, before the DBC's factor and offset.

What a map does not list has no value. The map alone decides what is valid; with `validity: ascii` its
keys are the characters. `canest check` shows the labels and texts in a log, and proposes a map. For a
gear, 0 is neutral, negative is reverse, 126 is park.

Numbers are those of YAML 1.2: `02100` is 2100, `1e3` is a number, and `50:00` is none.

### Slow signals

Telematics and OBD-II report speed and torque every 0.1 to 2 s. A value that is held until the next report
makes a step there, and a step of the speed looks like a large force. `period_s` states how far reports are
apart:

- Numbers lie on the straight line between two reports.
- A brake, a shift, an open driveline or clutch counts from the report before the first one that has it until
  the one after the last.
- Between two reports in different gears there is none: a shift lies there.
- Other switches keep the report before.

A line needs its second end, so all signals are shown 1.2 periods of the slowest one later, in a replay and
on a bus alike. Gates and mass come that much later. The grade is carried on to now, with a wider standard
deviation. Give all slow signals their period, and those that are fast none. A report that is overdue closes
the gate `stale` until it comes. Without `stale_s`, two reports are joined up to 2.5 periods apart. Signals
that come more seldom than every 2 s are refused. An accelerometer with a period beyond 0.5 s is not used,
since the moments that it shows are no means. `canest check` measures periods and proposes the lines.
"""

ROLES_TEXT = """
## Roles

A role is what the estimator needs to know, under a name that no bus gives it. A config needs:

- one torque,
- one speed,
- where a vehicle has several gears, one way to the ratio: `gear_ratio`, `gear`, or `engine_speed` with
  `output_shaft_speed` or `vehicle_speed`.

The messages EEC1 and CCVS1 alone are enough. With `engine_speed`, `check` and `replay` find wrong gears,
ratios, radii and units; without it nothing shows them. `undriven_speed` (on J1939 the front axle of
EBC2) is worth its line: driven wheels slip, and a driveline winds up. Every other role improves the
estimate or closes a gate, with
these exceptions: `selected_gear`, `input_shaft_speed`, `steering_angle` and `reported_mass` are shown by
`canest check` alone; `pitch`, a slope sensor, is used by `canest diagnose` and the estimator `resistance4`.

"""

EFFECTS_TEXT = """## Effects

An effect is what a vehicle may have beyond the plain model: wind, a torque gain, a dragging brake.
`effects` is a list, for example `effects: [{effect: torque_gain, gain: 0.95}]`, and `canest diagnose`
writes it. At its neutral value an effect changes nothing.

- `driveline_loss` may name one `gear` of `vehicle.gear_ratios`. Without one it acts in all gears.
- `switched_load` needs `signal`, the role that switches it. It acts above `threshold` (0.5). Its power
  follows engine speed to the `exponent` (0; 3 for a fan) and is `power_kW` at `reference_rpm` (1500).
- `retarder_unreported` acts while its `cause` is on (default `pedal_up`).
- Both also accept three regimes in place of a role: `pedal_up` (`accelerator`), `brake` (`brake_switch`)
  and `request` (`retarder_request`).

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
            if section == "vehicle":
                parts.append(_accuracies())
            section, rows = top, []
        if key:
            shown = _default(PydanticUndefined if field.is_required() else default)
            if key.startswith("broadcast.pgn"):
                shown = hex(default).upper().replace("X", "x")
            rows.append([f"`{key}`", shown, _bounds(field), meaning(key)])
    parts.append(_signals())
    parts.append(_effects())
    return "\n".join(parts)


def _accuracies() -> str:
    rows = [
        [f"`{key}`", _default(Vehicle.model_fields[key].default), source, better]
        for key, source, better in ACCURACIES
    ]
    return ACCURACIES_TEXT + _table(["key", "default", "where the default comes from", "better, if"], rows)


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
    text += SIGNALS_TEXT
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
    text += ROLES_TEXT
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
    return vehicles_text() + EFFECTS_TEXT + _table(["effect", "parameters", "meaning"], rows)


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page())
