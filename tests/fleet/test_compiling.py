"""Kernels are compiled once, before and apart from the processes that read logs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fleet.conftest import ROOT

#: so that a small fleet is worth compiled kernels
RUN = (
    "import sys; from canest.fleet import run; run.COMPILED_FROM_S = 0.0; "
    "from canest.cli.main import main; sys.exit(main())"
)

COMPILING = "compiling the kernels: once after an installation, about a minute"


def compiled_run(logs: Path, lake: Path, manifest: Path, cache: Path) -> subprocess.CompletedProcess[str]:
    arguments = ["fleet", "run", logs, "-o", lake, "--manifest", manifest, "--workers", "2"]
    return subprocess.run(
        [sys.executable, "-c", RUN, *map(str, arguments)], capture_output=True, text=True, timeout=400,
        check=False, cwd=ROOT, env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
    )  # fmt: skip


@pytest.mark.slow
def test_with_an_empty_cache_no_process_that_reads_logs_compiles(logs, manifest, tmp_path):
    pytest.importorskip("numba")
    cache = tmp_path / "cache"
    first = compiled_run(logs, tmp_path / "first", manifest, cache)
    assert first.returncode == 0, first.stderr
    assert first.stderr.splitlines()[0] == COMPILING
    (record,) = cache.glob("kernels-*.json")
    kept = [Path(file) for file in json.loads(record.read_text())]
    assert kept
    # the record is written when all is compiled: what is younger was compiled by a process that reads logs
    end_ns = record.stat().st_mtime_ns
    files = [*cache.rglob("*.nbi"), *cache.rglob("*.nbc")]
    assert [file.name for file in files if file.stat().st_mtime_ns > end_ns] == []
    second = compiled_run(logs, tmp_path / "second", manifest, cache)
    assert second.returncode == 0
    assert COMPILING not in second.stderr
    kept[0].unlink()  # a cache that was cleaned is filled again
    third = compiled_run(logs, tmp_path / "third", manifest, cache)
    assert third.stderr.splitlines()[0] == COMPILING


@pytest.mark.slow
def test_where_the_cache_cannot_be_written_the_run_goes_on(logs, manifest, tmp_path):
    cache = tmp_path / "cache"
    cache.write_text("no folder")
    done = compiled_run(logs, tmp_path / "lake", manifest, cache)
    assert done.returncode == 0
    assert COMPILING not in done.stderr
    assert "Traceback" not in done.stderr
