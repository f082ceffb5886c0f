"""What a service reports whose unit forbids the sockets that its config needs."""

from __future__ import annotations

import errno
import io
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from canest.bus.link import open_link
from canest.config import load_config
from canest.config.bus import Bus
from canest.system.files import Background
from canest.system.journal import Journal
from canest.telemetry.endpoints import Endpoints

MULTICAST = Bus(interface="udp_multicast", channel="239.74.163.2")
FORBIDDEN = "RestrictAddressFamilies of the unit forbids AF_INET: canest install-service"


def why_absent(bus: Bus) -> str:
    """Return why an interface does not open, once its driver's thread has tried, however busy the machine."""
    receiver, _ = open_link(bus, [(0, 0)], transmit=False)
    end_s = time.monotonic() + 60.0
    while receiver.reason == "being opened" and time.monotonic() < end_s:
        receiver.collect()
    assert receiver.state == "absent"
    receiver.close()
    return receiver.reason


@pytest.fixture
def no_inet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sockets of AF_INET fail as under the unit, in python-can and everywhere else."""
    whole = socket.socket.__init__

    def init(self: Any, family: int = -1, *rest: Any, **named: Any) -> None:
        if family == socket.AF_INET:
            raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")
        whole(self, family, *rest, **named)

    monkeypatch.setattr(socket.socket, "__init__", init)


@pytest.mark.usefixtures("no_inet")
@pytest.mark.parametrize(
    ("under_systemd", "reason"), [(True, FORBIDDEN), (False, "this system allows no AF_INET sockets")]
)
def test_a_forbidden_multicast_names_what_forbids_it(
    monkeypatch: pytest.MonkeyPatch, under_systemd: bool, reason: str
) -> None:
    if under_systemd:
        monkeypatch.setenv("INVOCATION_ID", "0" * 32)
    else:
        monkeypatch.delenv("INVOCATION_ID", raising=False)
    assert reason in why_absent(MULTICAST)


@pytest.mark.usefixtures("no_inet")
def test_a_forbidden_metrics_port_names_what_forbids_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("prometheus_client")
    monkeypatch.setenv("INVOCATION_ID", "0" * 32)
    changes = [f"service.state_dir={tmp_path}", "service.metrics_port=9464"]
    log, background = io.StringIO(), Background()
    endpoints = Endpoints(load_config("vcan", changes), Journal(log), background)
    assert FORBIDDEN in log.getvalue()
    endpoints.close()
    background.close(1.0)


def test_an_interface_that_is_merely_absent_is_not_blamed_on_the_unit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("INVOCATION_ID", "0" * 32)
    reason = why_absent(Bus(interface="udp_multicast", channel="10.0.0.1"))
    assert reason not in ("", "being opened") and "RestrictAddressFamilies" not in reason
