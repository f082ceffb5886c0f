"""One process at a time changes or removes the files of a vehicle; new ones may be written by anybody.

Here it is a lock on the vehicle's folder, which ends with its process. In a store it is an object that is
made only where there is none; what a killed process has left of it counts no longer after a while.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from canest.core.errors import CanestError
from canest.fleet.storage import Storage, plain, retried

LOCKS = "locks"
#: what is done under a lock takes seconds
LEASE_S = 600.0
_LOOK_S = 0.5


@contextmanager
def vehicle_lock(storage: Storage, vehicle: str) -> Iterator[None]:
    """Hold the lock of a vehicle's folder (vehicle=NAME); wait for whoever has it. Errors: CanestError."""
    yield from _folder_lock(storage, vehicle) if storage.is_local else _object_lock(storage, vehicle)


def _folder_lock(storage: Storage, vehicle: str) -> Iterator[None]:
    folder = Path(storage.root, "trips", vehicle)
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except FileNotFoundError:  # nothing there that could be changed
        yield
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        except OSError as error:
            raise CanestError(f"cannot be locked: {plain(error)}", where=str(folder)) from None
        yield
    finally:
        os.close(descriptor)


def _object_lock(storage: Storage, vehicle: str) -> Iterator[None]:
    name = f"{LOCKS}/{hashlib.blake2b(vehicle.encode(), digest_size=8).hexdigest()}"
    holder = f"{time.time():.0f} process {os.getpid()} of {socket.gethostname()}"
    while not _made(storage, name, holder):
        content = storage.read_if_there(name) or b"0"
        if time.time() - float(content.split()[0]) > LEASE_S:
            storage.remove(name)
        else:
            time.sleep(_LOOK_S)
    try:
        yield
    finally:
        storage.remove(name)


def _made(storage: Storage, name: str, content: str) -> bool:
    path = f"{storage.root}/{name}"
    try:
        retried(lambda: storage.files.pipe_file(path, content.encode(), mode="create"))
    except FileExistsError:
        return False
    except Exception as error:
        raise CanestError(f"cannot be locked: {plain(error)}", where=storage.url(name)) from None
    return True
