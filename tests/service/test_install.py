"""`canest install-service`: what it writes can be read by the service, and systemd reads it as meant."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from canest.bus.sandbox import drop_in
from canest.cli.main import run
from canest.config import load_config
from canest.core.errors import CanestError
from canest.live.install import install, unit_text
from canest.system.shipped_files import shipped

ROOT = Path(__file__).parents[2]
VCAN = ROOT / "configs" / "vcan.yaml"


@pytest.fixture
def private_umask() -> Iterator[None]:
    before = os.umask(0o077)
    yield
    os.umask(before)


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """A root to install below, open to all as / is."""
    root = tmp_path / "image"
    root.mkdir(mode=0o755)
    return root


def modes(root: Path) -> dict[str, int]:
    return {p.relative_to(root).as_posix(): p.stat().st_mode & 0o777 for p in root.rglob("*")}


@pytest.mark.usefixtures("private_umask")
def test_a_private_umask_does_not_keep_the_service_from_its_config(tmp_path: Path, image: Path) -> None:
    (tmp_path / "dbc").mkdir()
    shutil.copy(shipped("dbc") / "j1939.dbc", tmp_path / "dbc" / "mine.dbc")
    config = tmp_path / "truck.yaml"
    config.write_text((shipped("configs") / "class8.yaml").read_text().replace("j1939.dbc", "dbc/mine.dbc"))
    subprocess.run(
        [sys.executable, "-m", "canest", "install-service", "--install", "-c", config, "--root", image],
        check=True, capture_output=True, timeout=60, cwd=ROOT,
    )  # fmt: skip
    found = modes(image)
    files = {
        "etc/canest/dbc/mine.dbc", "etc/canest/truck.yaml", "etc/systemd/system/canest@.service",
    }  # fmt: skip
    assert files < set(found)
    assert all(mode == (0o644 if path in files else 0o755) for path, mode in found.items())


def test_what_an_earlier_installation_left_unreadable_is_named(image: Path) -> None:
    install(VCAN, "truck", image)
    (image / "etc/canest").chmod(0o700)
    (image / "etc/canest/truck.yaml").chmod(0o600)
    notes = install(VCAN, "truck", image).notes
    for change in (f"chmod a+rx {image}/etc/canest", f"chmod a+r {image}/etc/canest/truck.yaml"):
        assert any(note.endswith(change) for note in notes)


@pytest.mark.parametrize(
    "name", ["a;b", "..", "a..b", "%i", "a%b", "lkw-süd", "my truck", "-x", ".x", "a/b", "a\\b", "a:b", "a@b",
             "a\n", "", "x" * 51],
)  # fmt: skip
def test_a_name_that_systemd_or_a_path_would_read_otherwise_is_refused(
    image: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    argv = ["install-service", "--install", "-c", str(VCAN), f"--name={name}", "--root", str(image)]
    assert run(argv) == 2
    error = capsys.readouterr().err
    assert "--name: is no name for an instance" in error and "e.g. --name " in error
    assert not list(image.iterdir())


def test_a_config_whose_file_name_is_no_instance_asks_for_a_name(
    tmp_path: Path, image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "my truck.yaml"
    shutil.copy(VCAN, config)
    argv = ["install-service", "--install", "-c", str(config), "--root", str(image)]
    assert run(argv) == 2
    assert "--name my-truck" in capsys.readouterr().err
    assert run([*argv, "--name", "my-truck"]) == 0
    assert (image / "etc/canest/my-truck.yaml").exists()


@pytest.mark.parametrize("name", ["truck", "bus_1", "can0.left", "T-800", "1"])
def test_names_that_are_taken_stand_for_themselves_in_systemd(image: Path, name: str) -> None:
    install(VCAN, name, image)
    assert (image / f"etc/canest/{name}.yaml").exists()
    escape = shutil.which("systemd-escape")
    if escape is not None and "-" not in name:  # which systemd-escape reads as a slash of a path
        escaped = subprocess.run([escape, name], capture_output=True, text=True, check=True).stdout
        assert escaped.strip() == name


@pytest.fixture
def systemd() -> Callable[[str], str]:
    """What systemd itself makes of a unit: it loads it without running anything, which it refuses to root."""
    program = Path("/lib/systemd/systemd")
    drop = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"] if os.geteuid() == 0 else []
    if not program.exists() or (drop and shutil.which("setpriv") is None):
        reason = "needs systemd and setpriv: apt-get install systemd util-linux"
        if "CI" in os.environ:
            pytest.fail(reason)
        pytest.skip(reason)

    def load(text: str) -> str:
        with tempfile.TemporaryDirectory(dir="/tmp") as folder:
            Path(folder).chmod(0o755)
            (Path(folder) / "canest@.service").write_text(text)
            done = subprocess.run(
                [*drop, str(program), "--test", "--system", "--unit=canest@truck.service"],
                env=os.environ | {"SYSTEMD_UNIT_PATH": f"{folder}:"},  # and where the others lie
                capture_output=True, text=True, timeout=60, check=False,
            )  # fmt: skip
        _, _, unit = done.stdout.partition("-> Unit canest@truck.service:\n")
        return unit.partition("-> Unit ")[0]

    return load


@pytest.mark.parametrize("folder", ["my canest", "50%h a\"b'c\\d $HOME;süd"])
def test_a_canest_in_any_folder_is_in_the_path_of_the_service(
    systemd: Callable[[str], str], folder: str
) -> None:
    loaded = systemd(unit_text(Path("/opt") / folder / "bin" / "canest"))
    assert f"Environment: PATH=/opt/{folder}/bin:/opt/canest/bin:" in loaded.replace("\\\\", "\\")
    assert "Command Line: /usr/bin/env canest run -c /etc/canest/truck.yaml\n" in loaded


@pytest.mark.parametrize("folder", ["a:b", "a\nb"])
def test_a_folder_that_no_path_can_name_is_refused(folder: str) -> None:
    with pytest.raises(CanestError, match="cannot stand in the PATH of a service"):
        unit_text(Path("/opt") / folder / "canest")


UDP = ["bus.interface=udp_multicast"]


@pytest.mark.parametrize(
    ("changes", "allowed"),
    [
        ([], None),
        (["bus.interface=slcan"], None),
        ([*UDP, "bus.channel=239.74.163.2"], ["RestrictAddressFamilies=AF_INET", "IPAddressAllow=any"]),
        ([*UDP, "bus.channel='ff15::1'"], ["RestrictAddressFamilies=AF_INET6", "IPAddressAllow=any"]),
        (["service.metrics_port=9464"], ["RestrictAddressFamilies=AF_INET", "IPAddressAllow=localhost"]),
        (
            [*UDP, "bus.channel='ff15::1'", "service.metrics_port=9464"],
            ["RestrictAddressFamilies=AF_INET6 AF_INET", "IPAddressAllow=any"],
        ),
    ],
)
def test_the_unit_is_opened_only_as_far_as_the_config_needs(
    changes: list[str], allowed: list[str] | None
) -> None:
    text = drop_in(load_config("vcan", changes))
    assert (None if text is None else text.splitlines()[-2:]) == allowed


def test_the_drop_in_of_an_instance_is_written_and_a_changed_one_kept(tmp_path: Path, image: Path) -> None:
    config = tmp_path / "lan.yaml"
    text = VCAN.read_text().replace("bus: {interface: socketcan, channel: vcan0}", "")
    assert "bus:" not in text
    config.write_text(text + "\nbus: {interface: udp_multicast, channel: 239.74.163.2}\n")
    path = image / "etc/systemd/system/canest@lan.service.d/network.conf"
    assert path in install(config, None, image).written
    assert "AF_INET" in path.read_text() and path.stat().st_mode & 0o777 == 0o644
    assert path not in install(config, None, image).written  # unchanged
    path.write_text("[Service]\nNice=0\n")
    notes = install(config, None, image).notes
    assert path.read_text() == "[Service]\nNice=0\n"
    assert any(str(path) in note and "RestrictAddressFamilies=AF_INET" in note for note in notes)
