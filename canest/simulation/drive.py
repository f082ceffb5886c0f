"""A simulated drive: what was on the bus, the truth, and what an engineer would know."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canest.core.errors import OutputError
from canest.core.frames import FloatColumn, FrameBlock
from canest.simulation.files import write_drive


@dataclass(frozen=True)
class SimulatedDrive:
    """A drive with its truth.

    frames: what was on the bus. truth: columns at 10 Hz (t_s, distance_m, speed_mps, accel_mps2, grade,
    mass_kg, elevation_m, shift, brake), (n,) each. config: what an engineer would know.
    undeclared: the effects in force that the config does not know, small errors included. history: every
    column of `constants.COLUMNS` at 200 Hz, for tests.
    """

    name: str
    frames: FrameBlock
    truth: dict[str, FloatColumn]
    config: dict[str, Any]
    undeclared: list[dict[str, Any]]
    history: dict[str, FloatColumn]

    def write(self, directory: str | Path, *, compress: bool = False, force: bool = False) -> list[Path]:
        """Write NAME.log (or NAME.log.xz), NAME.truth.csv and NAME.yaml; return their paths.

        force: also over files that somebody edited.
        Errors: OutputError when the directory cannot be written, UsageError for such a file.
        """
        try:
            return write_drive(
                Path(directory),
                self.name,
                self.frames,
                self.truth,
                self.config,
                compress=compress,
                force=force,
            )
        except OSError as error:
            raise OutputError(f"cannot be written ({error.strerror})", where=str(directory)) from error
