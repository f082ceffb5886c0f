"""A full disk, or files that may grow no further: nothing half written stands under its final name."""

from __future__ import annotations

import lzma
import resource
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.cli.conftest import KENWORTH

SCENARIO = """
duration_s: 4
vehicle: electric-car
mass_kg: 1500
driver: {kind: cruise, speed_mps: 10}
"""


@contextmanager
def files_of_at_most(size):
    """As on a disk with room for so many bytes: the next write of a file fails (Python ignores SIGXFSZ)."""
    assert signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def out(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    return out


@pytest.mark.parametrize(
    ("option", "name", "room"),
    [
        ("-o", "est.csv", 10_000),
        ("-o", "est.parquet", 10_000),
        ("--json", "summary.json", 100),
        ("--report", "report.html", 100_000),
    ],
)
@pytest.mark.parametrize("older", [b"", b"of yesterday"])
def test_a_result_that_finds_no_room_leaves_what_was_there(canest, out, option, name, room, older):
    if older:
        (out / name).write_bytes(older)
    with files_of_at_most(room):
        done = canest("replay", KENWORTH, "-c", "kenworth", option, out / name)
    assert done.code == 1
    assert done.err == f"error: {out / name}: cannot write: File too large\n"
    assert {p.name: p.read_bytes() for p in out.iterdir()} == ({name: older} if older else {})


def test_nor_does_a_comparison(canest, tmp_path, out):
    log = tmp_path / "short.log"
    log.write_bytes(b"".join(lzma.decompress(KENWORTH.read_bytes()).splitlines(keepends=True)[:20_000]))
    with files_of_at_most(100):
        done = canest(
            "compare", log, "-c", "kenworth", "--mass", 7700, "--only", "rls", "--json", out / "table.json"
        )
    assert done.code == 1
    assert "table.json: cannot write: File too large" in done.err
    assert not list(out.iterdir())


@pytest.mark.parametrize("room", [1_000, 20_000])  # too little for any of the three; for the log only
@pytest.mark.parametrize("compress", [[], ["--compress"]])
def test_of_a_simulated_drive_there_are_all_three_files_or_none(canest, tmp_path, out, room, compress):
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(SCENARIO)
    with files_of_at_most(room):
        done = canest("simulate", scenario, "-o", out, *compress)
    assert done.code == 1
    assert "cannot write: File too large" in done.err
    assert not list(out.iterdir())


@pytest.mark.parametrize("room", [100, 100_000])
def test_nor_half_of_a_diagnosis(canest, tmp_path, out, room):
    log = tmp_path / "short.log"
    log.write_bytes(b"".join(lzma.decompress(KENWORTH.read_bytes()).splitlines(keepends=True)[:20_000]))
    with files_of_at_most(room):
        done = canest("diagnose", log, "-c", "kenworth", "-o", out)
    assert done.code == 1
    assert "cannot write: File too large" in done.err
    assert not list(out.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("option", ["-o", "--json", "--report"])
def test_a_full_device_is_one_line(canest, option):
    done = canest("replay", KENWORTH, "-c", "kenworth", option, "/dev/full")
    assert done.code == 1
    assert done.err == "error: /dev/full: cannot write: No space left on device\n"
