"""`canest run --serve`: the live page in a process of its own, whose end costs the daemon nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import canest
from canest.system.journal import Journal


class PageProcess:
    """`canest serve` beside a daemon; it ends with the daemon, however that ends.

    status_socket: the daemon's. Errors: OSError where no process can be started.
    """

    def __init__(self, port: int, status_socket: Path, journal: Journal) -> None:
        self._journal = journal
        # -P and the path: the canest that runs here, not one in the working directory
        paths = [str(Path(canest.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
        for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC"):  # systemd watches the daemon
            environment.pop(name, None)
        command = [sys.executable, "-P", "-m", "canest", "serve", "--with-parent"]
        command += ["--socket", str(status_socket), "--port", str(port)]
        # its standard input is a pipe that nobody writes to: it is closed when this process is gone
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, env=environment)
        threading.Thread(target=self._wait, name="canest-page", daemon=True).start()

    def close(self) -> None:
        """Let it end."""
        if self.process.stdin is not None:
            self.process.stdin.close()

    def _wait(self) -> None:
        code = self.process.wait()
        if code:
            self._journal.warning("page-ended", exit_code=code)
