"""Builds a Debian package: ``python tools/make_deb.py [-o dist]``. It needs no root.

The package brings canest and the Python packages it needs as an environment in /usr/lib/canest, with Debian's
own Python. Such an environment belongs to one minor version of Python, so the package fits the release of
Debian that it is built on. It needs the Debian packages python3-venv and dpkg, and the network for pip.
"""

from __future__ import annotations

import argparse
import compileall
import gzip
import hashlib
import os
import py_compile
import shutil
import subprocess
import sys
import tempfile
import time
from email import message_from_string
from email.message import Message
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = ROOT / "tools" / "debian"
PYTHON = "/usr/bin/python3"
HOME = "usr/lib/canest"
#: small, and what a vehicle may need; the others with pip in an environment of one's own
EXTRAS = "metrics,multicast,serial"
MAINTAINER = "the canest authors <canest@users.noreply.github.com>"
#: what manylinux wheels expect of the system
LIBRARIES = "libc6 (>= 2.34), libgcc-s1, libstdc++6, zlib1g"

LAUNCHER = """#!/bin/sh
exec /usr/lib/canest/bin/python3 -m canest "$@"
"""

CONTROL = """Package: canest
Version: {version}
Architecture: {architecture}
Maintainer: {maintainer}
Section: utils
Priority: optional
Installed-Size: {size_kB}
Depends: python3 (>= {python}), python3 (<< {next_python}), {libraries}
Suggests: can-utils, iproute2
Description: vehicle mass and road grade from the CAN bus
 canest reads a vehicle's CAN bus and estimates its mass and the road grade 50
 times a second, each with a standard deviation. It runs as a service, replays
 recorded logs, and sends nothing on a physical bus unless it is configured to.
"""

ETC_README = """The service canest@NAME runs on /etc/canest/NAME.yaml. None runs until you enable it:

    canest config show class8 > /etc/canest/my-truck.yaml     a beginning; then edit it
    canest check -c /etc/canest/my-truck.yaml --live          does it fit the vehicle? (sends nothing)
    systemctl enable --now canest@my-truck

vcan.yaml is for a virtual bus: modprobe vcan; ip link add vcan0 type vcan; ip link set vcan0 up
On a physical bus nothing is sent without broadcast.enabled: true. See canest(1) and canest-run(1).
"""


def run(*command: object) -> str:
    """Run a program and return its output; its errors end this one."""
    words = [str(word) for word in command]
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


def install_environment(stage: Path, work: Path) -> Path:
    """Make the environment below ``stage`` and return its site-packages."""
    home = stage / HOME
    run(PYTHON, "-m", "venv", work / "tool")
    run(PYTHON, "-m", "venv", "--without-pip", home)
    pip = (work / "tool/bin/python3", "-m", "pip", "-qq", "--disable-pip-version-check")
    run(*pip, "wheel", "--no-deps", "-w", work / "wheel", ROOT)
    wheel = next((work / "wheel").glob("*.whl"))
    run(*pip, "--python", home / "bin/python3", "install", "--no-compile", f"{wheel}[{EXTRAS}]")
    for path in (home / "bin").iterdir():
        if not path.name.startswith("python"):
            path.unlink()  # activate scripts and the commands of other packages
    shutil.rmtree(home / "include", ignore_errors=True)
    settings = home / "pyvenv.cfg"
    kept = [line for line in settings.read_text().splitlines() if not line.startswith("command")]
    settings.write_text("\n".join(kept) + "\n")
    site = next(home.glob("lib/python3*/site-packages"))
    for folder in [*site.rglob("tests"), *site.rglob("__pycache__")]:
        shutil.rmtree(folder, ignore_errors=True)
    for leftover in [*site.glob("*.dist-info/direct_url.json"), *site.glob("*.dist-info/REQUESTED")]:
        leftover.unlink()  # they name the folder of this build
    for library in site.rglob("*.so*"):
        library.chmod(0o644)
    compileall.compile_dir(
        site, quiet=2, ddir=f"/{site.relative_to(stage)}",
        invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH, workers=1,
    )  # fmt: skip
    return site


def place_files(stage: Path, site: Path, version: str) -> None:
    """Put the command, the unit, configs, man pages, completion and papers where Debian has them."""
    share = stage / "usr/share"
    write(stage / "usr/bin/canest", LAUNCHER, 0o755)
    (stage / HOME / "bin/python3").unlink()
    (stage / HOME / "bin/python3").symlink_to("../../../bin/python3")  # as Debian wants links within /usr
    write(stage / "etc/canest/README", ETC_README)
    shipped = site / "canest/_shipped"
    write(stage / "etc/canest/vcan.yaml", (shipped / "configs/vcan.yaml").read_text(encoding="utf-8"))
    unit = (shipped / "systemd/canest@.service").read_text(encoding="utf-8")
    unit = unit.replace("man:systemd.service(5)", "man:canest-run(1) man:canest(1)")
    write(stage / "usr/lib/systemd/system/canest@.service", unit)
    examples = share / "doc/canest/examples"
    shutil.copytree(shipped / "configs", examples / "configs")
    for network in (shipped / "systemd").glob("can0.*"):
        write(examples / "systemd" / network.name, network.read_text(encoding="utf-8"))
    built = stage / HOME / "share"
    for page in sorted((built / "man/man1").iterdir()):
        compressed(share / "man/man1" / f"{page.name}.gz", page.read_bytes())
    for source, target in (
        ("bash-completion/completions/canest", "bash-completion/completions/canest"),
        ("zsh/site-functions/_canest", "zsh/vendor-completions/_canest"),
        ("fish/vendor_completions.d/canest.fish", "fish/vendor_completions.d/canest.fish"),
    ):
        write(share / target, (built / source).read_text(encoding="utf-8"))
    shutil.rmtree(built)
    write(share / "doc/canest/copyright", copyright_text(site))
    write(share / "doc/canest/NOTICES.md", (ROOT / "NOTICES.md").read_text(encoding="utf-8"))
    compressed(share / "doc/canest/changelog.gz", changelog(version).encode())
    compressed(share / "doc/canest/CHANGES.md.gz", (ROOT / "CHANGELOG.md").read_bytes())
    write(share / "lintian/overrides/canest", (SCRIPTS / "lintian-overrides").read_text(encoding="utf-8"))


def write(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file and the folders it needs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)


def compressed(path: Path, data: bytes) -> None:
    """Write a file as gzip, equal for equal content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(data, 9, mtime=0))


def changelog(version: str) -> str:
    """Return the changelog in Debian's form; the changes themselves are in CHANGES.md.gz."""
    date = time.strftime("%a, %d %b %Y %H:%M:%S +0000", time.gmtime(built_at()))
    return (
        f"canest ({version}) unstable; urgency=medium\n\n  * See CHANGES.md.gz.\n\n -- {MAINTAINER}  {date}\n"
    )


def built_at() -> int:
    """Return the time of the files: SOURCE_DATE_EPOCH, else that of the last commit, else now."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        return int(given or run("git", "-C", ROOT, "log", "-1", "--format=%ct"))
    except (subprocess.CalledProcessError, ValueError):
        return int(time.time())


def copyright_text(site: Path) -> str:
    """Return canest's licence and those that the bundled packages state, each with where its text is."""
    licence = "\n".join(f" {line}" if line else " ." for line in (ROOT / "LICENSE").read_text().splitlines())
    head = "Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/\n"
    own = f"Files: *\nCopyright: the canest authors\nLicense: Expat\n{licence}\n"
    bundled = ["Comment: Bundled Python packages; their licence texts are in their .dist-info folders below"]
    bundled.append(f" /{site.relative_to(site.parents[4])}:")
    for info in sorted(site.glob("*.dist-info")):
        facts = message_from_string((info / "METADATA").read_text(encoding="utf-8"))
        bundled.append(f"  {facts['Name']} {facts['Version']}: {stated_licence(facts)}")
    return f"{head}\n{own}" + "\n".join(bundled) + "\n"


def stated_licence(facts: Message) -> str:
    """Return the licence that a package's metadata states, in one line."""
    classes = [c.split(" :: ")[-1] for c in facts.get_all("Classifier", []) if c.startswith("License")]
    first = (facts["License"] or "").strip().split("\n")[0]
    return str(facts["License-Expression"] or ", ".join(classes) or first or "see its folder")


def pack(stage: Path, output: Path, version: str) -> Path:
    """Write the control files and the package; return its path."""
    control = stage / "DEBIAN"
    for script in ("postinst", "prerm", "postrm"):
        write(control / script, (SCRIPTS / script).read_text(encoding="utf-8"), 0o755)
    write(control / "conffiles", "/etc/canest/README\n/etc/canest/vcan.yaml\n")
    packed = sorted(
        p for p in stage.rglob("*") if p.is_file() and not p.is_symlink() and control not in p.parents
    )
    sums = [f"{hashlib.md5(p.read_bytes()).hexdigest()}  {p.relative_to(stage)}\n" for p in packed]
    write(control / "md5sums", "".join(sums))
    major, minor = run(PYTHON, "-c", "import sys; print(*sys.version_info[:2])").split()
    architecture = run("dpkg", "--print-architecture")
    text = CONTROL.format(
        version=version, architecture=architecture, maintainer=MAINTAINER, libraries=LIBRARIES,
        python=f"{major}.{minor}", next_python=f"{major}.{int(minor) + 1}",
        size_kB=sum(p.stat().st_size for p in packed) // 1024,
    )  # fmt: skip
    write(control / "control", text)
    output.mkdir(parents=True, exist_ok=True)
    package = output / f"canest_{version}_{architecture}.deb"
    os.environ["SOURCE_DATE_EPOCH"] = str(built_at())
    run("dpkg-deb", "--root-owner-group", "-Zxz", "-z3", "--build", stage, package)
    return package


def main(arguments: list[str] | None = None) -> int:
    """Build the package and print its path."""
    parser = argparse.ArgumentParser(description="Build a Debian package of canest.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist", help="folder of the package")
    output: Path = parser.parse_args(arguments).output
    os.umask(0o022)
    with tempfile.TemporaryDirectory() as folder:
        work, stage = Path(folder), Path(folder) / "stage"
        stage.mkdir()
        site = install_environment(stage, work)
        version = run(stage / HOME / "bin/python3", "-c", "import canest; print(canest.__version__)")
        place_files(stage, site, version)
        print(pack(stage, output, version))
    return 0


if __name__ == "__main__":
    sys.exit(main())
