"""The Tab key: commands, options, shipped names and files are offered, and no error is printed."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


def completed(line: str) -> list[str]:
    """Return what bash is offered at the end of ``line``."""
    words = line.split(" ")
    environment = os.environ | {
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
        "_CANEST_COMPLETE": "bash_complete",
    }
    code = "from canest.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("canest rep", "plain,replay"),
        ("canest replay --tr", "plain,--truth"),
        ("canest replay -c ken", "plain,kenworth"),
        ("canest replay -c ./my", "file,./my"),
        ("canest simulate pul", "plain,pulse-21t"),
        ("canest fleet re", "plain,report"),
    ],
)
def test_the_tab_key_offers(line, offered):
    assert offered in completed(line)
