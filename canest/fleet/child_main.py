"""The process in which logs are read: takes jobs on stdin, gives outcomes on stdout, ends with its parent.

Its temporary files go into the folder that is its argument, which it removes if its parent is gone.
Each message is its length (8 bytes, little-endian) and a pickle. The parent is the only one who sends.
"""

from __future__ import annotations

import os
import pickle
import queue
import shutil
import signal
import struct
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

LENGTH = struct.Struct("<Q")


def write_message(file: IO[bytes], message: Any) -> None:
    """Send a message. Errors: OSError."""
    content = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    file.write(LENGTH.pack(len(content)))
    file.write(content)
    file.flush()


def read_message(file: IO[bytes]) -> Any:
    """Return the next message. Errors: EOFError where the other side is gone."""
    return pickle.loads(_read_pickle(file))


def _read_pickle(file: IO[bytes]) -> bytes:
    head = file.read(LENGTH.size)
    if len(head) < LENGTH.size:
        raise EOFError
    (length,) = LENGTH.unpack(head)
    content = file.read(length)
    if len(content) < length:
        raise EOFError
    return content


def main() -> None:
    """Work until the parent closes the pipe or dies."""
    # Ctrl-C goes to the parent, which decides
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):  # where memory runs out all the same, the kernel shall end this process first
        Path("/proc/self/oom_score_adj").write_text("900")
    folder = tempfile.tempdir = os.environ["TMPDIR"] = sys.argv[1]
    results = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no outcome
    jobs: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(sys.stdin.buffer, jobs, folder), daemon=True).start()
    from canest.fleet.process_log import process_log

    bundles: dict[str, Any] = {}
    while True:
        job, more, settings = pickle.loads(jobs.get())
        bundles.update(more)
        outcome = process_log(job, bundles, settings)
        with suppress(OSError):  # the parent is gone: the other thread ends this process
            write_message(results, outcome)


def _receive(file: IO[bytes], jobs: queue.SimpleQueue[bytes], folder: str) -> None:
    """Pass on jobs as they came; end process and folder when the parent is gone, whatever it is doing.

    The main thread unpickles: a pickle imports modules, and two threads that import a package and a module of
    it at a time may each get the other's half.
    """
    with suppress(EOFError, OSError):
        while True:
            jobs.put(_read_pickle(file))
    shutil.rmtree(folder, ignore_errors=True)  # a parent that was killed has not done it
    os._exit(0)


if __name__ == "__main__":
    main()
