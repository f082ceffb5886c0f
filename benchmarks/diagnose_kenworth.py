"""What half a minute of a real truck's bus shows of its model, and what it cannot show.

    python benchmarks/diagnose_kenworth.py [LOG] -o docs/measured/kenworth.md

LOG: by default the bundled log of the tests.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from canest.config import load_config
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.residual_windows import CHUNK_S
from canest.diagnosis.outcome import reference_limits
from canest.diagnosis.report.format import interval
from canest.diagnosis.run import MIN_CHUNKS, Diagnosis, diagnose
from canest.diagnosis.search.dependence import causes
from canest.offline.replay import ReplayResult, replay

LOG = Path(__file__).resolve().parent.parent / "tests/data/kenworth/normal.log.xz"


def page(d: Diagnosis, result: ReplayResult) -> str:
    """Return the page in Markdown."""
    s = result.summary
    v = d.config.vehicle
    found = causes(d.problem)
    speed, torque = found["speed"].values, found["torque"].values
    gears = [np.unique(np.round(p.run.gear[p.windows.index >= 0])) for p in d.problem.parts]
    named = ", ".join(f"{g:.0f}" for g in np.unique(np.concatenate(gears)) if g > 0)
    rms = d.before.residual_rms_N
    # blocks count as independent, seconds do not
    least_N = 2.0 * rms / np.sqrt(d.problem.chunks)
    kmh = float(speed.mean())
    wind = least_N / (v.air_density_kgpm3 * v.drag_area_m2 * kmh / 3.6)
    blocks, tonnes = d.problem.chunks, d.problem.weight_N / GRAVITY_MPS2 / 1000
    mass = s["mass_kg"]
    estimate = "none" if mass is None else f"{mass:,.0f} ± {s['mass_std_kg']:,.0f} kg"
    lines = [
        "# Half a minute of a Kenworth, measured",
        "",
        "A clean drive of 30 s from [SystemsCyber/Truck_Sentry](https://github.com/SystemsCyber/Truck_Sentry)",
        "(MIT), bundled with the tests. Mass and grade are unknown, and half of `configs/kenworth.yaml` is",
        "assumed.",
        "",
        "    python benchmarks/diagnose_kenworth.py -o docs/measured/kenworth.md",
        "",
        f"**{d.finding}**",
        "",
        f"`canest diagnose` ends with verdict `{d.verdict}` and an unchanged `revised.yaml`: nothing was",
        "tried, nothing added. With enough effects to choose from something always fits so little driving,",
        "and nothing is left to test it on.",
        "",
        "## What it shows",
        "",
        "| | |",
        "|---|---|",
        f"| frames | {s['frames']:,} ({s['skipped_lines']:,} lines unreadable) |",
        f"| samples at 50 Hz | {s['samples']:,}, of which {s['updated']:,} with open gates |",
        f"| refused by gates | {', '.join(f'{k} {n:,}' for k, n in s['gates'].items()) or 'none'} |",
        f"| whole seconds with open gates | {d.problem.rows} in {blocks} blocks of at most {CHUNK_S:.0f} s |",
        f"| speed | {speed.min():.0f} to {speed.max():.0f} km/h |",
        f"| net torque | {torque.min():,.0f} to {torque.max():,.0f} N m |",
        f"| gears | {named} |",
        f"| mass at the end | {estimate}, status {s['status']} |",
        f"| residual of the model as configured, mass and slow grade free | {rms:,.0f} N "
        f"{interval(d.before, 'residual_rms_N')} |",
        "",
        "## What it cannot",
        "",
        f"With {blocks} independent blocks, a steady force stands out of this residual only above about",
        f"{least_N:,.0f} N (two standard errors). That is a headwind of {wind:.0f} m/s at the mean speed of",
        f"{kmh:.0f} km/h, or a slope of {100 * least_N / d.problem.weight_N:.1f} % at",
        f"the {tonnes:.1f} t that fit best.",
        "",
        reference_limits(d.references),
        "",
        f"At least {MIN_CHUNKS} blocks are needed before anything is tried; minutes at different speeds,",
        "and a weighbridge ticket (`--mass`), are what would help most.",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Diagnose, replay, write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path, nargs="?", default=LOG)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("-c", "--config", default="kenworth")
    options = parser.parse_args()
    config = load_config(options.config)
    text = page(diagnose([options.log], config), replay(options.log, config))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
