"""The JSON Schema of a config, with every key's meaning: what an editor completes and checks."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel

from canest.config.meanings import SOURCE_MEANINGS, meaning
from canest.config.schema import Config
from canest.config.sections import Source
from canest.core.roles import ROLES
from canest.estimators.base import REGISTRY


def json_schema() -> dict[str, Any]:
    """Return the schema (JSON types), as draft 2020-12.

    It knows keys, types, bounds and names; what several keys must agree on only `canest check` knows.
    """
    schema = Config.model_json_schema()
    models = schema["$defs"]
    _describe(schema, Config, "", models)
    for key, about in SOURCE_MEANINGS.items():
        models["Source"]["properties"][key]["description"] = about
    signals = schema["properties"]["signals"]
    entry = {"anyOf": [{"$ref": "#/$defs/Source"}, {"type": "null"}]}  # null takes a role away
    signals["additionalProperties"] = entry  # a role of an effect's own
    signals["properties"] = {r.name: {**entry, "description": _role(r.text, r.unit)} for r in ROLES.values()}
    models["EstimatorSection"]["properties"]["name"]["enum"] = list(REGISTRY)
    _name_bounds(schema)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "canest config",
        "description": "A vehicle, where its signals are, and what the daemon does.",
    }


#: bounds behind a validator of ours keep pydantic's names
_BOUNDS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}


def _name_bounds(schema: Any) -> None:
    """Give bounds their names of JSON Schema, at every level."""
    if isinstance(schema, list):
        for inner in schema:
            _name_bounds(inner)
    if isinstance(schema, dict):
        if "type" in schema:  # and no section that has such a key
            for theirs, name in _BOUNDS.items():
                if theirs in schema:
                    schema[name] = schema.pop(theirs)
        for inner in schema.values():
            _name_bounds(inner)


def _role(text: str, unit: str) -> str:
    return f"{text}, {unit}" if unit else text


def _describe(schema: dict[str, Any], model: type[BaseModel], path: str, models: dict[str, Any]) -> None:
    """Write the meaning of each key into the schema of its section, and of the sections within."""
    schema.pop("description", None)  # the docstring of the class is for who reads the code
    schema.pop("title", None)
    for name, field in model.model_fields.items():
        value = schema["properties"][name]
        value.pop("title", None)
        section = _section(field.annotation)
        if section is None or section is Source:
            value["description"] = meaning(path + name)
        else:
            _describe(models[section.__name__], section, f"{path}{name}.", models)


def _section(annotation: Any) -> type[BaseModel] | None:
    options = (annotation, *get_args(annotation))
    return next((o for o in options if isinstance(o, type) and issubclass(o, BaseModel)), None)
