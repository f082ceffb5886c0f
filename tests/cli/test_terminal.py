"""What is drawn only on a terminal: the demo's panel, progress bars, narrow windows."""

from __future__ import annotations

import io
import math
import time

import pytest
from rich.console import Console

from canest.cli import progress
from canest.cli.demo import DemoView
from canest.demo.session import Moment
from canest.node.estimate_frame import Estimate


def drawn(renderable, width: int) -> str:
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    console.print(renderable)
    return console.file.getvalue()


class TestDemoPanel:
    def moment(self, at_s: float, estimate: Estimate) -> Moment:
        return Moment(at_s, 180.0, estimate, 7, 21_000.0, 0.02)

    @pytest.mark.parametrize("width", [80, 100, 160])
    def test_fits_the_terminal(self, width):
        view = DemoView(20.0, "canest", width)
        for at_s in range(0, 181, 3):
            text = drawn(
                view.picture(self.moment(at_s, Estimate(21_500.0, 300.0, 0.021, 0.001, 2, 0))), width
            )
        lines = text.rstrip().splitlines()
        assert max(map(len, lines)) <= width
        assert "21,500 ± 300 kg" in text
        assert "+2.4 %" in text
        assert "valid" in text
        assert "learning" in text

    def test_before_the_first_number(self):
        text = drawn(DemoView(20.0, "canest", 90).picture(self.moment(0.0, Estimate())), 90)
        assert "no estimate yet" in text
        assert "waiting" in text
        assert "nan" not in text

    def test_closed_gate_is_named(self):
        estimate = Estimate(21_500.0, math.nan, math.nan, math.nan, 1, 6)
        text = drawn(DemoView(20.0, "canest", 90).picture(self.moment(10.0, estimate)), 90)
        assert "gate closed: shift" in text
        assert "converging" in text


class TestProgress:
    @staticmethod
    def terminal(monkeypatch) -> io.StringIO:
        """Make stderr a terminal (inside a test: between its phases pytest puts its own stderr back)."""
        stream = io.StringIO()
        stream.isatty = lambda: True
        monkeypatch.setattr(progress.sys, "stderr", stream)
        return stream

    def test_nothing_for_a_moment(self, monkeypatch):
        stream = self.terminal(monkeypatch)
        with progress.Bar("drive") as bar:
            bar.update(1, 10)
        assert stream.getvalue() == ""

    @pytest.mark.parametrize("name", ["drive", "drive [a].log"])  # a bracket is no markup
    def test_a_bar_for_who_waits(self, monkeypatch, name):
        stream = self.terminal(monkeypatch)
        monkeypatch.setattr(progress, "PATIENCE_S", 0.0)
        monkeypatch.setenv("TERM", "xterm")
        with progress.Bar(name) as bar:
            bar.update(5, 10)
        assert name in stream.getvalue()

    def test_a_bar_while_nothing_is_done_yet(self, monkeypatch):
        stream = self.terminal(monkeypatch)
        monkeypatch.setattr(progress, "PATIENCE_S", 0.01)
        monkeypatch.setenv("TERM", "xterm")
        with progress.Bar("drive"):
            until = time.monotonic() + 10.0
            while "drive" not in stream.getvalue() and time.monotonic() < until:
                time.sleep(0.01)
        assert "drive" in stream.getvalue()

    def test_nothing_where_nobody_looks(self, monkeypatch, capsys):
        monkeypatch.setattr(progress, "PATIENCE_S", 0.0)
        with progress.Count("replay", 2) as count:
            count.step("a")
            count.step("b")
        assert capsys.readouterr().err == ""
