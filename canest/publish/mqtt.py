"""Publishes estimates to an MQTT broker (extra ``mqtt``). One that is gone or stuck costs messages alone."""

from __future__ import annotations

import asyncio
import json
import threading
import time
import uuid
from collections import Counter
from typing import Any

from canest.core.errors import UsageError
from canest.publish.follower import Follower, LiveEstimate, Pace
from canest.publish.mqtt_settings import Broker
from canest.system.installation import how_to_add
from canest.system.journal import Journal

MOST_WAITING = 20  #: messages that the broker has not confirmed; further ones are dropped
KEEPALIVE_S = 15  #: a broker that answers nothing for twice as long is left
BACKOFF_S = (1, 60)  #: between two attempts to connect: first, and at most
STATUS_S = 10.0
_QOS = 1  #: at least once: what is confirmed has reached the broker, and what is not is counted
_FAREWELL_S = 1.0
#: dropped_offline: no broker was connected. dropped_slow: it had not confirmed enough
COUNTERS = ("published", "confirmed", "connected", "refused", "dropped_offline", "dropped_slow")


class MqttPublisher(Follower):
    """Publishes below a base topic, all of it retained:

    - ``availability``: ``online`` while the source answers, else ``offline``; also the last will.
    - ``estimate``: JSON, at most ``rate_hz`` times a second.
    - ``status``: the snapshot of `canest status --json`, every `STATUS_S`.
    - ``publisher``: JSON with `counters`, every `STATUS_S`.

    paho's own thread talks with the broker, so that nothing here waits for it. more: topics and messages that
    are published whenever the broker is connected. Errors: UsageError without the extra.
    """

    def __init__(
        self,
        source: str,
        broker: Broker,
        base: str,
        rate_hz: float,
        journal: Journal,
        more: list[tuple[str, bytes]] | None = None,
    ) -> None:
        super().__init__(source)
        self.counters: Counter[str] = Counter(dict.fromkeys(COUNTERS, 0))
        self._counting = threading.Lock()  # two threads publish: paho's own when it has connected
        self._broker, self._base, self._journal = broker, base, journal
        self._pace, self._status_due_s = Pace(rate_hz), 0.0
        self._more = more or []
        self._online = False
        self._client = _client(broker, self)
        self._client.will_set(f"{base}/availability", b"offline", qos=_QOS, retain=True)

    def start(self) -> None:
        """Begin to connect; returns at once, and connecting goes on until `stop`."""
        self._client.connect_async(self._broker.address.host, self._broker.address.port, KEEPALIVE_S)
        self._client.loop_start()

    async def stop(self) -> None:
        """Sign off from a broker that is there; takes a second at most."""
        until_s = time.monotonic() + _FAREWELL_S
        if self._online:
            farewell = self._send("availability", b"offline")
            while farewell is not None and not farewell.is_published() and time.monotonic() < until_s:
                await asyncio.sleep(0.02)
        # the thread is not waited for: one that hangs in a connection ends with the process
        self._client.disconnect()
        while self._online and time.monotonic() < until_s:  # or the broker would send the last will too
            await asyncio.sleep(0.02)

    def on_estimate(self, estimate: LiveEstimate) -> None:
        """Publish it, if one is due."""
        if not self._pace.is_due():
            return
        content = {
            "t_s": estimate.t_s,
            **estimate.numbers,
            "status": estimate.status[1],
            "gate": estimate.gate[1],
        }
        self._send("estimate", _json(content))

    def on_status(self, status: dict[str, Any]) -> None:
        """Publish it and the counters, if they are due."""
        if (now_s := time.monotonic()) >= self._status_due_s:
            self._status_due_s = now_s + STATUS_S
            self._send("status", _json(status))
            self._send("publisher", _json(self.counters))

    def on_source(self) -> None:
        """Publish whether the source is there."""
        if self.problem:
            self._journal.warning("source-lost", why=self.problem)
        else:
            self._journal.notice("source-found", source=self.source)
        self._send("availability", self._availability())

    def connected(self, client: Any, _data: object, _flags: object, reason: Any, _properties: object) -> None:
        """Take the broker's answer; called by paho's thread, as the methods below."""
        if reason.is_failure:
            self._count("refused")
            self._journal.warning("broker-refused", broker=self._broker.address.name, why=reason)
            return
        self._count("connected")
        self._journal.notice("broker-connected", broker=self._broker.address.name)
        self._online = True
        for topic, message in self._more:
            self._publish(client, topic, message)
        self._send("availability", self._availability())

    def disconnected(
        self, _client: Any, _data: object, _flags: object, reason: Any, _properties: object
    ) -> None:
        """Note that the connection is gone."""
        if self._online:
            self._journal.warning("broker-lost", broker=self._broker.address.name, why=reason)
        self._online = False

    def unreachable(self, client: Any, _data: object) -> None:
        """Note that no connection could be made."""
        self._count("refused")
        self._journal.warning("broker-unreachable", broker=self._broker.address.name, why=client.failure)

    def confirmed(self, *_: object) -> None:
        """Count what has reached the broker."""
        self._count("confirmed")

    def _send(self, topic: str, message: bytes) -> Any:
        """Hand a message over; returns at once, None where it is dropped."""
        if not self._online:
            self._count("dropped_offline")
        elif self.counters["published"] - self.counters["confirmed"] >= MOST_WAITING:
            self._count("dropped_slow")
        else:
            return self._publish(self._client, f"{self._base}/{topic}", message)
        return None

    def _publish(self, client: Any, topic: str, message: bytes) -> Any:
        """Hand a message to paho, which refuses one where too many wait; None where it does."""
        from paho.mqtt.enums import MQTTErrorCode  # with the client, by now

        self._count("published")
        handed_over = client.publish(topic, message, qos=_QOS, retain=True)
        if handed_over.rc != MQTTErrorCode.MQTT_ERR_QUEUE_SIZE:
            return handed_over
        self._count("published", -1)
        self._count("dropped_slow")
        return None

    def _count(self, name: str, by: int = 1) -> None:
        with self._counting:
            self.counters[name] += by

    def _availability(self) -> bytes:
        return b"offline" if self.problem else b"online"


def _client(broker: Broker, publisher: MqttPublisher) -> Any:
    try:
        from paho.mqtt import client as paho
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        raise UsageError(
            "cannot speak MQTT", expected=f"the paho-mqtt package: {how_to_add('mqtt')}"
        ) from None

    class _Client(paho.Client):
        failure = ""

        def reconnect(self) -> Any:
            """Connect; paho itself forgets why it could not."""
            try:
                return super().reconnect()
            except OSError as error:
                self.failure = error.strerror or str(error)
                raise

    client = _Client(CallbackAPIVersion.VERSION2, client_id=f"canest-{uuid.uuid4().hex[:12]}")
    client.on_connect, client.on_disconnect = publisher.connected, publisher.disconnected
    client.on_connect_fail, client.on_publish = publisher.unreachable, publisher.confirmed
    client.reconnect_delay_set(*BACKOFF_S)
    client.max_queued_messages_set(2 * MOST_WAITING)
    if broker.user is not None:
        client.username_pw_set(broker.user, broker.password)
    if broker.tls is not None:
        client.tls_set_context(broker.tls)
    return client


def _json(content: Any) -> bytes:
    return json.dumps(content, separators=(",", ":")).encode()
