"""The Debian package on a fresh Debian: apt installs it, its service estimates on vcan0, apt purges it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import rig
from guest import Guest, missing_tools

from canest.node.estimate_frame import decode

ROOT = Path(__file__).resolve().parents[2]
READY = shutil.which("mmdebstrap") is not None and os.geteuid() == 0 and not missing_tools("systemd")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not READY and "CI" not in os.environ, reason="needs root, mmdebstrap and a guest machine"
    ),
]
#: beside what the package itself asks for: what boots, and what plays and receives frames
MORE = "ca-certificates,systemd,iproute2,busybox-static,can-utils"

#: an emulated Python takes long to start
IN_THE_GUEST = """
set -eux
export DEBIAN_FRONTEND=noninteractive
test -z "$(systemctl list-units --all --plain --no-legend 'canest@*')"
mkdir -p /etc/systemd/system/canest@.service.d
slow=/etc/systemd/system/canest@.service.d/slow.conf
printf '[Service]\\nTimeoutStartSec=300\\nTimeoutStopSec=30\\n' > $slow
systemctl daemon-reload
systemctl enable --now canest@vcan
systemctl show canest@vcan --property=ActiveState,Type,User,DynamicUser > "$GUEST_OUT/unit"
candump -L vcan0,18FF5A00:1FFFFF00 -n 400 > "$GUEST_OUT/broadcast" &
receiver=$!
canplayer -l i -I /root/drive.log vcan0=can0 &
timeout 200 tail --pid=$receiver -f /dev/null
canest status > "$GUEST_OUT/condition"
ls -ld /run/canest/vcan /var/lib/private/canest/vcan > "$GUEST_OUT/places"
apt-get purge -y canest
test ! -e /usr/lib/canest
test ! -e /etc/canest
test "$(systemctl is-active canest@vcan)" != active
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("deb")
    command = [sys.executable, ROOT / "tools" / "make_deb.py", "-o", folder]
    subprocess.run(command, check=True, timeout=900, stdout=subprocess.DEVNULL)
    return next(folder.glob("*.deb"))


@pytest.fixture(scope="module")
def debian(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A fresh Debian of this release, on which apt has installed the package."""
    tree = tmp_path_factory.mktemp("debian") / "root"
    release = re.search(r"VERSION_CODENAME=(\w+)", Path("/etc/os-release").read_text())
    assert release
    name = f"/root/{package.name}"
    hooks = [
        f"copy-in {package} /root",
        f'chroot "$1" apt-get install -y --no-install-recommends {name}',
        'chroot "$1" canest -V',
        'test -s "$1/usr/share/man/man1/canest-publish.1.gz"',
        'test -s "$1/usr/share/bash-completion/completions/canest"',
    ]
    command = ["mmdebstrap", "--variant=apt", f"--include={MORE}", *(f"--customize-hook={h}" for h in hooks)]
    done = subprocess.run(
        [*command, release[1], tree], capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "canest, version " in done.stdout + done.stderr
    rig.cycle_log(tree / "root").rename(tree / "root" / "drive.log")
    yield tree
    shutil.rmtree(tree)


def test_installed_by_apt_on_a_fresh_debian_the_service_estimates_on_vcan(debian: Path) -> None:
    with Guest(["bash", "-c", IN_THE_GUEST], init="systemd", cwd=Path("/root"), root=debian) as guest:
        result = guest.wait(900)
        found = {path.name: path.read_text() for path in guest.out.iterdir()}
    assert result.status == 0, result.output[-4000:]
    assert {"ActiveState=active", "Type=notify", "DynamicUser=yes"} <= set(found["unit"].split())
    frames = [line.split()[2].split("#") for line in found["broadcast"].splitlines()]
    assert len(frames) == 400
    received = [decode(bytes.fromhex(data), int(can_id, 16)) for can_id, data in frames]
    assert all(each.intact for each in received)
    valid = [each.estimate for each in received if each.estimate.status == 2]
    assert valid and valid[-1].mass_kg == pytest.approx(rig.TRUE_MASS_KG, rel=0.05)
    assert "valid" in found["condition"] and "socketcan:vcan0 up" in found["condition"]
