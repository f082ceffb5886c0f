"""Roads: grade and curvature by distance, with the elevation that follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from canest.core.frames import FloatColumn
from canest.simulation.vehicles import Increasing, Range, Stretch, Strict, same_length

START_ELEVATION_M = 100.0
SPACING_M = 1.0
# All chosen.
MEAN_HEIGHT_M = 60.0  #: a road this far above its mean height ...
RETURN = 0.5  #: ... falls again with this share of its steepest grade
SPIRAL_M = 40.0  #: transition curve into and out of a bend
BEND_SHARE = 0.6  #: of a stretch of constant grade, at most
BEND_RAD = (0.5, 1.5)  #: change of heading in a bend, between the two


class Flat(Strict):
    """One grade (0 by default) all along."""

    kind: Literal["flat"]
    grade: float = 0.0


class Highway(Strict):
    """Stretches of constant grade joined by linear transitions, as highways are built; optional bends."""

    kind: Literal["highway"]
    grade_max: float = Field(0.045, ge=0, le=0.3)
    stretch_m: Stretch = (200.0, 900.0)
    transition_m: Range = (80.0, 300.0)
    level_start_m: float = 100.0
    bends: bool = False
    bend_radius_m: Stretch = (150.0, 900.0)


class Points(Strict):
    """Given points, linear between them: distance in m, grade, curvature in 1/m (left positive)."""

    kind: Literal["points"]
    at_m: Increasing
    grade: list[float]
    curvature_1pm: list[float] | None = None

    @model_validator(mode="after")
    def _one_each(self) -> Points:
        same_length(self.at_m, grade=self.grade, curvature_1pm=self.curvature_1pm)
        return self


class Sine(Strict):
    """Sinusoidal grade after a level start (2005 paper, Figures 4 and 6)."""

    kind: Literal["sine"]
    amplitude: float = 0.03
    wavelength_m: float = Field(800.0, gt=0)
    level_start_m: float = 300.0


class Steps(Strict):
    """Grades one after the other, with short transitions (2005 paper, Figures 3 and 5)."""

    kind: Literal["steps"]
    grades: list[float] = Field(min_length=1)
    length_m: float = Field(600.0, gt=0)
    transition_m: float = Field(2.0, gt=0)

    @model_validator(mode="after")
    def _each_is_reached(self) -> Steps:
        if self.transition_m >= self.length_m:
            raise ValueError(
                f"transition_m {self.transition_m:g} is no part of a step, expected less than length_m "
                f"{self.length_m:g}"
            )
        return self


Road = Annotated[Flat | Highway | Points | Sine | Steps, Field(discriminator="kind")]


@dataclass(frozen=True, slots=True)
class RoadTable:
    """A road on a grid of `SPACING_M`: tan(beta), 1/m and m, all (n,); the last value goes on for ever."""

    grade: FloatColumn
    curvature_1pm: FloatColumn
    elevation_m: FloatColumn


def lay(road: Road, length_m: float, rng: np.random.Generator) -> RoadTable:
    """Lay out `length_m` of a road."""
    s = np.arange(0.0, length_m + SPACING_M, SPACING_M)
    curvature = np.zeros_like(s)
    match road:
        case Flat():
            grade = np.full_like(s, road.grade)
        case Sine():
            phase = 2 * np.pi * np.maximum(0.0, s - road.level_start_m) / road.wavelength_m
            grade = road.amplitude * np.sin(phase)
        case Steps():
            at, values = [0.0], [road.grades[0]]
            for index, value in enumerate(road.grades[1:], 1):
                at += [index * road.length_m, index * road.length_m + road.transition_m]
                values += [values[-1], value]
            grade = np.interp(s, at, values)
        case Points():
            grade = np.interp(s, road.at_m, road.grade)
            if road.curvature_1pm is not None:
                curvature = np.interp(s, road.at_m, road.curvature_1pm)
        case Highway():
            grade, curvature = _highway(road, s, length_m, rng)
    slope = grade / np.sqrt(1 + grade * grade)  # sin(atan(grade)): distance is along the road
    rise = np.concatenate([[0.0], np.cumsum((slope[1:] + slope[:-1]) / 2) * SPACING_M])
    return RoadTable(grade, curvature, START_ELEVATION_M + rise)


def _highway(
    road: Highway, s: FloatColumn, length_m: float, rng: np.random.Generator
) -> tuple[FloatColumn, FloatColumn]:
    at, values = [0.0, road.level_start_m], [0.0, 0.0]
    bend_at, bends = [0.0], [0.0]
    climb = 0.0
    while at[-1] < length_m:
        # a road stays near its mean height: what climbed tends to fall again
        wanted = rng.uniform(-1, 1) - np.tanh(climb / MEAN_HEIGHT_M) * RETURN
        value = float(np.clip(wanted, -1, 1)) * road.grade_max
        start, transition, stretch = at[-1], rng.uniform(*road.transition_m), rng.uniform(*road.stretch_m)
        at += [start + transition, start + transition + stretch]
        values += [value, value]
        climb += value * stretch
        radius = rng.uniform(*road.bend_radius_m) * rng.choice([-1.0, 1.0])
        length = min(BEND_SHARE * stretch, abs(radius) * rng.uniform(*BEND_RAD))
        bend_at += [start + transition, start + transition + SPIRAL_M,
                    start + transition + SPIRAL_M + length,
                    start + transition + 2 * SPIRAL_M + length]  # fmt: skip
        bends += [0.0, 1 / radius, 1 / radius, 0.0]
    grade = np.interp(s, at, values)
    curvature = np.interp(s, np.maximum.accumulate(bend_at), bends) if road.bends else np.zeros_like(s)
    return grade, curvature
