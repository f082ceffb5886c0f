"""What a person sees of a run over many logs: what became of them so far, and how long the rest will take."""

from __future__ import annotations

import pytest

from canest.cli import fleet_progress
from canest.cli.fleet_progress import FleetProgress
from canest.fleet.job import Outcome


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands where it is put."""
    now = [0.0]
    monkeypatch.setattr(fleet_progress.time, "monotonic", lambda: now[0])
    return now


def test_the_time_left_goes_by_the_work_and_not_by_the_number_of_logs(clock, capsys):
    work = {"long": 900.0, "short": 100.0, "stray": 500.0, "there": 400.0, "bad": 0.0, "later": 1000.0}
    with FleetProgress() as progress:
        progress.begin(work)
        progress.step(Outcome("stray", unmatched="no rule"))
        progress.step(Outcome("there", present=True))
        progress.step(Outcome("bad", error="nonsense"))
        clock[0] = 90.0
        progress.step(Outcome("long"))
    line = "4 of 6 logs: 1 done, 1 there before, 1 failed, 1 without a rule; about 2 min left"
    assert capsys.readouterr().err == line + "\n"


def test_lines_come_now_and_then(clock, capsys):
    with FleetProgress() as progress:
        progress.begin({str(n): 1.0 for n in range(100)})
        for n in range(50):
            clock[0] += 10.0
            progress.step(Outcome(str(n)))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 8
    assert lines[0] == "6 of 100 logs: 6 done; about 16 min left"


def test_an_interrupted_run_counts_only_what_is_kept(clock, capsys):
    with pytest.raises(KeyboardInterrupt), FleetProgress() as progress:
        progress.begin({str(n): 1.0 for n in range(4)})
        progress.step(Outcome("0"))
        progress.step(Outcome("1", unmatched="no rule"))
        progress.step(Outcome("2", error="nonsense"))
        raise KeyboardInterrupt
    kept = "1 of 4 logs are done and kept: the same command with --resume does the rest\n"
    assert capsys.readouterr().err == kept
