"""`canest publish mqtt` against a real broker, as processes; what a bad broker costs."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import time

import pytest

from canest.telemetry.live_protocol import COLUMNS
from tests.publish.rig import MOSQUITTO, Broker, Listener, SilentServer
from tests.serve.rig import Command, Stream, wait_for

pytest.importorskip("paho.mqtt", reason="paho-mqtt (extra: mqtt)")
pytestmark = pytest.mark.skipif(
    MOSQUITTO is None and "CI" not in os.environ, reason="mosquitto (a package of the system)"
)


@contextlib.contextmanager
def publisher(folder, stream, url, *more, **environment):
    arguments = ["--socket", stream.status_socket, "--broker", url, "--topic", "test/truck", "--rate", 10]
    before = dict(os.environ)
    os.environ.update(environment)
    try:
        process = Command(folder, "publish", "mqtt", *arguments, *more)
    finally:
        os.environ.clear()
        os.environ.update(before)
    with process:
        yield process


def counters(process):
    """Return the counters that it prints at its end."""
    process.end(signal.SIGTERM)
    return {k: int(n) for k, n in (part.split() for part in process.output.splitlines()[-1].split(", "))}


def test_what_a_subscriber_gets_is_what_the_daemon_has_sent(tmp_path, stream):
    with Broker(tmp_path) as broker, Listener(broker.port) as listener:
        with publisher(tmp_path, stream, broker.url) as process:
            assert wait_for(lambda: len(listener.of("test/truck/estimate")) >= 5, 15), process.output
            assert wait_for(lambda: listener.of("test/truck/status"), 15)
            status = listener.json("test/truck/status")[0]
            assert (status["vehicle"], status["bus"]) == ("truck", {"state": "up"})
            done = counters(process)
        for estimate in listener.json("test/truck/estimate"):
            assert 20_000 <= estimate["mass_kg"] <= 20_006 and abs(estimate["t_s"] - time.time()) < 60
            known = {"grade": 0.01, "grade_std": 0.001, "mass_std_kg": 200.0, "speed_mps": 20.0, "gear": 9}
            assert known.items() <= estimate.items()
            assert (estimate["status"], estimate["gate"]) == ("valid", "")
            assert set(estimate) == set(COLUMNS)
        # the last one is its farewell, not its last will: it says goodbye before it goes
        # (it may say so twice, once of its source and once of itself)
        states = [word for word, _ in itertools.groupby(listener.of("test/truck/availability"))]
        assert states[-2:] == ["online", "offline"]
        assert done["dropped_offline"] <= 3 and done["dropped_slow"] == 0
        assert done["confirmed"] == done["published"] == len(listener.messages)


@pytest.mark.slow
def test_who_subscribes_later_gets_the_newest_at_once(tmp_path, stream):
    with Broker(tmp_path) as broker, publisher(tmp_path, stream, broker.url) as process:
        with Listener(broker.port) as first:
            assert wait_for(lambda: first.of("test/truck/estimate"), 15), process.output
        with Listener(broker.port) as late:
            assert wait_for(lambda: late.of("test/truck/estimate"), 5)
            assert all(kept for _, _, kept in late.messages[:2])
            assert "online" in late.of("test/truck/availability")


def test_a_publisher_that_is_killed_is_shown_as_offline(tmp_path, stream):
    with (
        Broker(tmp_path) as broker,
        Listener(broker.port) as listener,
        publisher(tmp_path, stream, broker.url) as process,
    ):
        assert wait_for(lambda: listener.of("test/truck/availability")[-1:] == ["online"], 15), process.output
        process.send(signal.SIGKILL)
        assert wait_for(lambda: listener.of("test/truck/availability")[-2:] == ["online", "offline"], 5)


def test_a_daemon_that_goes_and_comes_back_is_shown(tmp_path):
    first = Stream(tmp_path)
    with (
        Broker(tmp_path) as broker,
        Listener(broker.port) as listener,
        publisher(tmp_path, first, broker.url) as process,
    ):
        assert wait_for(lambda: listener.of("test/truck/availability")[-1:] == ["online"], 15), process.output
        first.close()
        assert wait_for(lambda: listener.of("test/truck/availability")[-1:] == ["offline"], 5)
        second = Stream(tmp_path)
        try:
            assert wait_for(lambda: listener.of("test/truck/availability")[-1:] == ["online"], 5)
        finally:
            second.close()
        assert "source-lost" in process.output and "source-found" in process.output


@pytest.mark.slow
def test_a_broker_that_dies_costs_counted_messages_and_is_found_again(tmp_path, stream):
    broker = Broker(tmp_path)
    broker.start()
    with publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: "broker-connected" in process.output, 15), process.output
        broker.end()
        sent = stream.sent
        assert wait_for(
            lambda: "broker-lost" in process.output and "broker-unreachable" in process.output, 10
        )
        assert wait_for(lambda: stream.sent > sent + 20, 10)  # the daemon's side goes on, and has its watcher
        with Broker(tmp_path, port=broker.port) as again, Listener(again.port) as listener:
            assert wait_for(lambda: listener.of("test/truck/estimate"), 10), process.output
            done = counters(process)
    assert done["connected"] == 2 and done["dropped_offline"] > 5 and done["refused"] >= 1


@pytest.mark.slow
def test_a_broker_that_hangs_costs_counted_messages_and_no_more(tmp_path, stream):
    with Broker(tmp_path) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: "broker-connected" in process.output, 15), process.output
        broker.send(signal.SIGSTOP)
        sent = stream.sent
        assert wait_for(lambda: stream.sent > sent + 40, 15)
        assert stream.live.watched  # it reads on: a program that did not would have been closed
        broker.send(signal.SIGCONT)
        with Listener(broker.port) as listener:
            count = len(listener.of("test/truck/estimate"))
            assert wait_for(lambda: len(listener.of("test/truck/estimate")) > count + 3, 10)
        done = counters(process)
    assert done["dropped_slow"] > 10 and done["connected"] == 1


def test_a_port_that_answers_nothing_holds_up_neither_the_daemon_nor_the_end(tmp_path, stream):
    with SilentServer() as server, publisher(tmp_path, stream, f"mqtt://127.0.0.1:{server.port}") as process:
        assert wait_for(lambda: server.accepted, 15), process.output
        sent = stream.sent
        assert wait_for(lambda: stream.sent > sent + 10, 10) and stream.live.watched
        begin_s = time.monotonic()
        done = counters(process)
        assert time.monotonic() - begin_s < 5 and process.process.returncode == 0
    assert done["dropped_offline"] > 5 and done["published"] == 0


@pytest.mark.slow
def test_user_and_password_come_from_the_environment(tmp_path, stream):
    passwords = tmp_path / "passwords"
    subprocess.run(["mosquitto_passwd", "-b", "-c", passwords, "truck", "geheim-7"], check=True)
    secret = tmp_path / "secret"
    secret.write_text("geheim-7\n")
    with Broker(tmp_path, "allow_anonymous false", f"password_file {passwords}") as broker:
        with publisher(tmp_path, stream, broker.url) as process:
            assert wait_for(lambda: "broker-refused" in process.output, 15), process.output
            assert "Not authorized" in process.output
        right = {"CANEST_MQTT_USER": "truck", "CANEST_MQTT_PASSWORD_FILE": str(secret)}
        with (
            Listener(broker.port, user=("truck", "geheim-7")) as listener,
            publisher(tmp_path, stream, broker.url, **right) as process,
        ):
            assert wait_for(lambda: listener.of("test/truck/estimate"), 15), process.output
            assert "geheim" not in process.output


def certificates(folder):
    """Make a CA and a certificate for localhost; return their files."""
    ca, key, request, own = (folder / name for name in ("ca.pem", "key.pem", "request.pem", "own.pem"))
    ca_key, names = folder / "ca-key.pem", folder / "names"
    names.write_text("subjectAltName=DNS:localhost\n")
    new = ["openssl", "req", "-newkey", "rsa:2048", "-nodes", "-subj"]
    for command in (
        [*new, "/CN=test CA", "-x509", "-keyout", ca_key, "-out", ca, "-days", "2"],
        [*new, "/CN=localhost", "-keyout", key, "-out", request],
        ["openssl", "x509", "-req", "-in", request, "-CA", ca, "-CAkey", ca_key, "-CAcreateserial",
         "-out", own, "-days", "2", "-extfile", names],
    ):  # fmt: skip
        subprocess.run(command, check=True, capture_output=True)
    return ca, own, key


@pytest.mark.slow
def test_tls_trusts_the_given_authority_alone(tmp_path, stream):
    import ssl

    ca, own, key = certificates(tmp_path)
    with Broker(tmp_path, f"cafile {ca}", f"certfile {own}", f"keyfile {key}") as broker:
        url = f"mqtts://localhost:{broker.port}"
        with publisher(tmp_path, stream, url) as process:
            assert wait_for(lambda: "broker-unreachable" in process.output, 15), process.output
            assert "certificate verify failed" in process.output
        with (
            Listener(broker.port, tls=ssl.create_default_context(cafile=ca)) as listener,
            publisher(tmp_path, stream, url, "--ca", ca) as process,
        ):
            assert wait_for(lambda: listener.of("test/truck/estimate"), 15), process.output


@pytest.mark.slow
def test_the_sensors_are_announced_to_home_assistant_only_if_asked(tmp_path, stream):
    jinja2 = pytest.importorskip("jinja2")
    with Broker(tmp_path) as broker, Listener(broker.port) as listener:
        with publisher(tmp_path, stream, broker.url):
            assert wait_for(lambda: listener.of("test/truck/estimate"), 15)
        assert not [topic for topic, *_ in listener.messages if topic.startswith("homeassistant")]
        with publisher(tmp_path, stream, broker.url, "--home-assistant"):
            assert wait_for(lambda: len(sensors(listener)) == 6, 15)
        estimate = listener.json("test/truck/estimate")[-1]
    shown = {}
    for content in sensors(listener):
        assert content["state_topic"] == "test/truck/estimate"
        assert content["availability_topic"] == "test/truck/availability"
        shown[content["name"]] = jinja2.Template(content["value_template"]).render(value_json=estimate)
        nothing = dict.fromkeys(estimate) | {"status": "not available", "gate": "stale"}
        assert jinja2.Template(content["value_template"]).render(value_json=nothing) in (
            "None", "not available", "stale",
        )  # fmt: skip
    assert shown["Mass"] == str(estimate["mass_kg"]) and shown["Road grade"] == "1.0"
    assert len({content["unique_id"] for content in sensors(listener)}) == 6


def sensors(listener):
    return [
        json.loads(text) for topic, text, _ in listener.messages if topic.startswith("homeassistant/sensor/")
    ]
