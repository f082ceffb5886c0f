"""Metadata of an estimator, once, at its class: name, method, source, needs and options."""

from __future__ import annotations

import types
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, Field
from pydantic.config import JsonDict
from pydantic.fields import FieldInfo

from canest.estimators.options import Options

#: what a year stands for where a source is named
PAPERS = {
    "2005": "Vahidi, Stefanopoulou and Peng, Recursive least squares with forgetting for online estimation "
    "of vehicle mass and road grade",
    "2013": "Rhode and Gauterin, Online estimation of vehicle driving resistance parameters with recursive "
    "least squares and recursive total least squares",
    "2014": "Kidambi, Harne, Fujii, Pietron and Wang, Methods in vehicle mass and road grade estimation",
}

_SIGNS = {"gt": "> ", "ge": "≥ ", "lt": "< ", "le": "≤ "}


class Description(NamedTuple):
    """One estimator: what lists, pages and error messages know of it.

    name: as a config writes it. text: the method in one line. source: the paper and its equations.
    needs: the signals without which it gives no number. options: the model of `estimator.options`.
    """

    name: str
    text: str
    source: str
    needs: tuple[str, ...] = ("speed", "torque")
    options: type[Options] = Options

    @property
    def presets(self) -> tuple[str, ...]:
        """Return the names of the shipped tunings."""
        return tuple(self.options.presets)


class OptionRow(NamedTuple):
    """One option for people: dotted name, default (JSON types), unit, allowed values, meaning."""

    name: str
    default: Any
    unit: str
    allowed: str
    text: str


class ConstantRow(NamedTuple):
    """One constant of a method for people: name, symbol, value, unit, and where the value comes from."""

    name: str
    symbol: str
    value: float
    unit: str
    source: str


def option(
    default: Any,
    text: str,
    *,
    unit: str = "",
    allowed: str = "",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """Return a field of an options model, with its meaning and unit.

    allowed: what a validator demands, in words; without it the bounds are named.
    """
    about: JsonDict = {"unit": unit, "allowed": allowed}
    return Field(default, description=text, json_schema_extra=about, gt=gt, ge=ge, lt=lt, le=le)


def option_rows(model: type[BaseModel], prefix: str = "") -> Iterator[OptionRow]:
    """Yield every option of a model but the preset; those of a section within have dotted names."""
    for key, field in model.model_fields.items():
        if key == "preset":
            continue
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        text = field.description or ""
        allowed = str(extra.get("allowed") or _allowed(field))
        yield OptionRow(prefix + key, default, str(extra.get("unit", "")), allowed, text)
        section = _section(field.annotation)
        if section is not None:
            yield from option_rows(section, f"{prefix}{key}.")


def constant_rows(constants: tuple[Any, ...]) -> Iterator[ConstantRow]:
    """Yield every constant. constants: a named tuple of `Annotated[float, symbol, unit, source]`, or ()."""
    hints = get_type_hints(type(constants), include_extras=True)
    for name, value in zip(getattr(constants, "_fields", ()), constants, strict=True):
        symbol, unit, source = hints[name].__metadata__
        yield ConstantRow(name, symbol, value, unit, source)


def _allowed(field: FieldInfo) -> str:
    if get_origin(field.annotation) is Literal:
        return ", ".join(get_args(field.annotation))
    return ", ".join(
        f"{sign}{getattr(bound, name):g}"
        for bound in field.metadata
        for name, sign in _SIGNS.items()
        if getattr(bound, name, None) is not None
    )


def _section(annotation: Any) -> type[BaseModel] | None:
    union = get_origin(annotation) in (Union, types.UnionType)
    choices = get_args(annotation) if union else (annotation,)
    return next((c for c in choices if isinstance(c, type) and issubclass(c, BaseModel)), None)


def shown(value: Any) -> str:
    """Return a default as a config would write it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(shown(item) for item in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
