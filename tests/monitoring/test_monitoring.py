"""The dashboard and the alerts that ship: names, syntax, and what a real Prometheus makes of them."""

from __future__ import annotations

import json
import os
import re
import runpy
import shutil
import subprocess
import urllib.parse
import urllib.request
from pathlib import Path

import pytest
import yaml

from canest.telemetry.metrics import METRICS
from tests.serve.rig import Vehicle, free_port, has_multicast, is_up, wait_for

ROOT = Path(__file__).resolve().parents[2]
DASHBOARD = ROOT / "monitoring" / "grafana-dashboard.json"
ALERTS = ROOT / "monitoring" / "prometheus-alerts.yml"
TOOLS = pytest.mark.skipif(
    shutil.which("promtool") is None and "CI" not in os.environ, reason="prometheus (a package of the system)"
)


def dashboard_queries():
    panels = json.loads(DASHBOARD.read_text())["panels"]
    return [target["expr"] for panel in panels for target in panel["targets"]]


def alert_queries():
    return [rule["expr"] for group in yaml.safe_load(ALERTS.read_text())["groups"] for rule in group["rules"]]


def test_the_dashboard_is_made_by_its_tool():
    tool = runpy.run_path(str(ROOT / "tools" / "grafana_dashboard.py"))
    assert DASHBOARD.read_text() == tool["text"](), "python tools/grafana_dashboard.py --write"


def test_every_metric_named_is_one_of_the_daemon():
    queries = [*dashboard_queries(), *alert_queries()]
    named = {name for query in queries for name in re.findall(r"\bcanest_\w+", query)}
    assert len(named) > 20 and named <= METRICS.keys()


def unknown(given, read, path=""):
    """Return the keys and values of a file that came to nothing when it was read."""
    if isinstance(given, dict):
        return [
            lost
            for key, value in given.items()
            for lost in (unknown(value, read[key], f"{path}.{key}") if key in read else [f"{path}.{key}"])
        ]
    if isinstance(given, list):
        pairs = zip(given, read, strict=True)
        return [lost for at, pair in enumerate(pairs) for lost in unknown(*pair, f"{path}[{at}]")]
    return [] if given == read else [f"{path}: {given!r} is {read!r}"]


def test_grafanas_own_model_of_a_dashboard_knows_every_key():
    pytest.importorskip("grafana_foundation_sdk")
    from grafana_foundation_sdk.cog import encoder, plugins
    from grafana_foundation_sdk.models.dashboard import Dashboard

    plugins.register_default_plugins()
    given = json.loads(DASHBOARD.read_text())
    read = json.loads(encoder.JSONEncoder().encode(Dashboard.from_json(given)))
    assert unknown(given, read) == []
    given["panels"][0]["titel"] = "a mistake"
    read = json.loads(encoder.JSONEncoder().encode(Dashboard.from_json(given)))
    assert unknown(given, read) == [".panels[0].titel"]


def test_panels_do_not_overlap():
    taken = set()
    for panel in json.loads(DASHBOARD.read_text())["panels"]:
        at = panel["gridPos"]
        cells = {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        assert not cells & taken and max(x for x, _ in cells) < 24
        taken |= cells


@TOOLS
def test_promtool_accepts_the_rules():
    done = subprocess.run(["promtool", "check", "rules", ALERTS], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "12 rules found" in done.stdout, done.stderr


CASES = """
rule_files: [{rules}]
evaluation_interval: 1m
tests:
  - interval: 1m
    input_series:
      - {{series: 'canest_bus_up{{job="canest", instance="truck"}}', values: '1x5 0x60'}}
      - {{series: 'canest_uptime_seconds{{job="canest", instance="truck"}}', values: '0+60x65'}}
      - {{series: 'canest_uptime_seconds{{job="canest", instance="dead"}}', values: '0+60x10 600x55'}}
      - {{series: 'canest_status{{job="canest", instance="truck", status="valid"}}', values: '1x65'}}
      - {{series: 'canest_mass_kilograms{{job="canest", instance="truck"}}', values: '20000x65'}}
      - {{series: 'canest_other_mass_kilograms{{job="canest", instance="truck", source="0x33"}}', values: '25000x65'}}
      - {{series: 'canest_config_refused{{job="canest", instance="truck"}}', values: '0x65'}}
    alert_rule_test:
      - eval_time: 60m
        alertname: CanestBusDown
        exp_alerts:
          - exp_labels: {{job: canest, instance: truck, severity: critical}}
            exp_annotations:
              summary: The CAN interface of truck is down
              description: canest status shows the reason. It takes the interface up again by itself when it is back.
      - {{eval_time: 4m, alertname: CanestBusDown}}
      - eval_time: 60m
        alertname: CanestStopped
        exp_alerts:
          - exp_labels: {{job: canest, instance: dead, severity: critical}}
            exp_annotations:
              summary: canest on dead has stopped, and its metrics file stays as it was
              description: journalctl -u 'canest@*' shows why.
      - eval_time: 60m
        alertname: CanestMassDiffers
        exp_alerts:
          - exp_labels: {{job: canest, instance: truck, source: "0x33", severity: warning}}
            exp_annotations:
              summary: The mass of truck differs by 25% from that of 0x33
              description: "One of the two is wrong: another ECU (SPN 1760) or the config."
      - {{eval_time: 60m, alertname: CanestConfigRefused}}
"""  # noqa: E501


@TOOLS
def test_alerts_come_when_they_should_and_not_otherwise(tmp_path):
    cases = tmp_path / "cases.yml"
    cases.write_text(CASES.format(rules=ALERTS))
    done = subprocess.run(["promtool", "test", "rules", cases], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def api(port, path, **query):
    url = f"http://127.0.0.1:{port}/api/v1/{path}?{urllib.parse.urlencode(query)}"
    with urllib.request.urlopen(url, timeout=5) as answer:
        return json.load(answer)["data"]


@TOOLS
@pytest.mark.slow
@pytest.mark.skipif(not has_multicast(), reason="no multicast on this machine")
def test_a_prometheus_that_scrapes_a_daemon_answers_every_query(tmp_path):
    pytest.importorskip("prometheus_client")
    vehicle, metrics, port = Vehicle(tmp_path, "239.74.163.88"), free_port(), free_port()
    config = tmp_path / "prometheus.yml"
    config.write_text(
        f"global: {{scrape_interval: 500ms, evaluation_interval: 1s}}\nrule_files: [{ALERTS}]\n"
        f"scrape_configs: [{{job_name: canest, static_configs: [{{targets: ['127.0.0.1:{metrics}']}}]}}]\n"
    )
    command = [
        "prometheus", f"--config.file={config}", f"--storage.tsdb.path={tmp_path / 'data'}",
        f"--web.listen-address=127.0.0.1:{port}",
    ]  # fmt: skip
    with vehicle.daemon("--set", f"service.metrics_port={metrics}"), vehicle.drive():
        assert wait_for(lambda: is_up(metrics), 30)
        log = (tmp_path / "prometheus.log").open("w")
        with log, subprocess.Popen(command, stdout=log, stderr=log) as prometheus:
            try:
                assert wait_for(lambda: is_ready(port), 20)
                assert wait_for(
                    lambda: api(port, "query", query="count(canest_uptime_seconds)")["result"], 20
                )
                for query in dashboard_queries():
                    api(port, "query", query=query.replace("$instance", ".*"))  # a wrong one is status 400
                assert wait_for(lambda: _healthy(port), 20), api(port, "rules")
                shown = {
                    series["__name__"] for series in api(port, "series", **{"match[]": '{job="canest"}'})
                }
            finally:
                prometheus.terminate()
    # those that are not there are counted by signal or sender, and come with the first event
    assert {name for name in shown if name.startswith("canest_")} <= METRICS.keys()
    queries = "".join(dashboard_queries())
    assert len([name for name in shown if name in queries]) >= 14


def is_ready(port):
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/-/ready", timeout=5) as answer:
            return answer.status == 200
    except OSError:  # no connection yet, or 503
        return False


def _healthy(port):
    rules = [rule for group in api(port, "rules")["groups"] for rule in group["rules"]]
    return len(rules) == 12 and all(rule["health"] == "ok" for rule in rules)
