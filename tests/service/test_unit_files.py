"""The unit as systemd's own tools judge it; the guest tests (``tests/vcan``) run it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

UNITS = Path(__file__).parents[2] / "systemd"
UNIT = UNITS / "canest@.service"
#: ``systemd-analyze security`` goes from 0 (nothing it could harm) to 10.
EXPOSURE_LIMIT = 1.5


@pytest.fixture(scope="module")
def analyze() -> str:
    tool = shutil.which("systemd-analyze")
    if tool is None:
        reason = "needs systemd-analyze: apt-get install systemd"
        if "CI" in os.environ:
            pytest.fail(reason)
        pytest.skip(reason)
    return tool


def test_unit_verifies_without_a_word(analyze: str) -> None:
    done = subprocess.run(
        [analyze, "verify", str(UNIT)], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_unit_exposes_little(analyze: str) -> None:
    command = [analyze, "security", "--offline=true", "--no-pager", str(UNIT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    exposure = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert exposure, done.stdout + done.stderr
    assert float(exposure[1]) <= EXPOSURE_LIMIT


def test_unit_reaches_no_network_but_can() -> None:
    """Spelt out, because ``security`` would let a stray AF_INET pass for a few tenths."""
    assert "RestrictAddressFamilies=AF_CAN AF_UNIX" in UNIT.read_text().splitlines()


def test_a_weaker_unit_is_noticed(analyze: str, tmp_path: Path) -> None:
    """The two checks above can fail: an exposed unit scores high, a misspelt key is reported."""
    weak = tmp_path / "weak.service"
    weak.write_text("[Service]\nExecStart=/usr/bin/env true\nProtectHoem=yes\n")
    verify = subprocess.run(
        [analyze, "verify", str(weak)], capture_output=True, text=True, timeout=60, check=False
    )
    assert "ProtectHoem" in verify.stderr
    command = [
        analyze,
        "security",
        "--offline=true",
        "--no-pager",
        f"--threshold={EXPOSURE_LIMIT * 10:.0f}",
        str(weak),
    ]
    assert subprocess.run(command, capture_output=True, timeout=60, check=False).returncode != 0
