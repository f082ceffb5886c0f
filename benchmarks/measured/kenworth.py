"""What half a minute of a real truck's bus shows of its mass and its model, and what it cannot show.

    python benchmarks/measured/kenworth.py FOLDER -o docs/measured/kenworth.md

FOLDER holds normal.log, tsc1.log and address_claim.log (candump, also compressed), as published in
https://github.com/SystemsCyber/Truck_Sentry (MIT licence). The tests have them: tests/data/kenworth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from common import BLUE, GREY, Estimates, Page, arguments, made_by, number, plt, run, share

from canest.config import Config, load_config
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.residual_windows import CHUNK_S
from canest.diagnosis.outcome import reference_limits
from canest.diagnosis.report.format import interval
from canest.diagnosis.run import MIN_CHUNKS, Diagnosis, diagnose
from canest.diagnosis.search.dependence import causes
from canest.offline.replay import replay

LOGS = {
    "normal": "a clean drive",
    "tsc1": "torque commands injected",
    "address_claim": "address claims injected",
}
LICENCE = (
    "Data: [SystemsCyber/Truck_Sentry](https://github.com/SystemsCyber/Truck_Sentry), MIT licence; bundled "
    "with the tests. Mass and grade are unknown, and half of `configs/kenworth.yaml` is assumed."
)


def end_of(e: Estimates) -> tuple[str, str]:
    """Return mass and standard deviation at the end, for a table."""
    at = np.flatnonzero(e.known)
    if not len(at):
        return "-", "-"
    return number(e.mass_kg[at[-1]]), number(e.std_kg[at[-1]])


def write_masses(page: Page, runs: dict[str, dict[str, Estimates]], names: list[str]) -> None:
    """Write the mass that each method ends with, and draw ours."""
    page.section("The mass")
    page.text(
        "At the end of each recording, in kg, with the standard deviation that the method gives. A fit by "
        "hand to 20 s of the clean drive gave about 7.7 t, which is indicative at best. In the other two "
        "somebody injects frames; the truck is the same."
    )
    rows = []
    for name in names:
        cells = []
        for estimates in runs.values():
            mass, std = end_of(estimates[name])
            cells += [f"{mass} ± {std}", share(estimates[name].valid_share())]
        rows.append((f"`{name}`", *cells))
    header = [h for log in runs for h in (f"{log}: {LOGS[log]}", "valid")]
    page.table(("method", *header), rows)
    figure, axes = plt.subplots(
        1, len(runs), figsize=(10, 2.6), layout="constrained", sharey=True, squeeze=False
    )
    for axis, (log, estimates) in zip(axes[0], runs.items(), strict=True):
        e = estimates[names[0]]
        t = e.t_s - e.t_s[0]
        low, high = (e.mass_kg - 2 * e.std_kg) / 1000, (e.mass_kg + 2 * e.std_kg) / 1000
        thin = slice(None, None, 10)
        axis.fill_between(t[thin], low[thin], high[thin], color=GREY, alpha=0.4, lw=0)
        axis.plot(t[thin], e.mass_kg[thin] / 1000, color=BLUE, lw=1)
        axis.set(title=log, xlabel="s", ylim=(0, 30))
    axes[0, 0].set_ylabel("mass, t (two std)")
    page.figure(figure, "mass", "Estimated mass in the three recordings")


def write_diagnosis(page: Page, log: Path, config: Config) -> None:
    """Write what the clean drive shows of the model."""
    d, s = diagnose([log], config), replay(log, config).summary
    found = causes(d.problem)
    speed, torque = found["speed"].values, found["torque"].values
    gears = [np.unique(np.round(p.run.gear[p.windows.index >= 0])) for p in d.problem.parts]
    named = ", ".join(f"{g:.0f}" for g in np.unique(np.concatenate(gears)) if g > 0)
    page.section("What the model lacks")
    page.text(f"**{d.finding}**")
    page.text(
        f"`canest diagnose` ends with verdict `{d.verdict}` and an unchanged `revised.yaml`: nothing was "
        "tried, nothing added. With enough effects to choose from something always fits so little driving, "
        "and nothing is left to test it on."
    )
    residual = f"{d.before.residual_rms_N:,.0f} N {interval(d.before, 'residual_rms_N')}"
    page.table(
        ("of the clean drive", ""),
        [
            ("frames", f"{s['frames']:,} ({s['skipped_lines']:,} lines unreadable)"),
            ("samples at 50 Hz", f"{s['samples']:,}, of which {s['updated']:,} with open gates"),
            ("refused by gates", ", ".join(f"{k} {n:,}" for k, n in s["gates"].items()) or "none"),
            (
                "whole seconds with open gates",
                f"{d.problem.rows} in {d.problem.chunks} blocks of {CHUNK_S:.0f} s",
            ),
            ("speed", f"{speed.min():.0f} to {speed.max():.0f} km/h"),
            ("net torque", f"{torque.min():,.0f} to {torque.max():,.0f} N m"),
            ("gears", named),
            ("residual of the model, mass and slow grade free", residual),
        ],
    )
    page.text(limits(d, float(speed.mean())))
    page.text(reference_limits(d.references))
    page.text(
        f"At least {MIN_CHUNKS} blocks are needed before anything is tried; minutes at different speeds, and "
        "a weighbridge ticket (`--mass`), are what would help most."
    )


def limits(d: Diagnosis, kmh: float) -> str:
    """Return what the smallest visible force is, in words."""
    v = d.config.vehicle
    # blocks count as independent, seconds do not
    least_N = 2.0 * d.before.residual_rms_N / np.sqrt(d.problem.chunks)
    wind = least_N / (v.air_density_kgpm3 * v.drag_area_m2 * kmh / 3.6)
    return (
        f"With {d.problem.chunks} independent blocks, a steady force stands out of this residual only above "
        f"about {least_N:,.0f} N (two standard errors). That is a headwind of {wind:.0f} m/s at the mean "
        f"speed of {kmh:.0f} km/h, or a slope of {100 * least_N / d.problem.weight_N:.1f} % at the "
        f"{d.problem.weight_N / GRAVITY_MPS2 / 1000:.1f} t that fit best."
    )


def main() -> None:
    options = arguments(__doc__ or "", "normal.log, tsc1.log and address_claim.log")
    config = load_config("kenworth")
    paths = {name: p for name in LOGS for p in sorted(options.folder.glob(f"{name}.log*"))[:1]}
    if "normal" not in paths:
        raise SystemExit(f"error: {options.folder}: no normal.log, expected the logs of Truck_Sentry")
    names = options.estimators
    shown = list(paths)[: options.first]
    runs = {name: run(paths[name], config, names, name) for name in shown}
    page = Page(options.output, "Half a minute of a Kenworth, measured")
    page.text("Three recordings of 30 s of one truck's J1939 bus, 23 to 55 km/h, gears 2 to 4.")
    page.text(LICENCE)
    made_by(page, options, "tests/data/kenworth")
    write_masses(page, runs, names)
    write_diagnosis(page, paths["normal"], config)
    page.write()


if __name__ == "__main__":
    main()
