"""The wheel and the source archive: whole, with their notices, and installed they work."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.slow


def run(*command: object, cwd: Path = ROOT) -> str:
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "-o", folder, ROOT)
    return folder


@pytest.fixture(scope="module")
def wheel(built) -> Path:
    return next(built.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """Return a fresh environment with the wheel; its dependencies are those of the tests."""
    folder = tmp_path_factory.mktemp("fresh") / "venv"
    run(sys.executable, "-m", "venv", folder)
    run(folder / "bin/python", "-m", "pip", "install", "-q", "--no-deps", "--no-index", wheel)
    site = next(folder.glob("lib/python3*/site-packages"))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return folder


def test_wheel_and_archive_pass_the_checks_of_the_index(built, wheel):
    archives = sorted(built.iterdir())
    assert len(archives) == 2
    run(sys.executable, "-m", "twine", "check", "--strict", *archives)
    run(sys.executable, "-m", "check_wheel_contents", wheel)


def test_notices_of_what_is_bundled_are_in_both(built, wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    licences = {name.split("/licenses/")[1] for name in names if "/licenses/" in name}
    assert licences == {"LICENSE", "NOTICES.md", "canest/serve/page/uPlot.LICENSE.txt"}
    assert not [name for name in names if name.startswith("tests/")]
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        packed = {name.split("/", 1)[-1] for name in archive.getnames()}
    for folder in (p for p in (ROOT / "tests/data").iterdir() if p.is_dir() and p.name != "vcan"):
        assert f"tests/data/{folder.name}/LICENSE" in packed, folder
    assert {"NOTICES.md", "tests/data/README.md"} <= packed


def test_every_bundled_library_and_data_set_has_its_row():
    notices = (ROOT / "NOTICES.md").read_text(encoding="utf-8")
    minified = [*(ROOT / "canest").rglob("*.min.*"), *(ROOT / "tests").rglob("*.min.*")]
    folders = [p.parent for p in (ROOT / "tests/data").glob("*/LICENSE")]
    assert minified and folders
    for path in (*minified, *folders):
        assert f"{path.name}`" in notices, path


def test_the_wheel_simulates_and_replays_in_a_fresh_environment(installed, tmp_path):
    canest = installed / "bin" / "canest"
    code = "import canest; print(canest.__file__)"
    assert str(installed) in run(installed / "bin/python", "-c", code, cwd=tmp_path)
    assert run(canest, "-V", cwd=tmp_path).startswith("canest, version ")
    run(canest, "simulate", "launches-car", "-o", tmp_path, cwd=tmp_path)
    log, config = tmp_path / "launches-car.log", tmp_path / "launches-car.yaml"
    assert "mass" in run(
        canest, "replay", log, "-c", config, "--truth", "auto", "-o", "est.csv", cwd=tmp_path
    )
    assert (tmp_path / "est.csv").stat().st_size > 10_000
    assert (installed / "share/man/man1/canest-replay.1").is_file()
    assert (installed / "share/bash-completion/completions/canest").is_file()
