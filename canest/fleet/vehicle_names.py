"""What a vehicle is called in the lake: a number of the fleet as it is, a VIN only as a keyed hash.

A VIN leads to a person. Its hash (HMAC-SHA256) has a secret key, since the VINs of a fleet are few enough to
try them all. The key stays with whoever runs the fleet; the lake does not hold it.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote, unquote

from canest.core.errors import CanestError, UsageError

#: without I, O and Q (ISO 3779)
VIN = re.compile(r"[A-HJ-NPR-Z0-9]{17}")
KEY_FILE = "~/.local/state/canest/fleet-vin.key"
_KEY_BYTES = 32
_SHOWN_DIGITS = 16


def vehicle_name(given: str, key: bytes | None) -> str:
    """Return the lake's name of a vehicle. key: of VINs; None keeps them."""
    if key is None or not VIN.fullmatch(given.upper()):
        return given
    digest = hmac.new(key, given.upper().encode(), hashlib.sha256).hexdigest()
    return f"vin-{digest[:_SHOWN_DIGITS]}"


def read_key(file: str | None) -> bytes:
    """Return the secret key of VINs; the default file is made where there is none. Errors: CanestError."""
    path = Path(file or KEY_FILE).expanduser()
    try:
        if file is None and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):  # another run was first
                descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
                with os.fdopen(descriptor, "wb") as made:
                    made.write(secrets.token_bytes(_KEY_BYTES))
        key = path.read_bytes()
    except OSError as error:
        raise CanestError(f"cannot read the key of VINs: {error.strerror}", where=str(path)) from None
    if len(key) < _KEY_BYTES // 2:
        raise UsageError(
            "too short for a key", where=str(path), found=len(key), expected=f"{_KEY_BYTES} random bytes"
        )
    return key


def folder_of(vehicle: str) -> str:
    """Return the hive folder of a vehicle, vehicle=NAME, whatever characters the name has."""
    return f"vehicle={quote(vehicle, safe=' ')}"


def vehicle_of(folder: str) -> str:
    """Return the vehicle of a hive folder."""
    return unquote(folder.removeprefix("vehicle="))
