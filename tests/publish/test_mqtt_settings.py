"""Brokers, topics and secrets that cannot be used are refused in one line."""

from __future__ import annotations

import re

import pytest

from canest.core.errors import UsageError
from canest.publish.mqtt_settings import Certificates, broker, checked_topic, topic_of

NO_FILES = Certificates()


@pytest.mark.parametrize(
    ("url", "host", "port", "encrypted"),
    [
        ("mqtt://localhost", "localhost", 1883, False),
        ("mqtts://fleet.example.org", "fleet.example.org", 8883, True),
        ("mqtt://[::1]:2000/", "::1", 2000, False),
    ],
)
def test_a_broker_has_the_usual_port_unless_it_is_given(url, host, port, encrypted):
    found = broker(url, NO_FILES, {})
    assert (found.address.host, found.address.port, found.tls is not None) == (host, port, encrypted)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("localhost", "--broker: is no broker, found 'localhost', expected mqtt://HOST"),
        ("http://localhost", "is no broker"),
        ("mqtt://", "is no broker"),
        ("mqtt://localhost:0", "is no broker"),
        ("mqtt://a..b", "is no broker"),
        ("mqtt://localhost:99999", "is no broker"),
        ("mqtt://localhost/topic", "is no broker"),
        (
            "mqtt://me:secret@localhost",
            "everybody on this machine can read a command line, expected user and",
        ),
    ],
)
def test_a_broker_that_cannot_be_used(url, message):
    with pytest.raises(UsageError, match=re.escape(message)) as refused:
        broker(url, NO_FILES, {})
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"CANEST_MQTT_PASSWORD": "x"}, "a password without a user, expected CANEST_MQTT_USER too"),
        ({"CANEST_MQTT_PASSWORD": "x", "CANEST_MQTT_PASSWORD_FILE": "y"}, "expected one of them"),
        ({"CANEST_MQTT_USER": "me", "CANEST_MQTT_PASSWORD_FILE": "/none"}, "cannot be read: No such"),
    ],
)  # fmt: skip
def test_credentials_that_cannot_be_used(environment, message):
    with pytest.raises(UsageError, match=message):
        broker("mqtt://localhost", NO_FILES, environment)


def test_certificates_are_for_tls_and_must_be_there(tmp_path):
    with pytest.raises(UsageError, match="are for TLS, found 'mqtt://localhost', expected mqtts://"):
        broker("mqtt://localhost", Certificates("ca.pem"), {})
    with pytest.raises(UsageError, match=r"no certificates for TLS: No such file.*ca\.pem"):
        broker("mqtts://localhost", Certificates(str(tmp_path / "ca.pem")), {})


def test_a_password_is_never_shown_and_its_way_is_judged():
    secret = {"CANEST_MQTT_USER": "me", "CANEST_MQTT_PASSWORD": "geheim"}
    assert "geheim" not in repr(broker("mqtt://localhost", NO_FILES, secret))
    open_ways = {
        url: broker(url, NO_FILES, secret).sends_password_in_the_clear
        for url in ("mqtt://localhost", "mqtt://127.0.0.1", "mqtt://10.0.0.7", "mqtts://10.0.0.7")
    }
    assert open_ways == {
        "mqtt://localhost": False,
        "mqtt://127.0.0.1": False,
        "mqtt://10.0.0.7": True,
        "mqtts://10.0.0.7": False,
    }


@pytest.mark.parametrize("topic", ["", "/", "a/#", "a/+/b", "$SYS/x", "/a", "a/", "a//b", "a\n"])
def test_a_topic_that_cannot_be_published_to(topic):
    with pytest.raises(UsageError, match="--topic: is no base topic"):
        checked_topic(topic)


def test_the_topic_of_a_vehicle_has_plain_letters():
    assert topic_of("Class 8, 21 t (Kenworth)") == "canest/class-8-21-t-kenworth"
    assert topic_of("#+") == "canest/vehicle"
