"""The process in which logs are read: takes jobs on stdin, gives outcomes on stdout, ends with its parent.

Each message is its length (8 bytes, little-endian) and a pickle. The parent is the only one who sends.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import struct
import sys
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
    results = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no outcome
    jobs: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(sys.stdin.buffer, jobs), daemon=True).start()
    from canest.fleet.process_log import process_log

    bundles: dict[str, Any] = {}
    while True:
        job, more, settings = pickle.loads(jobs.get())
        bundles.update(more)
        write_message(results, process_log(job, bundles, settings))


def _receive(file: IO[bytes], jobs: queue.SimpleQueue[bytes]) -> None:
    """Pass on jobs as they came; end the process when the parent is gone, whatever it is doing.

    The main thread unpickles: a pickle imports modules, and two threads that import a package and a module of
    it at a time may each get the other's half.
    """
    with suppress(EOFError, OSError):
        while True:
            jobs.put(_read_pickle(file))
    os._exit(0)


if __name__ == "__main__":
    main()
