"""Runs the command line in this process: fast, and with the same exit codes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from canest.cli.main import run

DATA = Path(__file__).parents[1] / "data"
KENWORTH = DATA / "kenworth" / "normal.log.xz"
BIKE = DATA / "ip332" / "bike.log.xz"


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    code: int
    out: str
    err: str


@pytest.fixture
def canest(capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Return a function that runs `canest ARGUMENTS`."""

    def call(*arguments: object) -> Done:
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Done(code, captured.out, captured.err)

    return call
