"""Reports: complete, small enough, and alive in a real browser without network."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from itertools import combinations, groupby
from pathlib import Path

import numpy as np
import pytest

from canest import __version__
from canest.core.estimates import Estimates
from canest.core.frames import FloatColumn
from canest.core.gates import Gate
from canest.core.samples import EstimateBlock, ModelBlock
from canest.demo import DRIVE, TRUTH
from canest.offline.compare import Comparison
from canest.report.compare_page import COLUMNS, _strokes, compare_page, ranked
from canest.report.recorder import POINTS_MAX, Recorder, Whiteness, residual_N
from canest.system.installation import how_to_add

pytest.importorskip("jinja2")
pytest.importorskip("plotly")

MB = 1_000_000


def block(
    t_us: np.ndarray, gate: np.ndarray | None = None, **columns: FloatColumn
) -> tuple[ModelBlock, EstimateBlock]:
    """Samples and estimates that are zero but for what is given."""
    n = len(t_us)
    zero, no = np.zeros(n), np.zeros(n, np.bool_)
    floats = {name: columns.get(name, zero) for name in ModelBlock.__slots__}
    model = ModelBlock(**{
        **floats, "t_us": t_us, "gate": np.zeros(n, np.uint8) if gate is None else gate.astype(np.uint8),
        "restart": no, "stopped": no, "ax_ok": no,
    })  # fmt: skip
    mass = np.full(n, 1000.0)
    return model, EstimateBlock(mass, zero + 10, zero, zero + 0.01, np.zeros(n, np.uint8))


class TestRecorder:
    def test_memory_is_bounded(self):
        recorder = Recorder()
        for part in range(60):
            recorder(*block(20_000 * np.arange(part * 50_000, (part + 1) * 50_000)))
        stamps, columns = recorder.columns()
        assert POINTS_MAX / 3 < len(stamps) <= POINTS_MAX
        assert all(len(column) == len(stamps) for column in columns.values())
        assert np.all(np.diff(stamps) == np.diff(stamps)[0])

    def test_closures_are_exact_and_do_not_depend_on_cuts(self):
        gate = np.zeros(500, int)
        gate[100:150], gate[150:160], gate[490:] = Gate.SHIFT, Gate.RECOVERY, Gate.BRAKE
        t_us = 20_000 * np.arange(500)
        whole, cut = Recorder(), Recorder()
        whole(*block(t_us, gate))
        for a in range(0, 500, 7):
            cut(*block(t_us[a : a + 7], gate[a : a + 7]))
        expected = [
            (2_000_000, 3_000_000, Gate.SHIFT),
            (3_000_000, 3_200_000, Gate.RECOVERY),
            (9_800_000, 10_000_000, Gate.BRAKE),
        ]
        assert whole.closures() == cut.closures() == expected

    def test_a_gap_in_the_log_is_no_closure(self):
        recorder = Recorder()
        gate = np.full(10, int(Gate.BRAKE))
        recorder(*block(20_000 * np.arange(10), gate))
        recorder(*block(20_000 * np.arange(1000, 1010), gate))
        assert recorder.closures() == [
            (0, 200_000, Gate.BRAKE),
            (20_000_000, 20_200_000, Gate.BRAKE),
        ]

    def test_thousands_of_closures_are_thinned(self):
        recorder = Recorder()
        gate = (np.arange(100_000) % 2) * int(Gate.SHIFT)
        recorder(*block(20_000 * np.arange(100_000), gate))
        assert len(recorder.closures()) < 25_000


class TestWhiteness:
    def residuals(self, force: np.ndarray) -> Whiteness:
        w = Whiteness()
        n = len(force)
        # 1000 kg on the level without rolling resistance: the residual is minus the force
        w.push(*block(1_000_000 * np.arange(n), force_N=force))
        return w

    def test_white_noise_passes(self):
        w = self.residuals(np.random.default_rng(1).normal(0, 50, 4000))
        assert w.count == 4000
        assert w.rms_N == pytest.approx(50, rel=0.05)
        assert abs(w.correlation) < 0.05
        assert abs(w.runs_z) < 3

    def test_a_slow_wave_does_not(self):
        w = self.residuals(50 * np.sin(np.arange(4000) / 40))
        assert w.correlation > 0.95
        assert w.runs_z < -20

    @pytest.mark.parametrize("gaps", [(), (3, 4, 8, 11), range(1, 14)], ids=["none", "some", "everywhere"])
    def test_runs_are_those_of_the_signs_whatever_gaps_the_gates_make(self, gaps):
        signs = np.array([1, 1, 1, 1, -1, -1, -1, 1, 1, -1, -1, -1, -1, 1])
        t_us = 1_000_000 * (np.arange(14) + np.cumsum(np.isin(np.arange(14), gaps)))
        w = Whiteness()
        w.push(*block(t_us, force_N=-50.0 * signs))
        runs = sum(1 for _ in groupby(signs))
        # every order in which these seven positive and seven negative signs may come
        orders = np.full((3432, 14), -1)
        for order, places in zip(orders, combinations(range(14), 7), strict=True):
            order[list(places)] = 1
        by_chance = 1 + np.count_nonzero(np.diff(orders, axis=1), axis=1)
        assert w.runs == runs == 5
        assert w.runs_z == pytest.approx((runs - by_chance.mean()) / by_chance.std())

    def test_gaps_of_the_gates_leave_the_correlation_as_it_is(self):
        rng = np.random.default_rng(2)
        force = np.zeros(20_000)
        for k in range(1, len(force)):
            force[k] = 0.8 * force[k - 1] + rng.normal(0, 30)
        seconds = np.arange(len(force))
        seen = seconds % 3 < 2  # each third second a gate is closed
        w = Whiteness()
        w.push(*block(1_000_000 * seconds[seen], force_N=force[seen]))
        assert w.correlation == pytest.approx(0.8, abs=0.02)

    def test_residual_by_hand(self):
        one = np.ones(1)
        # 2000 kg, 0.5 m/s2, 100 % grade (45 degrees), mu 0.01
        found = residual_N(2000 * one, 0.5 * one, one, 0.01 * one, 500 * one)
        assert found[0] == pytest.approx(2000 * (0.5 + 9.80665 * (0.5**0.5 + 0.01 * 0.5**0.5)) - 500)


@pytest.fixture(scope="module")
def reports(tmp_path_factory) -> dict[str, Path]:
    from canest.cli.main import run

    folder = tmp_path_factory.mktemp("reports")
    made = {"replay": folder / "replay.html", "compare": folder / "compare.html"}
    truth = ["--truth", str(TRUTH)]
    assert run(["replay", str(DRIVE), "-c", "class8", *truth, "--report", str(made["replay"])]) == 0
    only = ["--only", "canest,rlsmf,dgo", "--interpreted"]
    assert run(["compare", str(DRIVE), "-c", "class8", *truth, *only, "--report", str(made["compare"])]) == 0
    return made


@pytest.mark.parametrize("kind", ["replay", "compare"])
def test_one_small_file_without_outside_references(reports, kind):
    html = reports[kind].read_text()
    assert len(html) < 8 * MB
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)\s*=", html)


def figure_of(report: Path) -> dict:
    data = re.search(
        r'<script type="application/json" id="data1">(.*?)</script>', report.read_text(), re.DOTALL
    )
    return json.loads(data[1])


def curves_of(figure: dict) -> dict[str, list[float | None]]:
    return {trace["name"]: trace["y"] for trace in figure["data"] if "name" in trace}


def contrast(one: str, other: str) -> float:
    """Ratio of luminances (WCAG 2.1) of two colours #rrggbb."""

    def luminance(colour: str) -> float:
        shares = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [s / 12.92 if s <= 0.03928 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("kind", ["replay", "compare"])
def test_words_can_be_read_and_figures_have_a_name(reports, kind):
    html = reports[kind].read_text("utf-8")
    html = html[html.index("<style>") : html.index("</style>")] + html[html.index("<main>") :]
    colours = dict(re.findall(r"--(\w+): (#\w{6})", html))
    for words in ("ink", "muted", "good", "warn", "bad"):
        assert min(contrast(colours[words], ground) for ground in ("#ffffff", colours["wash"])) >= 4.5, words
    assert html.count('class="figure"') == html.count('role="img" aria-label="') > 0
    assert html.count("<th") == html.count('<th scope="col"') > 0
    for figure in re.findall(r'type="application/json"[^>]*>(.*?)</script>', html, re.S):
        axes = [a for n, a in json.loads(figure)["layout"].items() if n.startswith("xaxis")]
        assert all(axis["exponentformat"] == "none" for axis in axes)  # 10,000 s, not 10k


def test_curves_of_a_comparison_break_where_the_log_pauses():
    n = 3000
    t_us = 20_000 * np.concatenate((np.arange(n), np.arange(n) + 180_000))
    one, code = np.ones(2 * n), np.zeros(2 * n, np.uint8)
    estimates = Estimates(t_us, 2e4 * one, one, 0.01 * one, one, code, code)
    row = dict.fromkeys([key for key, _, _ in COLUMNS], 1.0) | {"note": ""}
    table = {"estimators": {"canest": row}, "default": "canest", "compiled": False, "notes": []}
    result = Comparison(table, {"canest": estimates}, 2e4 * one, 0.01 * one, 20 * one)
    figure = json.loads(compare_page("x.log", "truck", result).sections[-1].figure)
    assert [trace["y"].count(None) for trace in figure["data"]] == [1] * 5
    assert all(len(trace["y"]) == len(figure["shared"][trace["x"]]) for trace in figure["data"])


def test_a_comparison_too_short_for_an_rms_ranks_by_the_end():
    row = dict.fromkeys([key for key, _, _ in COLUMNS])
    ends = {"far": -40.0, "near": 0.5, "none": None, "middle": 3.0}
    assert ranked({name: row | {"mass_end_pct": end} for name, end in ends.items()}) == [
        "near", "middle", "far", "none",
    ]  # fmt: skip


def test_curves_of_a_comparison_all_look_different():
    for count in (3, 15, 16, 25):
        names = [f"e{k}" for k in range(count)]
        strokes = _strokes(names, "e2")
        assert len({(s.colour, s.dash) for s in strokes.values()}) == count
        assert [name for name in names if strokes[name].width > 2] == ["e2"]


def test_every_report_has_its_config_and_version(reports):
    for name, path in reports.items():
        text = path.read_text()
        assert f"Used by canest {__version__}" in text and "wheel_radius_m: " in text, name


def test_every_curve_is_there(reports):
    figure = figure_of(reports["replay"])
    curves = curves_of(figure)
    assert {"mass", "true mass", "grade", "true grade", "speed", "net engine torque", "gear"} <= set(curves)
    assert {"traction", "net force", "residual", "gate: shift"} <= set(curves)
    mass = next(trace for trace in figure["data"] if trace.get("name") == "mass")
    assert len(figure["shared"][mass["x"]]) == len(mass["y"]) > 800
    assert abs(mass["y"][-1] - 21.0) < 2.0
    torque = [y for y in curves["net engine torque"] if y is not None]
    assert 1000 < max(torque) < 3000
    assert figure["layout"]["annotations"] == []


def test_torque_measured_at_the_wheels_is_called_so(tmp_path, canest_run):
    table, report = tmp_path / "drive.csv", tmp_path / "r.html"
    rows = (f"{i / 10},{5 + i / 100},{200 + i % 30},{200 - i % 30}" for i in range(300))
    table.write_text("t_s,v,left,right\n" + "\n".join(rows))
    config = tmp_path / "car.yaml"
    config.write_text(
        "vehicle: {mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.35, final_drive: 9.7,"
        " drag_area_m2: 0.7, rolling_resistance: 0.01}\n"
        "sampling: {time_column: t_s}\n"
        "signals: {vehicle_speed: {column: v, unit: m/s}, half_shaft_torque_left: {column: left, unit: Nm},"
        " half_shaft_torque_right: {column: right, unit: Nm}}\n"
    )
    assert canest_run("replay", table, "-c", config, "--report", report) == 0
    assert set(curves_of(figure_of(report))["torque at the wheels"]) - {None} == {400}


def test_what_is_not_known_is_a_gap(tmp_path, canest_run):
    bike, report = Path(__file__).parents[1] / "data" / "ip332" / "bike.log.xz", tmp_path / "bike.html"
    assert canest_run("replay", bike, "-c", "class8", "--report", report) == 0
    curves = curves_of(figure := figure_of(report))
    # the engine says "not available", the wheels turn
    for name in ("net engine torque", "gear", "traction", "net force", "residual", "mass"):
        assert set(curves[name]) <= {None}
    speeds = [y for y in curves["speed"] if y is not None]
    assert len(speeds) > 50
    assert max(speeds) > 1
    assert len(figure["layout"]["annotations"]) == 6


def test_log_without_an_estimate_still_has_a_report(tmp_path, canest_run):
    bike = Path(__file__).parents[1] / "data" / "ip332" / "bike.log.xz"
    assert canest_run("replay", bike, "-c", "kenworth", "--report", tmp_path / "bike.html") == 0
    html = (tmp_path / "bike.html").read_text()
    assert "No estimate: engine_torque_pct" in html


def test_stamps_of_no_year_still_have_a_report(tmp_path, canest_run):
    log = tmp_path / "far.log"
    frame = "can0 0CF00400#F18585641300FFFF"
    log.write_text(f"(917000000000.000000) {frame}\n(917000000000.500000) {frame}\n")
    assert canest_run("replay", log, "-c", "class8", "--report", tmp_path / "far.html") == 0


def test_empty_log_still_has_a_report(tmp_path, canest_run):
    log, out = tmp_path / "empty.log", tmp_path / "e.html"
    log.write_text("")
    assert canest_run("replay", log, "-c", "kenworth", "--report", out) == 0
    assert "the log is empty" in out.read_text()


def test_names_cannot_break_out_of_the_page(tmp_path, canest_run):
    config = "vehicle.name='<script>alert(1)</script>'"
    out = tmp_path / "r.html"
    assert canest_run("replay", DRIVE, "-c", "class8", "--set", config, "--report", out) == 0
    assert "<script>alert(1)" not in out.read_text()


def test_report_without_its_packages_is_one_line(tmp_path, canest_run, capsys, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "jinja2", None)
    assert canest_run("replay", DRIVE, "-c", "class8", "--report", tmp_path / "r.html") == 1
    assert how_to_add("report") in capsys.readouterr().err


@pytest.fixture
def canest_run():
    from canest.cli.main import run

    return lambda *arguments: run([str(argument) for argument in arguments])


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize("kind", ["replay", "compare"])
def test_opens_in_a_browser_without_network(reports, kind, tmp_path):
    process = subprocess.run(
        [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={tmp_path}", "--window-size=1280,1600",
            "--virtual-time-budget=10000", "--enable-logging=stderr", "--dump-dom", f"file://{reports[kind]}",
        ],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    dom = process.stdout
    assert not re.findall(r"Uncaught|ReferenceError|TypeError", process.stderr)
    curves = re.findall(r'class="js-line"[^>]*\bd="M[^"]{100,}"', dom)
    assert len(curves) >= 5, "plotly has drawn no curves"
    assert 'class="main-svg"' in dom
