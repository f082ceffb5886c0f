"""A simulated drive as a notebook holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canest.config.database_files import read_databases
from canest.config.load import validated
from canest.config.origins import Origins
from canest.core.frames import FloatColumn, FrameBlock

if TYPE_CHECKING:
    from canest.config import Config
    from canest.simulation import drive as inner


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDrive:
    """A drive with known truth, in memory; goes wherever a log does.

    Attributes:
        name: of the scenario.
        frames: what was on the bus, `FrameBlock`.
        truth: columns at 10 Hz, float64 (n,): t_s, distance_m, speed_mps, accel_mps2, grade, mass_kg,
            elevation_m, shift, brake.
        config: what an engineer would know of the vehicle.
        undeclared: the effects in force that the config does not know.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> float(drive.truth["mass_kg"][0])
        21000.0
    """

    name: str
    frames: FrameBlock = field(repr=False)
    truth: Mapping[str, FloatColumn] = field(repr=False)
    config: Config = field(repr=False)
    undeclared: tuple[Mapping[str, Any], ...]
    _made: inner.SimulatedDrive = field(repr=False)

    def write(self, directory: str | Path, *, compress: bool = False, force: bool = False) -> list[Path]:
        """Write NAME.log (or NAME.log.xz), NAME.truth.csv and NAME.yaml; return their paths.

        force: also over files that somebody edited.
        Errors: OutputError when the directory cannot be written, UsageError for such a file.
        """
        return self._made.write(directory, compress=compress, force=force)


def simulated_drive_of(made: inner.SimulatedDrive) -> SimulatedDrive:
    """Return a drive with its config checked."""
    config = read_databases(validated(made.config, Origins()))
    return SimulatedDrive(made.name, made.frames, made.truth, config, tuple(made.undeclared), made)
