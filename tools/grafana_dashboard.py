"""Writes monitoring/grafana-dashboard.json from the panels below (``--write``), else prints it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

DASHBOARD = Path(__file__).resolve().parents[1] / "monitoring" / "grafana-dashboard.json"
HERE = 'instance=~"$instance"'
_DATASOURCE = {"type": "prometheus", "uid": "${datasource}"}
_WIDTH = 24


class Panel(NamedTuple):
    """A panel. queries: legend -> PromQL. unit: of Grafana. kind: stat or timeseries. size: width, height."""

    title: str
    queries: dict[str, str]
    unit: str = "short"
    kind: str = "timeseries"
    size: tuple[int, int] = (12, 8)
    about: str = ""


def here(metric: str, *labels: str) -> str:
    """Return the selector of a metric of the chosen instances."""
    return f"{metric}{{{', '.join((HERE, *labels))}}}"


MASS, MASS_STD = here("canest_mass_kilograms"), here("canest_mass_std_kilograms")
GRADE, GRADE_STD = here("canest_grade_ratio"), here("canest_grade_std_ratio")
SAMPLES = here("canest_samples_total")

PANELS = (
    Panel("Mass", {"{{instance}}": MASS}, "masskg", "stat", (4, 4)),
    Panel("Last known mass", {"{{instance}}": here("canest_last_mass_kilograms")}, "masskg", "stat", (4, 4),
          "The newest mass there was, also while the bus is quiet."),
    Panel("Its age", {"{{instance}}": here("canest_last_mass_age_seconds")}, "s", "stat", (4, 4)),
    Panel("Status", {"{{status}}": here("canest_status") + " == 1"}, "short", "stat", (4, 4)),
    Panel("Bus", {"{{instance}}": here("canest_bus_up")}, "bool_on_off", "stat", (4, 4)),
    Panel("Up for", {"{{instance}}": here("canest_uptime_seconds")}, "s", "stat", (4, 4)),
    Panel("Mass, two standard deviations to each side", {
        "mass": MASS, "upper": f"{MASS} + 2 * {MASS_STD}", "lower": f"{MASS} - 2 * {MASS_STD}",
        "other ECU {{source}}": here("canest_other_mass_kilograms"),
    }, "masskg"),
    Panel("Road grade, two standard deviations to each side", {
        "grade": GRADE, "upper": f"{GRADE} + 2 * {GRADE_STD}", "lower": f"{GRADE} - 2 * {GRADE_STD}",
    }, "percentunit"),
    Panel("Gates: share of the samples", {
        "{{gate}}": f"sum by (gate) (rate({SAMPLES}[1m])) "
                    f"/ ignoring(gate) group_left sum(rate({SAMPLES}[1m]))",
    }, "percentunit", about="open: the estimator learns. Any other gate: why it does not."),
    Panel("Frames received", {"{{instance}}": f"rate({here('canest_bus_frames_total')}[1m])"}, "pps"),
    Panel("Interface", {"{{event}}": f"increase({here('canest_bus_events_total')}[5m])"}),
    Panel("Signals in doubt", {
        "stuck {{signal}}": f"increase({here('canest_stuck_seconds_total')}[5m])",
        "jumps {{signal}}": f"increase({here('canest_implausible_jumps_total')}[5m])",
        "contested {{signal}} {{source}}": f"increase({here('canest_contested_samples_total')}[5m])",
        "too fast {{sender}}": f"increase({here('canest_sender_faster_seconds_total')}[5m])",
    }),
    Panel("Our node on the bus", {"{{event}}": f"rate({here('canest_node_events_total')}[1m])"}, "cps"),
    Panel("Ticks missed", {
        "share": f"rate({here('canest_ticks_missed_total')}[5m]) / "
                 f"(rate({here('canest_ticks_total')}[5m]) + rate({here('canest_ticks_missed_total')}[5m]))",
    }, "percentunit"),
    Panel("CPU time of a tick", {"{{instance}}": here("canest_tick_cpu_seconds")}, "s"),
    Panel("Errors, files, reloads", {
        "errors survived": f"increase({here('canest_failures_total')}[5m])",
        "files {{event}}": f"increase({here('canest_file_events_total', 'event=~' + json.dumps('.*(failed|refused|lost)'))}[5m])",  # noqa: E501
        "reloads refused": f"increase({here('canest_reloads_refused_total')}[5m])",
        "config refused now": here("canest_config_refused"),
    }),
)  # fmt: skip


def dashboard() -> dict[str, Any]:
    """Return the dashboard as Grafana imports it."""
    panels, x, y, row = [], 0, 0, 0
    for number, panel in enumerate(PANELS, 1):
        width, height = panel.size
        if x + width > _WIDTH:
            x, y, row = 0, y + row, 0
        panels.append(_panel(number, panel, {"x": x, "y": y, "w": width, "h": height}))
        x, row = x + width, max(row, height)
    return {
        "title": "canest", "uid": "canest", "tags": ["canest", "CAN"], "schemaVersion": 38, "version": 1,
        "editable": True, "refresh": "10s", "time": {"from": "now-1h", "to": "now"}, "timezone": "browser",
        "templating": {"list": [
            {"name": "datasource", "label": "Prometheus", "type": "datasource", "query": "prometheus"},
            {
                "name": "instance", "label": "Instance", "type": "query", "datasource": _DATASOURCE,
                "query": {"query": "label_values(canest_uptime_seconds, instance)", "refId": "instance"},
                "refresh": 2, "includeAll": True, "multi": True, "sort": 1,
                "current": {"text": "All", "value": "$__all"},
            },
        ]},
        "panels": panels,
    }  # fmt: skip


def _panel(number: int, panel: Panel, place: dict[str, int]) -> dict[str, Any]:
    targets = [
        {"refId": chr(ord("A") + at), "datasource": _DATASOURCE, "expr": query, "legendFormat": legend}
        for at, (legend, query) in enumerate(panel.queries.items())
    ]
    content: dict[str, Any] = {
        "id": number, "title": panel.title, "type": panel.kind, "gridPos": place, "datasource": _DATASOURCE,
        "targets": targets, "fieldConfig": {"defaults": {"unit": panel.unit}, "overrides": []},
    }  # fmt: skip
    if panel.about:
        content["description"] = panel.about
    if panel.title == "Status":
        content["options"] = {"textMode": "name", "reduceOptions": {"calcs": ["lastNotNull"]}}
    return content


def text() -> str:
    """Return the file's content."""
    return json.dumps(dashboard(), indent=1) + "\n"


if __name__ == "__main__":
    if "--write" in sys.argv:
        DASHBOARD.parent.mkdir(exist_ok=True)
        DASHBOARD.write_text(text())
    else:
        print(text(), end="")
