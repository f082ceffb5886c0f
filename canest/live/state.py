"""The state file: the learned mass, its standard deviation and its vehicle, kept over a restart.

Only what was valid is ever saved, and only what is ours, whole, recent enough in format and not from the
future is restored. Everything else is set aside under another name, never deleted and never used.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
from dataclasses import asdict, dataclass
from pathlib import Path

from canest.config.schema import Config
from canest.system.atomic_file import not_regular
from canest.system.files import write_atomically

VERSION = 1  #: of the file; another one is never restored
_MAX_BYTES = 65_536
_CLOCK_TOLERANCE_S = 60.0  #: a file this far in the future is a clock's adjustment, not a mistake

#: nobody stops, unloads and drives on in less; after a longer pause the load is uncertain
DRIVING_ON_S = 120.0
#: the same load weighs this much more or less under another config (effects, radius, efficiency)
CONFIG_CHANGE_STD = 0.03


@dataclass(frozen=True, slots=True)
class Learned:
    """What was learned of one vehicle.

    saved_s: UTC, seconds since 1970. standing: the vehicle stood when it was saved. distance_km: odometer,
    where the bus has one. config: fingerprint of the model it was learned with.
    """

    vehicle_key: str
    config: str
    mass_kg: float
    mass_std_kg: float
    saved_s: float
    standing: bool
    distance_km: float | None = None


@dataclass(frozen=True, slots=True)
class Restored:
    """The outcome of looking for a file: what it holds (or None), and a message for the log ('' none)."""

    learned: Learned | None
    message: str = ""


def vehicle_key(config: Config) -> str:
    """Return what a learned mass belongs to."""
    return config.vehicle.key or config.vehicle.name


def fingerprint(config: Config) -> str:
    """Return a short hash of everything that the learned mass depends on."""
    model = config.model_dump(mode="json", include={"vehicle", "signals", "dbc", "effects", "filter"})
    model["vehicle"].pop("name", None)
    return hashlib.sha256(json.dumps(model, sort_keys=True).encode()).hexdigest()[:16]


def save(path: Path, learned: Learned) -> None:
    """Write the file atomically. Errors: OSError."""
    content = {"version": VERSION, "valid": True, **asdict(learned)}
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def load(path: Path, config: Config, now_s: float) -> Restored:
    """Look for what was learned of this config's vehicle; never raises.

    A file that must not be used is renamed to NAME.bad-REASON, and the message has the reason.
    """
    try:
        content = _content(path)
    except FileNotFoundError:
        return Restored(None)
    except OSError as error:
        return Restored(None, f"{path}: cannot be read ({error.strerror}), starting without it")
    learned, reason, why = _checked(content[:_MAX_BYTES], config, now_s)
    if learned is not None:
        return Restored(learned)
    aside = path.with_name(f"{path.name}.bad-{reason}")
    try:
        path.replace(aside)
    except OSError as error:
        return Restored(None, f"{path}: {why}; not used (and cannot be set aside: {error.strerror})")
    return Restored(None, f"{path}: {why}; not used, set aside as {aside.name}")


def _content(path: Path) -> bytes:
    """Return the beginning of a file. Errors: OSError, for a FIFO and the like without waiting for it."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            raise not_regular(mode, path)
        return os.read(descriptor, _MAX_BYTES + 1)
    finally:
        os.close(descriptor)


def peek(path: Path) -> Learned | None:
    """Return what a state file holds, for a person to see; None when it is not there or not whole."""
    try:
        raw = dict(json.loads(_content(path)))
        learned = Learned(**{k: v for k, v in raw.items() if k not in ("version", "valid")})
        _check_types(learned)
    except (OSError, ValueError, TypeError, OverflowError, RecursionError):
        return None
    return learned


def unseen_s(learned: Learned, now_s: float) -> float:
    """Return the time in which the load may have changed unseen: that since saved, if a stop fits in."""
    age_s = max(0.0, now_s - learned.saved_s)
    return age_s if learned.standing or age_s > DRIVING_ON_S else 0.0


def fits(learned: Learned, config: Config) -> bool:
    """Return whether a mass lies within the bounds of a config's vehicle."""
    low, high = config.vehicle.mass_min_kg, config.vehicle.mass_max_kg
    return low <= learned.mass_kg <= high and learned.mass_std_kg <= high


def widened_std_kg(learned: Learned, config: Config) -> float:
    """Return the standard deviation to restart with: widened by the restart and by another config."""
    parts = [
        learned.mass_std_kg,
        config.service.restore_std * learned.mass_kg,
        CONFIG_CHANGE_STD * learned.mass_kg if learned.config != fingerprint(config) else 0.0,
    ]
    return math.hypot(*parts)


def _checked(content: bytes, config: Config, now_s: float) -> tuple[Learned | None, str, str]:
    """Return (what it holds, '', '') or (None, reason for the name, reason for a person)."""
    try:
        raw = dict(json.loads(content))
        version = raw.pop("version", None)
        if version != VERSION or isinstance(version, bool):
            return None, "version", f"is of version {version!r:.20}, expected {VERSION}"
        valid = raw.pop("valid", None)
        learned = Learned(**raw)
        _check_types(learned)
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        return None, "corrupt", f"is not a whole state file ({' '.join(str(error)[:100].split())})"
    if valid is not True:
        return None, "invalid", "was not valid when it was saved"
    if learned.vehicle_key != vehicle_key(config):
        found, expected = learned.vehicle_key[:40], vehicle_key(config)
        return None, "vehicle", f"belongs to the vehicle {found!r}, expected {expected!r}"
    if learned.saved_s > now_s + _CLOCK_TOLERANCE_S:
        return None, "future", f"is dated {learned.saved_s - now_s:.0f} s in the future"
    if not fits(learned, config):
        found = f"{learned.mass_kg:g} +- {learned.mass_std_kg:g} kg"
        low, high = config.vehicle.mass_min_kg, config.vehicle.mass_max_kg
        return None, "range", f"holds {found}, expected {low:g}..{high:g}"
    return learned, "", ""


def _check_types(learned: Learned) -> None:
    for name in ("mass_kg", "mass_std_kg", "saved_s"):
        value = getattr(learned, name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise TypeError(f"{name} is not a finite number")
    if learned.mass_kg <= 0 or learned.mass_std_kg <= 0 or learned.saved_s < 0:
        raise ValueError("a number is not positive")
    if not isinstance(learned.vehicle_key, str) or not isinstance(learned.config, str):
        raise TypeError("vehicle_key and config are not text")
    if not isinstance(learned.standing, bool):
        raise TypeError("standing is not true or false")
    distance = learned.distance_km
    if distance is not None:
        if isinstance(distance, bool) or not isinstance(distance, int | float) or not math.isfinite(distance):
            raise TypeError("distance_km is not a finite number")
        if distance < 0:
            raise ValueError("distance_km is negative")
