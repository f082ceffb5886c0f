"""Boot a guest, run one command in it, bring back exit status, output and files; never leave QEMU behind."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from guest import initramfs

Init = Literal["shell", "systemd"]

#: Program: the Debian package that has it.
TOOLS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "dpkg-deb": "dpkg",
    "apt-get": "apt",
    "ip": "iproute2",
    "candump": "can-utils",
}
#: Mounted afresh by the guest, so what lies there on the host is not seen.
_HIDDEN = ("/run/", "/dev/", "/proc/", "/sys/")
# no_timer_check: on a busy host the kernel's check of the emulated timer fails, and it panics
_KERNEL_OPTIONS = (
    "console=ttyS0 quiet panic=-1 mitigations=off no_timer_check "
    "systemd.show_status=0 systemd.unit=guest.service"
)
#: All that QEMU can, but for "fast" string moves: emulated byte by byte, they are the slowest way to copy.
_PROCESSOR = "max,-erms,-fsrm"
_HERE = Path(__file__).parent
#: A boot takes 5 to 15 s, more where others use the processor too.
BOOT_TIMEOUT_S = 120.0
_POLL_S = 0.1


class GuestError(RuntimeError):
    """The guest could not be started, did not end in time, or ended without an exit status."""


@dataclass(frozen=True, slots=True)
class GuestResult:
    """What the command left: exit ``status``, ``output`` (stdout and stderr), seconds since the boot."""

    status: int
    output: str
    wall_s: float


def missing_tools(init: Init = "shell") -> list[str]:
    """Debian packages to install before a guest can boot, empty when all is there."""
    missing = [package for tool, package in TOOLS.items() if shutil.which(tool) is None]
    if init == "systemd" and not Path("/lib/systemd/systemd").exists():
        missing.append("systemd")
    return missing


class Guest:
    """One boot for one command, as a context manager; the guest ends with the block, whatever happens.

    ``command`` runs as root with vcan0 up, in folder ``cwd``, with ``env`` added; what it writes to
    ``$GUEST_OUT`` appears in ``self.out`` on the host while it runs. ``init="systemd"`` makes the host's
    systemd process 1, which then starts the command as a service, with none of the host's units enabled.

    ``root`` is the tree that it runs on, the host's by default; nothing in it is changed. Another one needs
    bash, busybox and iproute2, and for ``init="systemd"`` systemd.

    One processor is the default: two emulated ones wait for each other whenever the host is busy, and then
    are together slower than one.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        init: Init = "shell",
        cwd: Path | None = None,
        env: Mapping[str, str] | None = None,
        memory_mb: int = 1024,
        cpus: int = 1,
        root: Path = Path("/"),
    ) -> None:
        self._command, self._init = list(command), init
        self._root, self._env = root, dict(env or {})
        self._cwd = cwd or Path.cwd()
        self._memory_mb, self._cpus = memory_mb, cpus
        self._cleanup = contextlib.ExitStack()
        self._started_s = 0.0

    def __enter__(self) -> Self:
        if missing := missing_tools(self._init):
            raise GuestError(f"cannot start a guest: apt-get install {' '.join(missing)}")
        for place in (self._cwd, Path(sys.prefix)):
            if self._root == Path("/") and f"{place}/".startswith(_HIDDEN):
                raise GuestError(f"{place} is not visible in the guest: put it elsewhere than {_HIDDEN}")
        try:
            kernel_home = initramfs.kernel()
            with contextlib.ExitStack() as stack:
                self._boot(kernel_home, stack)
                self._cleanup = stack.pop_all()
        except (initramfs.KernelError, OSError) as error:
            raise GuestError(f"cannot start a guest: {error}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cleanup.close()

    def _boot(self, kernel_home: Path, stack: contextlib.ExitStack) -> None:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="canest-guest-")))
        self.out = scratch / "out"
        self.out.mkdir()
        self.console_path = scratch / "console.log"
        busybox = Path(shutil.which("busybox") or "busybox").resolve()
        (scratch / "initrd").write_bytes(initramfs.build(kernel_home, busybox, self._files()))
        console = stack.enter_context(self.console_path.open("wb"))
        self._qemu = subprocess.Popen(
            # setpriv: should this process be killed, the kernel takes QEMU down with it. nice: the guest runs
            # against the clock, other tests on this host do not (without the right to it, only a warning).
            [
                "setpriv",
                "--pdeathsig",
                "KILL",
                "nice",
                "-n",
                "-10",
                *self._qemu_command(kernel_home, scratch),
            ],
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=subprocess.STDOUT,
        )
        stack.callback(self._qemu.wait)
        stack.callback(self._qemu.kill)
        self._started_s = time.monotonic()

    def _files(self) -> dict[str, str]:
        exports = {"HOME": "/root", "GUEST_OUT": "/.guest/out", **self._env}
        lines = [f"export {name}={shlex.quote(value)}" for name, value in exports.items()]
        lines += [f"cd {shlex.quote(str(self._cwd))}", f"exec {shlex.join(self._command)}", ""]
        files = {
            "init": (_HERE / "init.sh").read_text(),
            "guest/start": (_HERE / "start.sh").read_text(),
            "guest/command": "\n".join(lines),
        }
        return files | ({"guest/systemd": ""} if self._init == "systemd" else {})

    def _qemu_command(self, kernel_home: Path, scratch: Path) -> list[str]:
        return [
            "qemu-system-x86_64",
            *(
                "-accel",
                "tcg,thread=multi",
                "-cpu",
                _PROCESSOR,
                "-smp",
                str(self._cpus),
                "-m",
                f"{self._memory_mb}M",
            ),
            *("-nodefaults", "-no-reboot", "-display", "none", "-serial", "stdio"),
            *("-kernel", str(kernel_home / "vmlinuz"), "-initrd", str(scratch / "initrd")),
            *("-append", _KERNEL_OPTIONS),
            *(
                "-virtfs",
                f"local,path={self._root},mount_tag=host,security_model=none,readonly=on,multidevs=remap",
            ),
            *("-virtfs", f"local,path={self.out},mount_tag=out,security_model=none"),
        ]

    @property
    def running(self) -> bool:
        """Whether the machine is still on."""
        return self._qemu.poll() is None

    @property
    def age_s(self) -> float:
        """Seconds since the boot began."""
        return time.monotonic() - self._started_s

    def output(self) -> str:
        """What the command has printed so far."""
        return _text(self.out / "output")

    def follow(self, timeout_s: float) -> Iterator[None]:
        """Yield every tenth of a second until the machine is off; ``timeout_s`` from the boot, kill it."""
        while self.running:
            started = (self.out / "output").exists()
            limit_s = timeout_s if started else min(timeout_s, BOOT_TIMEOUT_S)
            if self.age_s > limit_s:
                self._qemu.kill()
                self._qemu.wait()
                what = "done" if started else "booted"
                raise GuestError(f"guest not {what} after {limit_s:.0f} s\n{self.last_words()}")
            yield
            time.sleep(_POLL_S)

    def result(self) -> GuestResult:
        """The command's result, once the machine is off."""
        status = _text(self.out / "status").strip()
        if not status:
            raise GuestError(f"guest ended without an exit status\n{self.last_words()}")
        return GuestResult(int(status), self.output(), self.age_s)

    def wait(self, timeout_s: float) -> GuestResult:
        """Wait for the command's end, at most ``timeout_s`` from the boot."""
        for _ in self.follow(timeout_s):
            pass
        return self.result()

    def last_words(self, characters: int = 3000) -> str:
        """The ends of the command's output and of the console, for a person who must find out why."""
        console = _text(self.console_path)[-characters:]
        return f"--- output\n{self.output()[-characters:]}\n--- console\n{console}"


def _text(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""


def run(
    command: Sequence[str], *, timeout_s: float = 300, init: Init = "shell", cwd: Path | None = None
) -> GuestResult:
    """Boot, run ``command``, return its result."""
    with Guest(command, init=init, cwd=cwd) as guest:
        return guest.wait(timeout_s)
