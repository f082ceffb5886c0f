"""Publishes estimates to an Eclipse KUKSA databroker (extra ``kuksa``): API ``kuksa.val.v2`` over gRPC.

A databroker that is gone, stuck or full costs values alone: the newest estimate waits, all older ones go.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import Counter
from typing import Any

from canest.core.errors import UsageError
from canest.publish.follower import Follower, LiveEstimate, Pace, nothing
from canest.publish.kuksa_settings import Databroker
from canest.publish.kuksa_signal import BrokerSignal
from canest.publish.vss import BRANCH, WEIGHT, Value, values
from canest.system.installation import how_to_add
from canest.system.journal import Journal

DEADLINE_S = 2.0  #: for every answer
BACKOFF_S = (1.0, 60.0)  #: between two attempts: first, and at most
LOOK_AGAIN_S = 60.0  #: for signals that the databroker does not know yet
_FAREWELL_S = 1.0
#: answers that concern one signal, and not the connection
_OF_THE_VALUE = frozenset({"NOT_FOUND", "INVALID_ARGUMENT", "OUT_OF_RANGE", "PERMISSION_DENIED"})
#: values but for the first two. dropped_offline: no databroker was there. dropped_slow: a newer estimate came
#: before the answer. out_of_range: beyond the signal's type. rejected: by the databroker
COUNTERS = (
    "connected", "refused", "published", "confirmed", "dropped_offline", "dropped_slow", "out_of_range",
    "rejected",
)  # fmt: skip


class KuksaPublisher(Follower):
    """Publishes the signals of `canest.publish.vss`, as far as the databroker knows them.

    Every value has the estimate's time. Where there is no number (no daemon, a quiet bus, a mass beyond the
    signal's type) the signal has no value. Errors: UsageError without the extra.
    """

    def __init__(self, source: str, broker: Databroker, rate_hz: float, journal: Journal) -> None:
        super().__init__(source)
        require_kuksa()
        self.counters: Counter[str] = Counter(dict.fromkeys(COUNTERS, 0))
        self._broker, self._journal, self._pace = broker, journal, Pace(rate_hz)
        self._call: dict[str, Any] = {"timeout": DEADLINE_S}
        if broker.token is not None:
            self._call["metadata"] = (("authorization", f"Bearer {broker.token}"),)
        self._online = False
        self._waiting: LiveEstimate | None = None
        self._wake = asyncio.Event()
        self._signals: dict[str, BrokerSignal] = {}
        self._look_s = 0.0

    def on_estimate(self, estimate: LiveEstimate) -> None:
        """Publish it, if one is due."""
        if self._pace.is_due():
            self._offer(estimate)

    def on_source(self) -> None:
        """Publish that there is no estimate while the source is gone."""
        if self.problem:
            self._journal.warning("source-lost", why=self.problem)
            self._offer(nothing())
        else:
            self._journal.notice("source-found", source=self.source)

    async def serve(self, stop: asyncio.Event) -> None:
        """Keep connected until ``stop``; then leave no value behind, which takes a second at most."""
        work, waiting = asyncio.ensure_future(self._work()), asyncio.ensure_future(stop.wait())
        await asyncio.wait([work, waiting], return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if not work.done():
            await self._say_goodbye()
            work.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await work

    async def _say_goodbye(self) -> None:
        until_s = time.monotonic() + _FAREWELL_S
        if self._online:
            self._offer(nothing())
            while self._online and time.monotonic() < until_s and not self._all_answered():
                await asyncio.sleep(0.02)

    def _all_answered(self) -> bool:
        answers = self.counters["confirmed"] + self.counters["rejected"]
        return self._waiting is None and self.counters["published"] == answers

    def _offer(self, estimate: LiveEstimate) -> None:
        if not self._online:
            self.counters["dropped_offline"] += 1
            return
        if self._waiting is not None:
            self.counters["dropped_slow"] += 1
        self._waiting = estimate
        self._wake.set()

    async def _work(self) -> None:
        """Connect, publish, and connect again, for ever."""
        from grpc.aio import AioRpcError
        from kuksa.val.v2.val_pb2_grpc import VALStub

        pause_s = BACKOFF_S[0]
        while True:
            try:
                async with self._channel() as channel:
                    await self._connected(VALStub(channel))
                    pause_s = BACKOFF_S[0]
                    await self._publish_for_ever(VALStub(channel))
            except AioRpcError as error:
                self._lost(f"{error.code().name.lower()}: {error.details()}")
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, BACKOFF_S[1])

    def _channel(self) -> Any:
        import grpc

        address, options = self._broker.address, [("grpc.enable_http_proxy", 0)]
        target = address.name.partition("://")[2]
        if not self._broker.is_encrypted:
            return grpc.aio.insecure_channel(target, options)
        return grpc.aio.secure_channel(target, grpc.ssl_channel_credentials(self._broker.authority), options)

    async def _connected(self, stub: Any) -> None:
        await self._look_at_signals(stub)
        self._online, self._waiting = True, None
        self.counters["connected"] += 1
        self._journal.notice(
            "broker-connected", broker=self._broker.address.name, signals=", ".join(self._signals) or "none"
        )

    def _lost(self, why: str) -> None:
        name = self._broker.address.name
        if self._online:
            self._journal.warning("broker-lost", broker=name, why=why)
        else:
            self.counters["refused"] += 1
            self._journal.warning("broker-refused", broker=name, why=why)
        self._online = False

    async def _look_at_signals(self, stub: Any) -> None:
        """Find which of our signals the databroker knows, and of which type."""
        from kuksa.val.v2.val_pb2 import ListMetadataRequest

        answer = await stub.ListMetadata(ListMetadataRequest(root="Vehicle"), **self._call)
        ours, wanted = {m.path: m for m in answer.metadata}, list(values(nothing()))
        found = {path: BrokerSignal.of(ours[path]) for path in wanted if path in ours}
        self._signals = {path: signal for path, signal in found.items() if signal is not None}
        if unknown := [path for path in wanted if path not in self._signals]:
            self._journal.warning(
                "signals-unknown", broker=self._broker.address.name, signals=", ".join(unknown),
                expected=f"the overlay canest.json for {BRANCH}, and VSS for {WEIGHT}",
            )  # fmt: skip
        self._look_s = time.monotonic() + (LOOK_AGAIN_S if unknown else float("inf"))

    async def _publish_for_ever(self, stub: Any) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            if time.monotonic() > self._look_s:
                await self._look_at_signals(stub)
            estimate, self._waiting = self._waiting, None
            if estimate is not None:
                await self._publish(stub, estimate)

    async def _publish(self, stub: Any, estimate: LiveEstimate) -> None:
        """Publish the signals of one estimate at once. Errors: AioRpcError where the databroker is lost."""
        mine = values(estimate)
        calls = [
            self._publish_value(stub, signal, self._fitting(signal, mine[path]), estimate.t_s)
            for path, signal in self._signals.items()
        ]
        for error in await asyncio.gather(*calls, return_exceptions=True):
            if error is not None:
                raise error

    def _fitting(self, signal: BrokerSignal, value: Value) -> Value:
        """Return the value, None where the signal's type cannot hold it: a clipped number would be wrong."""
        if signal.takes(value):
            return value
        self.counters["out_of_range"] += 1
        self._journal.warning("value-out-of-range", signal=signal.path, value=value, most=signal.most)
        return None

    async def _publish_value(self, stub: Any, signal: BrokerSignal, value: Value, t_s: float) -> None:
        import grpc
        from kuksa.val.v2.val_pb2 import PublishValueRequest

        request = PublishValueRequest(data_point=signal.datapoint(value, t_s))
        request.signal_id.path = signal.path
        self.counters["published"] += 1
        try:
            await stub.PublishValue(request, **self._call)
        except grpc.aio.AioRpcError as error:
            if error.code().name not in _OF_THE_VALUE:
                raise
            self.counters["rejected"] += 1
            if error.code() is grpc.StatusCode.NOT_FOUND:
                self._look_s = 0.0
            self._journal.warning("value-rejected", signal=signal.path, value=value, why=error.details())
        else:
            self.counters["confirmed"] += 1


def require_kuksa() -> None:
    """Errors: UsageError without the extra."""
    try:
        import grpc  # noqa: F401 - whether they are there
        from kuksa.val.v2 import val_pb2  # noqa: F401
    except ImportError:
        raise UsageError(
            "cannot speak to a databroker", expected=f"the kuksa-client package: {how_to_add('kuksa')}"
        ) from None
