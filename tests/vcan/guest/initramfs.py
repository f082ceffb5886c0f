"""The guest's kernel, and the initramfs that carries the modules and the first program to run.

The kernel is Debian's ``linux-image-amd64``, fetched once with apt and kept in the user's cache: only the
boot image and the few modules below are unpacked from it.
"""

from __future__ import annotations

import lzma
import os
import re
import shutil
import stat
import subprocess
import tarfile
import tempfile
from pathlib import Path, PurePosixPath

#: Modules the guest loads: its disk (9p over virtio), its overlay, and everything of SocketCAN.
MODULES = (
    "virtio_pci", "9pnet_virtio", "9p", "overlay",
    "can-raw", "can-bcm", "can-j1939", "can-gw", "vcan", "vxcan",
)  # fmt: skip

META_PACKAGE = "linux-image-amd64"
_MODULE_NAME = re.compile(r"/lib/modules/[^/]+/kernel/.*/([^/]+)\.ko(\.xz)?$")


class KernelError(RuntimeError):
    """The kernel package could not be fetched or lacks a module."""


def cache_dir() -> Path:
    """Where the kernel stays between runs (``CANEST_GUEST_CACHE``, else the user's cache)."""
    chosen = os.environ.get("CANEST_GUEST_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(chosen) if chosen else Path(base) / "canest" / "guest"


def kernel(cache: Path | None = None) -> Path:
    """Folder with ``vmlinuz`` and ``modules/NN-name.ko`` in loading order; fetched on first use."""
    cache = cache or cache_dir()
    complete = sorted(cache.glob("linux-image-*/vmlinuz"))
    if complete:
        return complete[-1].parent
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache, prefix="fetch-") as scratch:
        package = _download(Path(scratch))
        unpacked = Path(scratch) / "unpacked"
        _unpack(package, unpacked)
        home = cache / package.name.partition("_")[0]
        try:
            unpacked.rename(home)
        except OSError:  # another process finished the same download first: its result is as good
            if not (home / "vmlinuz").exists():
                raise
    return home


def _download(folder: Path) -> Path:
    depends = _output(["apt-cache", "depends", META_PACKAGE])
    match = re.search(r"Depends: (linux-image-\S+)", depends)
    if not match:
        raise KernelError(f"apt knows no {META_PACKAGE}: run apt-get update on a Debian machine")
    _output(["apt-get", "download", "-q", match[1]], cwd=folder)
    return next(folder.glob("*.deb"))


def _output(command: list[str], cwd: Path | None = None) -> str:
    try:
        done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KernelError(f"{command[0]}: {error}") from error
    if done.returncode:
        raise KernelError(f"{' '.join(command)}: {done.stderr.strip()[-300:]}")
    return done.stdout


def _unpack(package: Path, folder: Path) -> None:
    """Keep the boot image and, of some 4,000 modules, those we load with all they depend on."""
    found: dict[str, bytes] = {}
    folder.mkdir()
    with (
        subprocess.Popen(["dpkg-deb", "--fsys-tarfile", str(package)], stdout=subprocess.PIPE) as dpkg,
        tarfile.open(fileobj=dpkg.stdout, mode="r|") as tar,
    ):
        for member in tar:
            module = _MODULE_NAME.search(member.name)
            content = tar.extractfile(member) if member.isreg() else None
            if content is None:
                continue
            if module:
                data = content.read()
                found[_canonical(module[1])] = lzma.decompress(data) if module[2] else data
            elif PurePosixPath(member.name).name.startswith("vmlinuz"):
                with (folder / "vmlinuz").open("wb") as image:
                    shutil.copyfileobj(content, image)
    (folder / "modules").mkdir()
    for number, name in enumerate(_loading_order(found)):
        (folder / "modules" / f"{number:02d}-{name}.ko").write_bytes(found[name])


def _canonical(module: str) -> str:
    return module.replace("-", "_")


def _loading_order(modules: dict[str, bytes]) -> list[str]:
    """Dependencies first; each module names its own in its ``.modinfo`` section."""
    order: list[str] = []

    def visit(name: str) -> None:
        if name in order or name not in modules:  # absent: built into the kernel
            return
        depends = re.search(rb"\0depends=([^\0]*)\0", modules[name])
        for needed in depends[1].decode().split(",") if depends else []:
            visit(_canonical(needed))
        order.append(name)

    for wanted in map(_canonical, MODULES):
        visit(wanted)
    if "vcan" not in order:
        raise KernelError(f"the kernel package has no vcan module, found {len(modules)} others")
    return order


def build(kernel_home: Path, busybox: Path, files: dict[str, str]) -> bytes:
    """An initramfs (cpio "newc"): busybox, the modules, and ``files`` (path: text), all executable."""
    entries: list[tuple[str, int, bytes]] = [
        (name, stat.S_IFDIR | 0o755, b"")
        for name in ("bin", "modules", "guest", "proc", "sys", "dev", "lower", "upper", "root")
    ]
    contents = {"bin/busybox": busybox.read_bytes()}
    contents |= {
        f"modules/{module.name}": module.read_bytes() for module in (kernel_home / "modules").iterdir()
    }
    contents |= {name: text.encode() for name, text in files.items()}
    entries += [(name, stat.S_IFREG | 0o755, data) for name, data in contents.items()]
    entries.append(("TRAILER!!!", 0, b""))
    return b"".join(_cpio_entry(inode, *entry) for inode, entry in enumerate(entries, 1))


def _cpio_entry(inode: int, name: str, mode: int, data: bytes) -> bytes:
    """One member in the format of the kernel's ``buffer-format.rst``: 13 hex fields, then name, then data."""
    raw_name = name.encode() + b"\0"
    fields = (inode, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(raw_name), 0)
    header = b"070701" + b"".join(b"%08X" % field for field in fields) + raw_name
    return _padded(header) + _padded(data)


def _padded(data: bytes) -> bytes:
    return data + b"\0" * (-len(data) % 4)
