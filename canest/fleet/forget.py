"""Deletes a vehicle from a lake: what its owner or driver may ask for."""

from __future__ import annotations

from canest.core.errors import UsageError
from canest.fleet.lake import Lake
from canest.fleet.vehicle_names import VIN, folder_of, read_key, vehicle_name


def forget_vehicle(lake: str, vehicle: str, vin_key: str | None) -> int:
    """Remove all files of a vehicle, named as in the lake or by its VIN; return how many.

    Errors: UsageError where the lake has no such vehicle.
    """
    opened = Lake.open(lake)
    names = [vehicle]
    if VIN.fullmatch(vehicle.upper()):
        names += [vehicle.upper(), vehicle_name(vehicle, read_key(vin_key))]
    removed = sum(opened.remove_vehicle(folder_of(name)) for name in dict.fromkeys(names))
    if not removed:
        raise UsageError(
            "no such vehicle in the lake", where=lake, found=vehicle,
            expected="one of `canest fleet query LAKE \"select distinct vehicle from trips\"`",
        )  # fmt: skip
    return removed
