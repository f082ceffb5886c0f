"""Discovery messages of Home Assistant: what it has to know to show an estimate as sensors of one device."""

from __future__ import annotations

import json
import re
from typing import NamedTuple

from canest import __version__

PREFIX = "homeassistant"
_EXPIRE_S = 30  #: Home Assistant shows a sensor without a message for so long as unavailable


class _Sensor(NamedTuple):
    """A sensor. template: from the JSON of an estimate to its value."""

    name: str
    template: str
    unit: str | None = None
    device_class: str | None = None
    digits: int | None = None


def _number(column: str, factor: str = "") -> str:
    value = f"value_json.{column}"
    return f"{{{{ {value}{factor} if {value} is not none else none }}}}"


#: key of the sensor -> what it is
SENSORS = {
    "mass": _Sensor("Mass", _number("mass_kg"), "kg", "weight", 0),
    "mass_std": _Sensor("Mass standard deviation", _number("mass_std_kg"), "kg", "weight", 0),
    "grade": _Sensor("Road grade", _number("grade", " * 100"), "%", None, 2),
    "speed": _Sensor("Speed", _number("speed_mps"), "m/s", "speed", 1),
    "status": _Sensor("Status of the estimate", "{{ value_json.status }}"),
    "gate": _Sensor("Closed gate", "{{ value_json.gate or 'open' }}"),
}


def discovery(base: str, vehicle: str) -> list[tuple[str, bytes]]:
    """Return (topic, message) of every sensor. base: the publisher's topic."""
    device = re.sub(r"[^a-zA-Z0-9_-]+", "_", base)
    found = []
    for key, sensor in SENSORS.items():
        content: dict[str, object] = {
            "name": sensor.name,
            "unique_id": f"{device}_{key}",
            "state_topic": f"{base}/estimate",
            "value_template": sensor.template,
            "availability_topic": f"{base}/availability",
            "expire_after": _EXPIRE_S,
            "device": {
                "identifiers": [device], "name": vehicle, "manufacturer": "canest", "sw_version": __version__,
            },
        }  # fmt: skip
        if sensor.unit is not None:
            content |= {"unit_of_measurement": sensor.unit, "state_class": "measurement"}
            content["suggested_display_precision"] = sensor.digits
        if sensor.device_class is not None:
            content["device_class"] = sensor.device_class
        topic = f"{PREFIX}/sensor/{device}/{key}/config"
        found.append((topic, json.dumps(content, separators=(",", ":")).encode()))
    return found
