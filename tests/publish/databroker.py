"""A gRPC server of the published service ``kuksa.val.v2.VAL``, with a databroker's rules for values.

No databroker is packaged where these tests run. The messages and stubs are those of the package kuksa-client;
the rules are those that val.proto states: types, ranges, allowed values, tokens.
"""

from __future__ import annotations

import json
import queue
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grpc
from kuksa.val.v2 import types_pb2 as types
from kuksa.val.v2 import val_pb2 as val
from kuksa.val.v2 import val_pb2_grpc

from canest.publish.kuksa_signal import BrokerSignal
from tests.serve.rig import free_port

OVERLAY = Path(__file__).resolve().parents[2] / "vss" / "canest.json"
#: as VSS 4 has it
WEIGHT = {
    "CurrentOverallWeight": {"datatype": "uint16", "type": "sensor", "unit": "kg", "description": "Weight."}
}
SPEED = {"Speed": {"datatype": "float", "type": "sensor", "unit": "km/h", "description": "Vehicle speed."}}


def tree(**children):
    return {"Vehicle": {"type": "branch", "description": "", "children": children}}


def signals(node, path=""):
    """Return the signals of a tree of vss-tools as Metadata messages."""
    found = []
    for name, entry in node.items():
        here = f"{path}.{name}" if path else name
        if entry["type"] == "branch":
            found += signals(entry["children"], here)
            continue
        one = types.Metadata(
            path=here, description=entry["description"], unit=entry.get("unit", ""),
            data_type=types.DataType.Value(f"DATA_TYPE_{entry['datatype'].upper()}"),
        )  # fmt: skip
        for limit in {"min", "max"} & entry.keys():
            setattr(getattr(one, limit), BrokerSignal.of(one).kind, entry[limit])
        one.allowed_values.string_array.values.extend(entry.get("allowed", ()))
        found.append(one)
    return found


class Databroker(val_pb2_grpc.VALServicer):
    """A server on a free port. token: what a client must send. hang: makes every publication wait.

    values: path -> the Datapoint messages that it took.
    """

    def __init__(self, *trees, token=None, credentials=None, port=None, overlay=True):
        trees = [*trees, *([json.loads(OVERLAY.read_text())] if overlay else [])]
        self.metadata = {one.path: one for part in trees for one in signals(part)}
        self.values = {path: [] for path in self.metadata}
        self.token, self.port = token, port or free_port()
        self.hang = threading.Event()
        self._subscribers, self._lock = [], threading.Lock()
        self._server = grpc.server(ThreadPoolExecutor(16))
        val_pb2_grpc.add_VALServicer_to_server(self, self._server)
        place = f"localhost:{self.port}"
        if credentials is None:
            assert self._server.add_insecure_port(place)
        else:
            assert self._server.add_secure_port(place, credentials)

    @property
    def url(self):
        return f"grpc://localhost:{self.port}"

    def newest(self, path):
        """Return the newest value of a signal, None where it has none."""
        with self._lock:
            points = self.values[path]
            kind = points[-1].value.WhichOneof("typed_value") if points else None
            return None if kind is None else getattr(points[-1].value, kind)

    def __enter__(self):
        self._server.start()
        return self

    def __exit__(self, *_):
        self.hang.clear()
        self._server.stop(0).wait(5)

    def _authorise(self, context):
        given = dict(context.invocation_metadata()).get("authorization")
        if self.token is not None and given != f"Bearer {self.token}":
            context.abort(grpc.StatusCode.UNAUTHENTICATED, "Invalid auth token")

    def ListMetadata(self, request, context):
        self._authorise(context)
        assert request.root == "Vehicle"
        return val.ListMetadataResponse(metadata=self.metadata.values())

    def GetServerInfo(self, request, context):
        return val.GetServerInfoResponse(name="test", version="0")

    def PublishValue(self, request, context):
        self._authorise(context)
        while self.hang.is_set() and context.is_active():
            threading.Event().wait(0.02)
        path, point = request.signal_id.path, request.data_point
        if path not in self.metadata:
            context.abort(grpc.StatusCode.NOT_FOUND, "Path not found")
        if problem := refusal(self.metadata[path], point.value):
            context.abort(*problem)
        with self._lock:
            self.values[path].append(point)
            for paths, events in self._subscribers:
                if path in paths:
                    events.put({path: point})
        return val.PublishValueResponse()

    def Subscribe(self, request, context):
        self._authorise(context)
        events = queue.Queue()
        with self._lock:
            self._subscribers.append((set(request.signal_paths), events))
            yield val.SubscribeResponse(
                entries={path: self.values[path][-1] for path in request.signal_paths if self.values[path]}
            )
        while context.is_active():
            try:
                yield val.SubscribeResponse(entries=events.get(timeout=0.1))
            except queue.Empty:
                continue


def refusal(metadata, value):
    """Return (status, message) of a value that the signal cannot take, None for one that it can."""
    kind, signal = value.WhichOneof("typed_value"), BrokerSignal.of(metadata)
    if kind is None:
        return None  # "not available" is always valid
    if kind != signal.kind:
        return grpc.StatusCode.INVALID_ARGUMENT, "Wrong type provided"
    if kind == "string":
        allowed = metadata.allowed_values.string_array.values
        if allowed and value.string not in allowed:
            return grpc.StatusCode.INVALID_ARGUMENT, "Value not allowed"
        return None
    if not signal.least <= getattr(value, kind) <= signal.most:
        return grpc.StatusCode.INVALID_ARGUMENT, "Value out of bounds"
    return None
