"""A signal as a KUKSA databroker has it: its data type and limits decide what can be sent."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from canest.publish.vss import Value

_INTEGERS = {
    "UINT8": ("uint32", 0, (1 << 8) - 1), "UINT16": ("uint32", 0, (1 << 16) - 1),
    "UINT32": ("uint32", 0, (1 << 32) - 1), "UINT64": ("uint64", 0, (1 << 64) - 1),
    "INT8": ("int32", -(1 << 7), (1 << 7) - 1), "INT16": ("int32", -(1 << 15), (1 << 15) - 1),
    "INT32": ("int32", -(1 << 31), (1 << 31) - 1), "INT64": ("int64", -(1 << 63), (1 << 63) - 1),
}  # fmt: skip
_REALS = {"FLOAT": "float", "DOUBLE": "double"}


class BrokerSignal(NamedTuple):
    """A signal of a databroker.

    kind: field of its Value message. least, most: that it takes. whole: whether it takes integers alone.
    """

    path: str
    kind: str
    least: float = -math.inf
    most: float = math.inf
    whole: bool = False

    @classmethod
    def of(cls, metadata: Any) -> BrokerSignal | None:
        """Return the signal of a Metadata message, None where no value of ours fits its type."""
        from kuksa.val.v2 import types_pb2 as types

        name = types.DataType.Name(metadata.data_type).removeprefix("DATA_TYPE_")
        if name == "STRING":
            return cls(metadata.path, "string")
        if name in _REALS:
            found = cls(metadata.path, _REALS[name])
        elif name in _INTEGERS:
            found = cls(metadata.path, *_INTEGERS[name], whole=True)
        else:
            return None
        least, most = _number(metadata, "min"), _number(metadata, "max")
        return found._replace(
            least=found.least if least is None else max(found.least, least),
            most=found.most if most is None else min(found.most, most),
        )

    def takes(self, value: Value) -> bool:
        """Return whether a value fits the signal; no value always does."""
        if value is None:
            return True
        if isinstance(value, str):
            return self.kind == "string"
        return self.kind != "string" and self.least <= self._rounded(value) <= self.most

    def datapoint(self, value: Value, t_s: float) -> Any:
        """Return the Datapoint message of a value that fits. t_s: UTC."""
        from kuksa.val.v2 import types_pb2 as types

        point = types.Datapoint()
        point.timestamp.FromMicroseconds(round(t_s * 1e6))
        if value is not None:
            setattr(point.value, self.kind, value if isinstance(value, str) else self._rounded(value))
        return point

    def _rounded(self, value: float) -> float:
        return round(value) if self.whole else value


def _number(metadata: Any, name: str) -> float | None:
    """Return a limit of the metadata, None where it has none."""
    limit = getattr(metadata, name)
    kind = limit.WhichOneof("typed_value")
    return None if kind is None else float(getattr(limit, kind))
