"""What the benchmarks on measured data share: files, runs, statistics, the page with its figures."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

import canest
from canest.config import Config
from canest.core import jit
from canest.core.samples import Status

Column = NDArray[np.float64]

#: methods that estimate a mass from speed and torque: ours, then those of the papers
OURS = ("canest", "canest-0.1")
PAPERS = (
    "batch-ls",
    "rls",
    "rls-vector",
    "rlsmf",
    "rlsmf-n",
    "tls",
    "gtls",
    "rtls",
    "rgtls",
    "ekf",
    "ekf-select",
)
SUFFIXES = (".csv", ".parquet", ".mf4")
MOVING_MPS = 0.2
COLOURS = 48  #: of a figure's palette: lines on a ground, a quarter of the size
BLUE, ORANGE, GREY = "#1d4ed8", "#d97706", "#94a3b8"

plt.rcParams.update({"font.size": 9, "axes.grid": True, "grid.color": "#e6eaf0"})


class Estimates(NamedTuple):
    """One estimator on one log, one row per 50 Hz sample, every column (n,)."""

    t_s: Column
    mass_kg: Column
    std_kg: Column
    grade: Column
    valid: NDArray[np.bool_]
    speed_mps: Column

    @property
    def moving(self) -> NDArray[np.bool_]:
        return np.abs(self.speed_mps) > MOVING_MPS

    @property
    def known(self) -> NDArray[np.bool_]:
        return np.isfinite(self.mass_kg) & self.moving

    def valid_share(self) -> float:
        """Return the share of the driving that was valid."""
        return float((self.valid & self.moving).sum() / max(self.moving.sum(), 1))


def arguments(doc: str, found: str) -> argparse.Namespace:
    """Return what the command line says: a folder of published files, a page to write.

    found: what the folder must hold, for an error.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder with the published files")
    parser.add_argument("-o", "--output", type=Path, required=True, help="page to write, NAME.md")
    parser.add_argument(
        "--estimators", nargs="+", default=[*OURS, *PAPERS], metavar="NAME",
        help=f"methods to run, by default all: {', '.join([*OURS, *PAPERS])}",
    )  # fmt: skip
    parser.add_argument("--first", type=int, metavar="N", help="only the first N files, to try it")
    options = parser.parse_args()
    if not options.folder.is_dir():
        parser.error(f"{options.folder}: no such folder, expected one with {found}")
    unknown = [name for name in options.estimators if name not in [*OURS, *PAPERS]]
    if unknown:
        parser.error(
            f"--estimators: unknown {', '.join(unknown)}, expected some of {', '.join([*OURS, *PAPERS])}"
        )
    if OURS[0] not in options.estimators:  # it is in every figure
        options.estimators.insert(0, OURS[0])
    return options


def files_in(options: argparse.Namespace, wanted: Callable[[str], bool], found: str) -> list[Path]:
    """Return the files of the folder by name. found: what they are, for an error."""
    folder: Path = options.folder
    files = sorted(p for p in folder.rglob("*") if _suffix(p) in SUFFIXES and wanted(p.name))
    if not files:
        sys.exit(f"error: {folder}: no file there is of this data set, expected {found}")
    return files[: options.first]


def _suffix(path: Path) -> str:
    return next((s.lower() for s in path.suffixes if s.lower() in SUFFIXES), "")


def run(log: Any, config: Config, names: Sequence[str], title: str) -> dict[str, Estimates]:
    """Run estimators on the same samples of one log: a file or a table."""
    jit.enable()
    print(f"{title}: {', '.join(names)}", file=sys.stderr, flush=True)
    both = canest.compare(log, config, estimators=names)
    return {
        name: Estimates(e.t_s, e.mass_kg, e.mass_std_kg, e.grade, e.status == Status.VALID, both.speed_mps)
        for name, e in both.estimates.items()
    }


# -- statistics ---------------------------------------------------------------------------------------


class Line(NamedTuple):
    """The straight line through points (x, y), and how they lie about it."""

    slope: float
    intercept: float
    correlation: float
    scatter: float
    points: int

    def at(self, x: Column | float) -> Any:
        return self.intercept + self.slope * x


def line_through(x: Column, y: Column) -> Line:
    """Return the line of least squares; NaN where there are too few points."""
    if len(x) < 3 or np.ptp(x) == 0:
        return Line(np.nan, np.nan, np.nan, np.nan, len(x))
    slope, intercept = np.polyfit(x, y, 1)
    rest = y - intercept - slope * x
    return Line(slope, intercept, float(np.corrcoef(x, y)[0, 1]), float(rest.std()), len(x))


def middle_half_pct(values: Iterable[float]) -> float:
    """Return the width of the middle half, per cent of the median."""
    low, middle, high = np.nanpercentile(np.array(list(values), float), [25, 50, 75])
    return float(100 * (high - low) / middle)


def spread_pct(values: Iterable[float]) -> float:
    """Return the distance from the smallest to the largest, per cent of their mean."""
    v = np.array(list(values), float)
    return float(100 * np.ptp(v) / v.mean()) if len(v) else np.nan


# -- the page -----------------------------------------------------------------------------------------


class Page:
    """A Markdown page with its figures beside it, named after it."""

    def __init__(self, path: Path, title: str) -> None:
        self.path = path
        self._parts = [f"# {title}"]
        path.parent.mkdir(parents=True, exist_ok=True)

    def section(self, title: str) -> None:
        self._parts.append(f"## {title}")

    def text(self, text: str) -> None:
        self._parts.append(
            textwrap.fill(" ".join(text.split()), 120, break_long_words=False, break_on_hyphens=False)
        )

    def code(self, text: str) -> None:
        self._parts.append(f"    {text}")

    def items(self, items: Sequence[str]) -> None:
        lines = (
            textwrap.fill(" ".join(i.split()), 120, initial_indent="- ", subsequent_indent="  ",
                          break_long_words=False, break_on_hyphens=False)
            for i in items
        )  # fmt: skip
        self._parts.append("\n".join(lines))

    def table(self, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        lines = [header, ["---"] * len(header), *rows]
        self._parts.append("\n".join("| " + " | ".join(line) + " |" for line in lines))

    def figure(self, figure: Figure, name: str, caption: str) -> None:
        path = self.path.with_name(f"{self.path.stem}-{name}.png")
        figure.savefig(path, dpi=90)
        plt.close(figure)
        with Image.open(path) as drawn:
            drawn.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
        self._parts.append(f"![{caption}]({path.name})")

    def write(self) -> None:
        self.path.write_text("\n\n".join(self._parts) + "\n", encoding="utf-8")
        print(self.path)


def number(value: float, digits: int = 0, unit: str = "") -> str:
    """Return a number for a table, a dash where there is none."""
    return f"{value:,.{digits}f}{unit}" if np.isfinite(value) else "-"


def share(value: float) -> str:
    """Return a share as per cent, a dash where there is none."""
    return f"{100 * value:.0f} %" if np.isfinite(value) else "-"


def made_by(page: Page, options: argparse.Namespace, folder: str = "FOLDER") -> None:
    """Write which command and version made the page. folder: what stands for it in the command."""
    command = (
        f"python benchmarks/measured/{Path(sys.argv[0]).name} {folder} -o docs/measured/{page.path.name}"
    )
    if options.first:
        command += f" --first {options.first}"
    if options.estimators != [*OURS, *PAPERS]:
        command += f" --estimators {' '.join(options.estimators)}"
    page.text(f"Made with canest {canest.__version__} by")
    page.code(command)
