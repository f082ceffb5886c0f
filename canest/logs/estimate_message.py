"""One row of estimates as a JSON message with its topic and JSON Schema, in a file and on a socket."""

from __future__ import annotations

import json
from collections.abc import Iterable
from math import isfinite
from typing import Any

TOPIC = "/canest/estimate"
SCHEMA_NAME = "canest.Estimate"

#: last part of a column's name -> its unit
_UNITS = {"kg": "kg", "m": "m", "N": "N", "Nm": "Nm", "mps": "m/s", "mps2": "m/s\u00b2", "radps": "rad/s"}
_MEANINGS = {
    "mass_kg": "estimated gross mass",
    "mass_std_kg": "standard deviation of the mass",
    "grade": "road grade, rise over run",
    "grade_std": "standard deviation of the grade",
    "speed_mps": "speed over ground",
    "residual_N": "what the model with this estimate leaves unexplained",
}
#: how a message names status and gate: (type, meaning)
NAMES = {
    "status": ("string", "unestimated, converging or valid"),
    "gate": ("string", "why the estimator does not learn from this sample; empty while it learns"),
    "status_code": ("integer", "status as a number, for plots: 0, 1, 2"),
    "gate_code": ("integer", "gate as a number, for plots: 0 while open"),
}


def unit(column: str) -> str:
    """Return the unit that a column's name carries, '' for a number without one."""
    return _UNITS.get(column.rpartition("_")[2], "")


def schema(numbers: Iterable[str]) -> str:
    """Return the JSON Schema (draft 7) of a message with these columns of numbers, status and gate.

    A number that is not there is left out of a message: readers of such schemas know no null.
    """
    properties: dict[str, Any] = {}
    for name in numbers:
        text = ", ".join(filter(None, (_MEANINGS.get(name, ""), unit(name))))
        properties[name] = {"type": "number", **({"description": text} if text else {})}
    for name, (kind, meaning) in NAMES.items():
        properties[name] = {"type": kind, "description": meaning}
    content = {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": SCHEMA_NAME,
        "type": "object",
        "properties": properties,
        "required": list(NAMES),
    }
    return json.dumps(content, separators=(",", ":"))


def message(numbers: dict[str, float | None], status: tuple[int, str], gate: tuple[int, str]) -> bytes:
    """Return a message. numbers: rounded already; None and what is not finite are left out.

    status, gate: code and name.
    """
    content: dict[str, Any] = {
        name: value + 0  # -0.0 is a zero, as in est.csv
        for name, value in numbers.items()
        if value is not None and isfinite(value)
    }
    content["status"], content["gate"] = status[1], gate[1]
    content["status_code"], content["gate_code"] = status[0], gate[0]
    return json.dumps(content, separators=(",", ":")).encode()
