"""Compiles the kernels once after an installation, in a process that ends before any log is read.

Compiling takes 470 MB and most of a minute, loading what is compiled 1 s: a process that reads logs shall do
only the latter. A record of what is compiled for whom spares later runs even the question.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from canest.core import jit
from canest.fleet.bundle import Bundle, code_version

#: after so long the processes that read logs compile for themselves, s
_TIMEOUT_S = 600.0
_here = threading.Lock()  #: a Dask worker may have several threads; a lock of files does not part them


def compile_kernels(bundles: Mapping[str, Bundle], begun: Callable[[], None]) -> None:
    """Have the kernels compiled for the estimators of some configs, unless they are.

    begun: called where this is necessary. Where it fails, the processes that read logs compile them as they
    need them, or go without.
    """
    if not jit.available():
        return
    estimators = [bundle.unpack().estimator for bundle in bundles.values()]
    options = {estimator.name: estimator.options for estimator in estimators}
    with suppress(OSError, RuntimeError), _here, _locked(_folder()) as folder:  # RuntimeError: no home
        record = folder / f"kernels-{_digest(options)}.json"
        if _is_compiled(record):
            return
        begun()
        command = [sys.executable, "-m", "canest.fleet.compiling_main", str(record)]
        with suppress(subprocess.TimeoutExpired):
            subprocess.run(
                command, input=pickle.dumps(options), check=False, timeout=_TIMEOUT_S,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip


def _folder() -> Path:
    """Return where the record is: numba's own folder where one is named, else the user's."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(given) if given else Path(cache).expanduser() / "canest"


@contextmanager
def _locked(folder: Path) -> Iterator[Path]:
    """Let one process of this machine in at a time. Errors: OSError where nothing can be written."""
    folder.mkdir(parents=True, exist_ok=True)
    with Path(folder, "kernels.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield folder


def _digest(options: Mapping[str, Any]) -> str:
    """Return a digest of what decides whether numba takes what it has: code, its age, version, processor."""
    package = Path(__file__).parents[1]
    ages = [path.stat().st_mtime_ns for path in sorted(package.rglob("*.py"))]
    processor = [line for line in _processor().splitlines() if line.startswith(("model name", "flags"))][:2]
    parts = [code_version(), ages, version("numba"), sys.version, processor, str(package), sorted(options)]
    return hashlib.blake2b(repr(parts).encode(), digest_size=8).hexdigest()


def _processor() -> str:
    with suppress(OSError):
        return Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    return ""


def _is_compiled(record: Path) -> bool:
    """Return whether all files are there that were when the record was written."""
    with suppress(OSError, ValueError):
        return all(Path(file).exists() for file in json.loads(record.read_text(encoding="utf-8")))
    return False
