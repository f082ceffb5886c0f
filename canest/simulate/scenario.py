"""Scenarios: one YAML file each, checked key by key."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, ValidationError, field_validator

from canest.errors import ConfigError
from canest.simulate.drivers import Driver
from canest.simulate.effects import Effect
from canest.simulate.roads import Flat, Road
from canest.simulate.vehicles import Strict, VehicleSpec, vehicle_with

SCENARIOS = Path(__file__).resolve().parent / "scenarios"


class MassChange(Strict):
    """Mass from the first standstill at or after `t_s`."""

    t_s: float = Field(ge=0)
    mass_kg: float = Field(gt=0)


class Bus(Strict):
    """How the bus behaves."""

    start_s: int = 1_700_000_000
    loss: float = Field(0.002, ge=0, lt=1)
    jitter_s: float = Field(0.00045, ge=0)  #: mean delay of a frame
    traffic: bool = True  #: frames that concern nobody
    cab_controller: bool = True  #: random bytes in wanted groups, from source address 0x31
    j1587_gateway: bool = False  #: gear and speed only as J1587 parameters


class Sensors(Strict):
    """What the sensors and controllers add; none of it is declared."""

    torque_delay_s: float = Field(0.06, ge=0)
    accelerometer_bias_mps2: float | None = None  #: None: drawn
    accelerometer_noise_mps2: float = Field(0.06, ge=0)
    shaft_noise_rpm: float = Field(0.4, ge=0)
    wheel_noise_kmh: float = Field(0.02, ge=0)
    altitude_noise_m: float = Field(1.0, ge=0)
    yaw_noise_radps: float = Field(0.001, ge=0)


class Scenario(Strict):
    """A drive to simulate: vehicle, load, road, driver, bus, and what the config will not know."""

    title: str = ""
    seed: int = 0
    duration_s: float = Field(gt=1, le=36_000)
    vehicle: VehicleSpec
    mass_kg: list[MassChange]
    road: Road = Flat(kind="flat")
    driver: Driver
    bus: Bus = Field(default_factory=lambda: Bus.model_validate({}))
    sensors: Sensors = Field(default_factory=lambda: Sensors.model_validate({}))
    undeclared: tuple[Effect, ...] = ()
    small_errors: bool = False

    @field_validator("vehicle", mode="before")
    @classmethod
    def _preset(cls, value: Any) -> Any:
        if isinstance(value, str):
            return vehicle_with(value, {})
        if isinstance(value, dict) and "preset" in value:
            return vehicle_with(value["preset"], {k: v for k, v in value.items() if k != "preset"})
        return value

    @field_validator("mass_kg", mode="before")
    @classmethod
    def _one_mass(cls, value: Any) -> Any:
        return [{"t_s": 0.0, "mass_kg": value}] if isinstance(value, int | float) else value

    @field_validator("mass_kg")
    @classmethod
    def _starts(cls, value: list[MassChange]) -> list[MassChange]:
        if not value or value[0].t_s != 0 or any(b.t_s <= a.t_s for a, b in pairwise(value)):
            raise ValueError("a list of mass changes starts at t_s 0 and goes forward in time")
        return value


def shipped_scenarios() -> list[str]:
    """Return the names of the scenarios that ship."""
    return sorted(path.stem for path in SCENARIOS.glob("*.yaml"))


def load_scenario(source: Scenario | dict[str, Any] | str | Path) -> Scenario:
    """Return the scenario of a file, a shipped name, a mapping, or as given.

    Errors: ConfigError with file, line and key of the first thing wrong.
    """
    if isinstance(source, Scenario):
        return source
    if isinstance(source, dict):
        return _validated(source, "scenario", {})
    path = Path(source)
    if not path.is_file():
        shipped = SCENARIOS / f"{source}.yaml"
        if not shipped.is_file():
            raise ConfigError(
                "no such scenario",
                where=str(source),
                expected=f"a file or one of {', '.join(shipped_scenarios())}",
            )
        path = shipped
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise ConfigError(f"not readable as YAML: {error}", where=str(path)) from None
    if not isinstance(node, yaml.MappingNode):
        raise ConfigError("not a scenario", where=str(path), expected="a mapping of keys")
    lines: dict[tuple[str, ...], int] = {}
    _lines(node, (), lines)
    return _validated(yaml.safe_load(path.read_text(encoding="utf-8")), str(path), lines)


def _lines(node: yaml.Node, at: tuple[str, ...], lines: dict[tuple[str, ...], int]) -> None:
    lines.setdefault(at, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            lines[(*at, str(key.value))] = key.start_mark.line + 1
            _lines(value, (*at, str(key.value)), lines)
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            _lines(value, (*at, str(index)), lines)


def _validated(data: Any, where: str, lines: dict[tuple[str, ...], int]) -> Scenario:
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = tuple(str(part) for part in first["loc"])
        known = key
        # a union's tag stands in pydantic's location but not in the file
        candidates = [key] + [key[:i] + key[i + 1 :] for i in range(len(key))]
        line = next((lines[k] for k in candidates if k in lines), None)
        while line is None and known:
            known = known[:-1]
            line = lines.get(known)
        place = f"{where}:{line}" if line else where
        raise ConfigError(
            f"{'.'.join(key)}: {first['msg']}", where=place, found=_short(first["input"])
        ) from None


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."
