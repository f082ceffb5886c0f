"""`canest publish kuksa` as a process, a real gRPC server, and what KUKSA's own client reads back."""

from __future__ import annotations

import contextlib
import os
import re
import runpy
import signal
import time
from pathlib import Path

import pytest

from canest.core.errors import UsageError
from tests.publish.test_mqtt import certificates, counters
from tests.serve.rig import Command, Stream, wait_for

pytest.importorskip("kuksa.val.v2.val_pb2", reason="kuksa-client (extra: kuksa)")
import grpc

from canest.publish.kuksa_settings import databroker
from tests.publish.databroker import SPEED, WEIGHT, Databroker, tree

ROOT = Path(__file__).resolve().parents[2]
OVERALL, MASS = "Vehicle.CurrentOverallWeight", "Vehicle.Canest.Mass"
OURS = {f"Vehicle.Canest.{name}" for name in ("Mass", "MassStd", "Grade", "GradeStd", "Status", "Gate")}
STANDARD = tree(**WEIGHT, **SPEED)


@contextlib.contextmanager
def publisher(folder, stream, url, *more, **environment):
    arguments = ["--socket", stream.status_socket, "--broker", url, "--rate", 10]
    before = dict(os.environ)
    os.environ.update(environment)
    try:
        process = Command(folder, "publish", "kuksa", *arguments, *more)
    finally:
        os.environ.clear()
        os.environ.update(before)
    with process:
        yield process


def test_what_kuksas_own_client_reads_is_what_the_daemon_has_sent(tmp_path, stream):
    from kuksa_client.grpc import VSSClient

    with Databroker(STANDARD) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: broker.newest(OVERALL), 20), process.output
        seen = {}
        with VSSClient("localhost", broker.port, ensure_startup_connection=False) as client:
            for updates in client.subscribe_current_values([OVERALL, *OURS]):
                seen |= updates
                if len(seen) == 7 and seen[OVERALL].value > 20_003:
                    break
        values = {path: point.value for path, point in seen.items()}
        assert 20_003 < values[OVERALL] <= 20_006 and 20_000 <= values[MASS] <= 20_006
        assert values["Vehicle.Canest.MassStd"] == 200.0
        assert values["Vehicle.Canest.Grade"] == 1.0
        assert values["Vehicle.Canest.GradeStd"] == pytest.approx(0.1, rel=1e-6)  # 32 bits
        assert (values["Vehicle.Canest.Status"], values["Vehicle.Canest.Gate"]) == ("valid", "")
        assert abs(seen[MASS].timestamp.timestamp() - time.time()) < 60
        done = counters(process)
    assert done["confirmed"] == done["published"] > 7 and done["rejected"] == done["out_of_range"] == 0
    assert done["connected"] == 1


def test_a_mass_beyond_16_bits_is_left_out_there_and_whole_beside_it(tmp_path, stream):
    stream.mass_kg = 65_534.0  # and up to 6 kg more
    with Databroker(STANDARD) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: len(broker.values[MASS]) >= 15, 20), process.output
        done = counters(process)
        whole = [p.value.float for p in broker.values[MASS] if p.value.WhichOneof("typed_value")]
        narrow = [p.value.uint32 for p in broker.values[OVERALL] if p.value.WhichOneof("typed_value")]
        without = [p for p in broker.values[OVERALL] if p.value.WhichOneof("typed_value") is None]
    assert max(whole) > 65_536 and set(narrow) <= {65_534, 65_535} and without
    assert done["out_of_range"] > 0 == done["rejected"]
    assert f"value-out-of-range signal={OVERALL}" in process.output and "most=65535" in process.output


@pytest.mark.slow
def test_a_tree_that_has_made_the_weight_wider_gets_all_of_it(tmp_path, stream):
    stream.mass_kg = 120_000.0
    wide = {"CurrentOverallWeight": WEIGHT["CurrentOverallWeight"] | {"datatype": "uint32", "max": 200_000}}
    with Databroker(tree(**wide)) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: broker.newest(OVERALL), 20), process.output
        assert 120_000 <= broker.newest(OVERALL) <= 120_006


def test_the_standard_weight_has_a_value_only_while_the_mass_is_valid(tmp_path, stream):
    stream.status = 1
    with Databroker(STANDARD) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: broker.newest(MASS), 20), process.output
        assert wait_for(
            lambda: broker.newest("Vehicle.Canest.Status") == "converging", 5
        )  # a call of its own
        assert broker.newest(OVERALL) is None
        stream.status = 2
        assert wait_for(lambda: broker.newest(OVERALL), 5)


def test_a_databroker_without_the_overlay_gets_the_weight_alone_with_a_warning(tmp_path, stream):
    with Databroker(STANDARD, overlay=False) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: broker.newest(OVERALL), 20), process.output
        assert "signals-unknown" in process.output and "Vehicle.Canest.Grade" in process.output
        done = counters(process)
    assert done["published"] == len(broker.values[OVERALL]) and broker.values["Vehicle.Speed"] == []


def test_a_daemon_or_a_publisher_that_ends_leaves_no_value_behind(tmp_path):
    first = Stream(tmp_path)
    with Databroker(STANDARD) as broker, publisher(tmp_path, first, broker.url) as process:
        assert wait_for(lambda: broker.newest(OVERALL), 20), process.output
        first.close()
        assert wait_for(lambda: broker.newest(OVERALL) is None, 5)
        assert wait_for(lambda: broker.newest("Vehicle.Canest.Status") == "not available", 5)
        second = Stream(tmp_path)
        try:
            assert wait_for(lambda: broker.newest(OVERALL), 5)
            assert process.end(signal.SIGTERM) == 0
        finally:
            second.close()
        assert broker.newest(OVERALL) is None and broker.newest(MASS) is None


@pytest.mark.slow
def test_a_databroker_that_dies_costs_counted_values_and_is_found_again(tmp_path, stream):
    with Databroker(STANDARD) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: broker.newest(OVERALL), 20), process.output
        broker.__exit__()
        sent = stream.sent
        assert wait_for(lambda: "broker-lost" in process.output, 10)
        assert wait_for(lambda: stream.sent > sent + 20, 10) and stream.live.watched
        with Databroker(STANDARD, port=broker.port) as again:
            assert wait_for(lambda: again.newest(OVERALL), 20), process.output
            done = counters(process)
    assert done["connected"] == 2 and done["dropped_offline"] > 5


@pytest.mark.slow
def test_a_databroker_that_hangs_costs_counted_values_and_no_more(tmp_path, stream):
    with Databroker(STANDARD) as broker, publisher(tmp_path, stream, broker.url) as process:
        assert wait_for(lambda: broker.newest(OVERALL), 20), process.output
        broker.hang.set()
        sent = stream.sent
        assert wait_for(lambda: stream.sent > sent + 40, 15) and stream.live.watched
        broker.hang.clear()
        count = len(broker.values[MASS])
        assert wait_for(lambda: len(broker.values[MASS]) > count + 3, 20), process.output
        done = counters(process)
    assert done["dropped_slow"] + done["dropped_offline"] > 10


def test_a_token_comes_from_a_file_and_is_never_shown(tmp_path, stream):
    secret = tmp_path / "token"
    secret.write_text("eyJhbGciOi.geheim-7.x\n")
    with Databroker(STANDARD, token="eyJhbGciOi.geheim-7.x") as broker:
        with publisher(tmp_path, stream, broker.url) as process:
            assert wait_for(lambda: "broker-refused" in process.output, 20), process.output
            assert "Invalid auth token" in process.output
        with publisher(tmp_path, stream, broker.url, CANEST_KUKSA_TOKEN_FILE=str(secret)) as process:
            assert wait_for(lambda: broker.newest(OVERALL), 20), process.output
            assert "geheim" not in process.output


@pytest.mark.slow
def test_tls_trusts_the_given_authority_alone(tmp_path, stream):
    ca, own, key = certificates(tmp_path)
    pair = grpc.ssl_server_credentials([(key.read_bytes(), own.read_bytes())])
    with Databroker(STANDARD, credentials=pair) as broker:
        url = broker.url.replace("grpc:", "grpcs:")
        with publisher(tmp_path, stream, url) as process:
            assert wait_for(lambda: "broker-refused" in process.output, 20), process.output
        with publisher(tmp_path, stream, url, "--ca", ca) as process:
            assert wait_for(lambda: broker.newest(OVERALL), 20), process.output


@pytest.mark.parametrize(
    ("url", "ca", "environment", "message"),
    [
        ("localhost", None, {}, "--broker: is no broker, found 'localhost', expected grpc://HOST"),
        ("grpc://[::1", None, {}, "is no broker"),
        ("grpc://me:secret@localhost", None, {}, "everybody on this machine can read a command line"),
        ("grpc://localhost", "ca.pem", {}, "--ca is for TLS, found 'grpc://localhost', expected grpcs://"),
        ("grpcs://localhost", "/none", {}, "--ca: cannot be read: No such file"),
        ("grpcs://localhost", __file__, {}, "--ca: has no certificate"),
        ("grpc://localhost", None, {"CANEST_KUKSA_TOKEN": "two words\n"}, "CANEST_KUKSA_TOKEN: is no token"),
        ("grpc://localhost", None, {"CANEST_KUKSA_TOKEN_FILE": "/none"}, "cannot be read: No such file"),
    ],
)
def test_what_cannot_be_used_is_one_line(url, ca, environment, message):
    with pytest.raises(UsageError, match=re.escape(message)) as refused:
        databroker(url, ca, environment)
    assert "secret" not in str(refused.value)


def test_a_token_is_never_shown_and_its_way_is_judged():
    secret = {"CANEST_KUKSA_TOKEN": "geheim"}
    assert "geheim" not in repr(databroker("grpc://localhost", None, secret))
    ways = {
        url: databroker(url, None, secret).sends_token_in_the_clear
        for url in ("grpc://localhost", "grpc://10.0.0.7:55555", "grpcs://10.0.0.7")
    }
    assert list(ways.values()) == [False, True, False]


def test_the_overlay_is_made_by_its_tool():
    tool = runpy.run_path(str(ROOT / "tools" / "vss_overlay.py"))
    for path, content in tool["FILES"].items():
        assert path.read_text() == content(), "python tools/vss_overlay.py --write"
