"""Progress where standard error is no terminal."""

import time

import pytest

from canest.cli import progress
from canest.cli.progress import Bar, Stages


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(progress, "PATIENCE_S", 0.05)
    monkeypatch.setattr(progress, "LINE_PATIENCE_S", 0.05)


def test_every_stage_is_one_line(capsys):
    with Stages("diagnose") as bar:
        time.sleep(0.06)
        for text, share in (
            ("reading", 0.0), ("reading a.log", 0.0), ("reading b.log", 0.1), ("trying every effect", 0.3),
            ("trying headwind", 0.4), ("before and after", 0.8), ("done", 1.0), ("writing", 0.95),
        ):  # fmt: skip
            bar.show(text, share)
    told = capsys.readouterr()
    assert told.out == ""
    lines = [line.split("%")[1].strip() for line in told.err.splitlines()]
    assert [line for line in lines if line != "diagnose"] == [
        "reading",
        "trying every effect",
        "before and after",
        "writing",
    ]


def test_a_stage_that_takes_long_is_told_while_it_lasts(capsys):
    """Nothing was told for as long as numba compiles."""
    with Stages("diagnose") as bar:
        bar.show("reading drive.log", 0.0)
        time.sleep(0.3)
        assert capsys.readouterr().err == "  0 %  reading drive.log\n"


def test_what_is_done_at_once_tells_nothing(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_PATIENCE_S", 60.0)
    with Stages("diagnose") as bar:
        bar.show("reading", 0.0)
        bar.show("writing", 0.95)
    assert capsys.readouterr().err == ""


def test_a_bar_is_no_line(capsys):
    with Bar("replay") as bar:
        time.sleep(0.1)
        bar.update(1, 2)
    assert capsys.readouterr().err == ""
