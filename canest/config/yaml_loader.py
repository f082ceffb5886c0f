"""YAML with the numbers of YAML 1.2: 02100 is 2100, 1e3 is a number, and 50:00 is none.

PyYAML keeps to YAML 1.1, where a number with a zero before it counts in eights and one with colons in
sixties. Nobody who writes a torque of 02100 N m means 1088.
"""

from __future__ import annotations

import re
from typing import Any, ClassVar

import yaml

_WHOLE = re.compile(r"[-+]?(?:0x[0-9a-fA-F_]+|0o[0-7_]+|0b[01_]+|[0-9][0-9_]*)$")
_REAL = re.compile(
    r"[-+]?(?:(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?|[0-9][0-9_]*[eE][-+]?[0-9]+"
    r"|\.(?:inf|Inf|INF))$|\.(?:nan|NaN|NAN)$"
)
_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_BEGINS = list("-+.0123456789")

#: libyaml's safe loader where PyYAML was built with it (ten times faster), else the one in Python
_SAFE: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_SAFE):  # type: ignore[misc]
    """The safe loader, but for numbers."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {
        first: [entry for entry in entries if entry[0] not in (_INT, _FLOAT)]
        for first, entries in _SAFE.yaml_implicit_resolvers.items()
    }


def whole_number(text: str) -> int:
    """Return the whole number that a scalar is."""
    plain = text.replace("_", "")
    digits = plain.lstrip("+-")
    base = {"0x": 16, "0o": 8, "0b": 2}.get(digits[:2], 10)
    return int(plain, base)


def _construct_whole(loader: Any, node: yaml.ScalarNode) -> int:
    return whole_number(loader.construct_scalar(node))


_Loader.add_implicit_resolver(_INT, _WHOLE, _BEGINS)
_Loader.add_implicit_resolver(_FLOAT, _REAL, _BEGINS)
_Loader.add_constructor(_INT, _construct_whole)

LOADER: Any = _Loader


def name_of(key: yaml.Node) -> str:
    """Return the name of a key: 08 and 8 are the same one."""
    return str(whole_number(key.value)) if key.tag == _INT else str(key.value)
