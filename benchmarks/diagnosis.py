"""Does a diagnosis name what was planted, and does it keep silent where nothing was?

    python benchmarks/diagnosis.py [--seed 1] [--pairs 40] [--clean 20] [--json FILE] [--only FAMILY]
    python benchmarks/diagnosis.py -o docs/measured/diagnosis.md

Every drive is simulated anew. Single effects are judged with mass and grade known, pairs with the mass alone,
clean drives half and half. Every other pair, and half of the clean drives, carry the small errors that every
vehicle has besides (torque, wind, rolling resistance, slip, delay).
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from diagnosis_drives import SIZES, USUAL_DELAY_S, Case, cases

from canest.config import load_config
from canest.core import jit
from canest.diagnosis.data.problem import TooLittleDrivingError
from canest.diagnosis.entries import entries
from canest.diagnosis.outcome import document, empty_document
from canest.diagnosis.run import diagnose
from canest.simulation import simulate
from canest.vehicle.effects import effect_class

DELAY = "torque_delay"
#: a value counts as right within this share
RIGHT = 0.15
SHOWN = ("exact", "stated", "one of", "traced", "right", "confident wrong", "clean", "named")
Row = dict[str, Any]


def run(case: Case) -> Row:
    """Simulate and diagnose one drive; return what was planted, what was reported and how it is judged."""
    jit.enable(True)
    with tempfile.TemporaryDirectory() as folder:
        files = simulate(case.scenario, case.scenario["seed"]).write(Path(folder))
        log = next(f for f in files if f.suffix == ".log")
        config = load_config(log.with_suffix(".yaml"))
        known: dict[str, Any] = {"mass_kg": case.scenario["mass_kg"]}
        if case.reference == "truth":
            known = {"truths": [log.with_suffix(".truth.csv")]}
        try:
            found = diagnose([log], config, **known)
            result = document(found, entries(found), [log.name], config.file)
        except TooLittleDrivingError as error:  # two faults may make a gearbox hunt for a whole drive
            result = empty_document(str(error), [log.name], config, config.file, error.notes)
            result["baseline"]["residual_rms_N"] = result["after"]["residual_rms_N"] = float("nan")
    return {"family": case.family, "seed": case.seed, "reference": case.reference, "planted": case.planted,
            "mass_kg": case.scenario["mass_kg"], "errors": case.scenario["small_errors"],
            "driver": case.scenario["driver"]["kind"], "finding": result["finding"],
            "verdict": result["verdict"], "selected": result["selected"],
            "before_N": result["baseline"]["residual_rms_N"],
            "after_N": result["after"]["residual_rms_N"], **judge(case, result)}  # fmt: skip


def judge(case: Case, result: dict[str, Any]) -> Row:
    """Compare diagnosis.json with what was planted."""
    entry = {c["effect"]: c for c in reversed(result["candidates"])}
    chosen = {c["effect"]: set(c["equivalent"]) for c in result["candidates"] if c["selected"]}
    stated = [set(model["effects"]) for model in result["models"]]
    if DELAY not in case.planted:  # every engine has one: right to find, and never what is asked for
        chosen.pop(DELAY, None)
        stated = [model - {DELAY} for model in stated]
    planted = set(case.planted)
    reported = result["verdict"] != "nothing-to-explain"
    named = set(chosen).union(*chosen.values(), *(stated if reported else ()))
    possible = named | set(result["not_excluded"])
    first = next(iter(chosen), None)
    values = {n: _value(entry, n) for n in planted & set(entry)}
    true = {n: v + (USUAL_DELAY_S if n == DELAY else 0.0) for n, v in case.planted.items()}
    off = {n: abs(values[n][0] - true[n]) / abs(true[n] - SIZES[n][2]) for n in values}
    single = bool(planted) and len(chosen) == 1 and result["verdict"] == "explained"
    headline = result["finding"].lower()
    said = named | {n for n in planted if effect_class(n).in_words().lower() in headline}
    beyond = [n for n in planted & set(chosen) if abs(values[n][0] - true[n]) > 3 * (values[n][1] or 0.0)]
    return {
        "exact": set(chosen) == planted,
        "stated": planted <= named,
        "one of": planted in stated,
        "named": len(named),
        "open": planted <= possible,
        "open names": len(possible),
        "traced": bool(planted) and first is not None and bool(planted & ({first} | chosen[first])),
        "right": bool(off) and max(off.values()) < RIGHT and len(off) == len(planted),
        "confident wrong": single and not planted <= said,
        "beyond": single and bool(beyond),
        "clean": not chosen,
        "brake first": "dragging brake" in result["finding"].split(". ")[0].lower(),
    }  # fmt: skip


def _value(entry: dict[str, Any], name: str) -> tuple[float, float | None]:
    parameter = entry[name]["parameters"][SIZES[name][0]]
    return float(parameter["value"]), parameter["std"]


def main() -> None:
    """Run the benchmark, print every drive and the figures, write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1, help="another seed: other drives")
    parser.add_argument("--pairs", type=int, default=40, help="drives with two effects")
    parser.add_argument("--clean", type=int, default=20, help="drives with nothing planted")
    parser.add_argument(
        "--only", action="append", metavar="FAMILY", help="clean, single, pair, brake and wind"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path, help="write every drive here")
    parser.add_argument("-o", "--output", type=Path, help="write the page here")
    parser.add_argument("--from-json", type=Path, help="write the page from an earlier run's --json")
    options = parser.parse_args()
    todo = [c for c in cases(options.seed, options.pairs, options.clean)
            if not options.only or c.family in options.only]  # fmt: skip
    rows: list[Row] = json.loads(options.from_json.read_text("utf-8")) if options.from_json else []
    with ProcessPoolExecutor(options.jobs) as pool:
        for row in pool.map(run, todo if not rows else []):
            rows.append(row)
            print(_line(row), flush=True)
    print("\n".join(f"{name:45} {figure}" for name, figure in figures(rows)))
    if options.output:
        command = f"python benchmarks/diagnosis.py --seed {options.seed} --pairs {options.pairs}"
        command += f" --clean {options.clean}"
        options.output.write_text(page(rows, command), encoding="utf-8")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


def _line(row: Row) -> str:
    planted = ", ".join(f"{n} {v:.4g}" for n, v in row["planted"].items()) or "nothing"
    flags = " ".join(f"{key}={int(row[key])}" for key in SHOWN)
    change = f"{row['before_N']:.0f} -> {row['after_N']:.0f} N"
    return (
        f"{row['family']} {row['seed']} {row['reference']} {row['driver']} [{planted}]\n"
        f"    {row['verdict']} {row['selected']} {change} {flags}\n    {row['finding']}"
    )


def figures(rows: list[Row]) -> list[tuple[str, str]]:
    """Return the figures that the page promises: what, and how many of how many."""

    def share(family: str, key: str, wanted: bool = True) -> str:
        mine = [r for r in rows if r["family"] == family]
        return f"{sum(bool(r[key]) == wanted for r in mine)} of {len(mine)}"

    pairs = [r["named"] for r in rows if r["family"] == "pair"]
    rows = [r | {"unstated": r["confident wrong"] and not r["open"]} for r in rows]
    return [
        ("clean drives that stay clean", share("clean", "clean")),
        ("single effects traced", share("single", "traced")),
        ("single effects within 15 %", share("single", "right")),
        ("pairs: both named", share("pair", "stated")),
        ("pairs: selected exactly", share("pair", "exact")),
        ("pairs: among the models as good", share("pair", "one of")),
        ("pairs: a confident wrong single effect", share("pair", "confident wrong")),
        ("pairs: the same, and the other not stated as possible either", share("pair", "unstated")),
        ("pairs: one effect, its value more than 3 std off", share("pair", "beyond")),
        ("pairs: effects named, mean", f"{np.mean(pairs):.1f}" if pairs else "-"),
        ("pairs: both named, or stated as not ruled out", share("pair", "open")),
        ("brake and wind: a brake in the first sentence", share("brake and wind", "brake first")),
    ]


def _missed(rows: list[Row]) -> list[str]:
    """Return the lines of the page that list what was not found, or found and not there."""
    lines = []
    for row in rows:
        planted = " with ".join(row["planted"])
        added = ", ".join(row["selected"]) or "nothing"
        name = f"{row['family']} {row['seed']}"
        if row["family"] == "clean" and not row["clean"]:
            lines.append(f"- {name}: {added} added where nothing was planted.")
        elif row["family"] == "single" and not row["right"]:
            lines.append(f"- {name}: {planted} has another value, or is not what was added ({added}).")
        elif row["family"] == "pair" and not row["stated"]:
            beside = "both are listed as not ruled out" if row["open"] else "not both are listed"
            lines.append(f"- {name}: {planted}, {row['verdict']}, added {added}; {beside}.")
    return ["What this run misses:", "", *lines, ""] if lines else []


def page(rows: list[Row], command: str) -> str:
    """Return the figures, and every drive, as a page of the docs."""
    lines = [
        "# How often a diagnosis is right",
        "",
        "Simulated drives of a truck of 10 to 36 t on a highway with bends, 500 s each. The terms are",
        "explained in [the diagnosis](../diagnosis.md). Single effects are judged with mass and grade known,",
        "pairs with the mass alone. Half of the clean drives and of the pairs carry the small errors that",
        "every vehicle has.",
        "",
        f"    {command} -o docs/measured/diagnosis.md",
        "",
        "| what | drives |",
        "|---|---|",
        *(f"| {name} | {figure} |" for name, figure in figures(rows)),
        "",
        "- Traced: the effect is the first that was added, or named as its equivalent.",
        "- Both named: each effect of a pair is added, named as an equivalent, or in a set stated as",
        "  about as likely.",
        "- Not ruled out: the statement lists the effects that may be there in the size of an ordinary",
        "  fault, whatever was found beside.",
        "- A confident wrong single effect: verdict `explained`, one effect beside the delay, and the other",
        "  neither named nor in the first sentence as one that may be there besides. Its value may also hold",
        "  for two effects that are named as one: the last such row.",
        "",
        *_missed(rows),
        "## Every drive",
        "",
        "| drives | planted | reference | verdict | added | residual, N | named |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        planted = ", ".join(f"{n} {v:.3g}" for n, v in row["planted"].items()) or "nothing"
        right = row["clean"] if row["family"] == "clean" else row["stated"]
        cells = [
            f"{row['family']} {row['seed']}", planted, row["reference"], row["verdict"],
            ", ".join(row["selected"]) or "-", f"{row['before_N']:.0f} → {row['after_N']:.0f}",
            "yes" if right else "**no**",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    main()
