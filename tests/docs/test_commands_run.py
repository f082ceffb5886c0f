"""Every command that a page shows and that ends by itself is run, in a folder like a reader's."""

from __future__ import annotations

import ast
import gzip
import lzma
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from canest.telemetry.live_protocol import COLUMNS, stream_path
from tests.docs.test_pages import LINES
from tests.serve.rig import Stream, wait_for

ROOT = Path(__file__).resolve().parents[2]
#: what cannot be run here -> why; each of them has tests of its own
NOT_RUN = {
    r"^(run|serve|publish)\b": "goes on until Ctrl-C",
    r"^monitor\b|--live\b": "needs a bus",
    r"--to\b": "plays for minutes",
    r"\bsudo\b": "needs root",
}
#: seconds of a simulated drive that are enough for a load
LONG_S = 60


def runnable(line: str) -> bool:
    return not any(re.search(pattern, line) for pattern in NOT_RUN)


PAGES = sorted({page for page, line in LINES if runnable(line)})


@pytest.fixture(scope="module")
def command(tmp_path_factory) -> Path:
    """Return a folder that has `canest` as a command."""
    folder = tmp_path_factory.mktemp("bin")
    (folder / "canest").write_text(
        f'#!/bin/sh\nPYTHONPATH={shlex.quote(str(ROOT))} exec {sys.executable} -m canest "$@"\n'
    )
    (folder / "canest").chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def drives(command, tmp_path_factory) -> Path:
    """Return a folder with what the pages suppose: a truck's config, its logs with their truth, a fleet."""
    folder = tmp_path_factory.mktemp("drives")
    scenario = folder / "drive.yaml"
    shipped = (ROOT / "canest/simulation/scenarios/mixed-36t.yaml").read_text()
    scenario.write_text(shipped.replace("duration_s: 400", f"duration_s: {LONG_S}") + "positions: {}\n")
    subprocess.run([command / "canest", "simulate", scenario, "-o", folder / "made"], check=True)
    made = {path.suffix: path for path in (folder / "made").iterdir()}
    log, truth = made[".log"].read_bytes(), made[".csv"].read_bytes()
    (folder / "my-truck.yaml").write_bytes(made[".yaml"].read_bytes())
    for name in ("drive", "another", "week/a", "logs/a", "logs/b"):
        path = folder / f"{name}.log"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(log)
        path.with_suffix(".truth.csv").write_bytes(truth)
    (folder / "week/c.log.xz").write_bytes(lzma.compress(log, preset=0))
    (folder / "week/c.truth.csv").write_bytes(truth)
    (folder / "fleet").mkdir()
    (folder / "fleet/a.log.gz").write_bytes(gzip.compress(log, 1))
    (folder / "fleet.csv").write_text(
        "pattern,vehicle,config\na.log,1FUJGLDR0CSBM1234,my-truck.yaml\nb.log,truck-7,my-truck.yaml\n"
    )
    shutil.rmtree(folder / "made")
    return folder


def test_most_commands_are_run():
    assert len(PAGES) >= 6 and len([line for _, line in LINES if runnable(line)]) >= 25


def python_of(page: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / page).read_text(), re.M | re.S)


def test_the_program_on_the_page_of_the_live_page_reads_the_stream(tmp_path):
    (code,) = python_of("live-page.md")
    stream = Stream(tmp_path)
    try:
        code = code.replace("/run/canest/truck/live-can0.sock", str(stream_path(stream.status_socket)))
        assert str(tmp_path) in code
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as reader:
            assert wait_for(lambda: stream.sent > 5)
            stream.close()
            rows = [ast.literal_eval(line) for line in reader.stdout]
    finally:
        stream.close()
    assert len(rows) >= 3 and all(len(row) == len(COLUMNS) and row[1] >= 20_000 for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_run(page, command, drives, tmp_path):
    folder = tmp_path / "reader"
    shutil.copytree(drives, folder)
    lines = [f"canest {line}" for name, line in LINES if name == page and runnable(line)]
    if page == "fleet.md":  # the other pages' Python has tests of its own
        lines += [f"{sys.executable} - << 'END'\n{code}END" for code in python_of(page)]
    done = subprocess.run(
        ["bash", "-euxc", "\n".join(lines)], cwd=folder, capture_output=True, text=True, timeout=500,
        check=False, env=os.environ | {"PATH": f"{command}:{os.environ['PATH']}", "HOME": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:] + done.stdout[-1000:]
