"""No command pays for the depth at which its loops happen to call functions."""

from __future__ import annotations

from resource import RUSAGE_SELF, getrusage

from canest.cli import main

CALLS = 500


def called() -> None:
    pass


called.__code__ = called.__code__.replace(co_stacksize=100)  # some depths are beside a border of any block


def most_faults(depth: int) -> int:
    """Return the most page faults that `CALLS` calls took at one of so many depths."""
    before = getrusage(RUSAGE_SELF).ru_minflt
    for _ in range(CALLS):
        called()
    faults = getrusage(RUSAGE_SELF).ru_minflt - before
    return max(faults, most_faults(depth - 1)) if depth else faults


def test_no_depth_of_calls_maps_memory_at_each(monkeypatch):
    monkeypatch.setattr(main.cli, "main", lambda **_: most_faults(300))
    assert main.run([]) < CALLS / 5
