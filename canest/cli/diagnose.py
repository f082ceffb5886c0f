"""`canest diagnose`: closes the loop on measured data."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from canest.cli.options import (
    MASS,
    ConfigChoice,
    config_option,
    grouped,
    log_budget_option,
    override_options,
)
from canest.system import terminal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canest.config import Config
    from canest.diagnosis.entries import Entry
    from canest.diagnosis.run import Diagnosis

#: the kernels go over every drive so often, measured by what compiling them saves
_PASSES = 40

EPILOG = """\b
Examples:
  canest diagnose drive.log -c my-truck.yaml --mass 21300 -o found/
      the mass is known from a weighbridge; the grade from the bus' own sensors, if it has any
  canest diagnose drive.log -c class8 --truth drive.truth.csv -o found/
      mass or grade or both from a table with t_s, mass_kg, grade
  canest diagnose week/*.log.xz -c my-truck.yaml --truth auto -o found/
      many drives of one vehicle: fitted on some, judged on others
  canest diagnose --recorded /var/lib/canest/NAME/recorded -c my-truck.yaml -o found/
      what the service NAME kept of the last days (else: service.residual_dir)
  canest replay other.log -c found/revised.yaml
      the better model on another drive: the proof

\b
Writes into DIR:
  diagnosis.json   every effect tried, with value, standard deviation and share; before and after
  revised.yaml     the config with what was found, for canest run and replay
  report.html      the same to look at: residuals over time and against their cause

The better the reference, the more can be separated: with --mass and --truth single effects, with --mass
alone most of them, from the bus alone only what a slope cannot imitate. The report names which it was.
A log that cannot be read is named, and the exit code is 1; the others are diagnosed all the same.
"""

#: candidates shown on the terminal
SHOWN = 6


@click.command(epilog=EPILOG)
@click.argument("logs", nargs=-1, metavar="LOG...")
@config_option()
@click.option("--truth", metavar="CSV", help="Table with t_s and mass_kg or grade or both; "
              "'auto' takes NAME.truth.csv beside each log.")  # fmt: skip
@click.option("--mass", "mass_kg", type=MASS, metavar="KG", help="The true mass, if constant.")
@click.option("--recorded", metavar="DIR", help="Recording that `canest run` keeps (service.residual_dir); "
              "its segments join the logs, oldest first.")  # fmt: skip
@click.option("-o", "--output", required=True, metavar="DIR", help="Directory for the three files.")
@click.option("--channel", metavar="NAME", help="Use this interface of the logs only (can0, can1, ...).")
@log_budget_option
@override_options
@grouped(chosen=ConfigChoice)
def command(
    logs: tuple[str, ...],
    chosen: ConfigChoice,
    truth: str | None,
    mass_kg: float | None,
    recorded: str | None,
    output: str,
    channel: str | None,
) -> int:
    """Find what the vehicle model lacks in measured data, add it, and show the error before and after."""
    context = click.get_current_context()
    if not logs and recorded is None:
        raise click.UsageError("nothing to diagnose: give a LOG or --recorded DIR", context)
    from canest.report.page import require_packages

    require_packages(Path(output) / "report.html")
    config = chosen.load()
    paths = [Path(log) for log in logs] + (_segments(Path(recorded)) if recorded is not None else [])
    if truth not in (None, "auto") and len(paths) > 1:
        raise click.UsageError("one truth cannot fit several logs: use --truth auto", context)
    truths = _truths(paths, truth)
    from canest.config.database_files import config_files
    from canest.diagnosis.report.files import CONFIG_NAME, JSON_NAME, REPORT_NAME
    from canest.system.output_conflicts import keep_apart

    keep_apart(
        config_files(config)
        + [(f"the log {path}", path) for path in paths]
        + [(f"the truth {path}", path) for path in truths or ()],
        [("-o", Path(output) / name) for name in (JSON_NAME, CONFIG_NAME, REPORT_NAME)],
    )
    return _diagnose(paths, config, chosen.name, truths, mass_kg, channel, Path(output))


def _diagnose(
    paths: list[Path],
    config: Config,
    config_name: str,
    truths: list[Path | None] | None,
    mass_kg: float | None,
    channel: str | None,
    output: Path,
) -> int:
    from canest.cli.progress import Stages
    from canest.core import jit
    from canest.diagnosis.data.problem import TooLittleDrivingError
    from canest.diagnosis.report.files import check_folder, write, write_empty
    from canest.diagnosis.run import diagnose
    from canest.offline.replay import compiling_pays

    check_folder(output)  # before the work of minutes
    jit.enable(compiling_pays(paths, _PASSES))
    names = [str(p) for p in paths]
    try:
        with Stages("diagnose") as bar:
            diagnosis = diagnose(
                paths, config, truths=truths, mass_kg=mass_kg, channel=channel, progress=bar.show
            )
            bar.show("writing", 0.95)
            written = write(diagnosis, config_name, names, output)
    except TooLittleDrivingError as error:
        written = write_empty(error, config, config_name, names, output)
        print("\n".join([written.finding, "", *_notes(error.notes), *_skipped(), _files(written.paths)]))
        return _failures(error.failed)
    show(diagnosis, written.found)
    for reason in diagnosis.problem.left_out:
        print(f"left out: {reason}")
    notes = [*_notes(diagnosis.problem.notes), *_skipped(), *_failing(diagnosis)]
    print("\n".join([*notes, _files(written.paths)]))
    if diagnosis.search.chosen:
        print(f"try it: canest replay ANOTHER.log -c {shlex.quote(str(output / 'revised.yaml'))}")
    return _failures(diagnosis.problem.failed)


def _notes(noted: Mapping[str, Sequence[str]]) -> list[str]:
    from canest.cli.summary import note_lines, short_names
    from canest.diagnosis.report.files import JSON_NAME

    return note_lines(list(zip(short_names(list(noted)), noted.values(), strict=True)), JSON_NAME)


def _skipped() -> list[str]:
    """Return a line for every effect of another package that cannot be used."""
    from canest.vehicle.effects import skipped_effects

    return [f"skipped the effect {name}: {reason}" for name, reason in skipped_effects().items()]


def _failing(diagnosis: Diagnosis) -> list[str]:
    """Return a line for every effect of another package that failed when it was tried."""
    return [f"not tried: {reason}" for reason in diagnosis.search.failed.values()]


def _failures(failed: Sequence[str]) -> int:
    """Print which logs could not be used, and why; return the exit code."""
    for reason in failed:
        print(f"error: {reason}", file=sys.stderr)
    return 1 if failed else 0


def _segments(folder: Path) -> list[Path]:
    """Return the recording's segments in the order of their names, which begin with the time."""
    from canest.core.errors import LogError

    if not folder.is_dir():
        raise LogError("no such directory", where=str(folder), expected="what service.residual_dir names")
    found = sorted(p for p in folder.iterdir() if p.is_file() and ".log" in p.suffixes)
    if not found:
        raise LogError("holds no recording", where=str(folder), expected="candump logs (*.log.gz)")
    return found


def _truths(paths: Sequence[Path], truth: str | None) -> list[Path | None] | None:
    if truth is None:
        return None
    if truth != "auto":
        return [Path(truth)]
    from canest.core.errors import LogError
    from canest.logs.log_names import truth_beside

    found = [truth_beside(path) for path in paths]
    if not any(found):
        raise LogError("no NAME.truth.csv beside the log", where=str(paths[0]))
    return found


def show(diagnosis: Diagnosis, found: Sequence[Entry]) -> None:
    """Print the finding, before and after, and the best candidates."""
    from rich.table import Table
    from rich.text import Text

    from canest.diagnosis.report.format import entry_name, entry_value, score_rows

    console = terminal.console(highlight=False)
    if not console.is_terminal:
        console.width = 140
    problem = diagnosis.problem
    console.print(diagnosis.finding, markup=False, soft_wrap=not console.is_terminal)
    for line in diagnosis.details:
        console.print(f"  {line}", markup=False, soft_wrap=not console.is_terminal)
    drives = f"{len(problem.parts)} drives" if len(problem.parts) > 1 else "1 drive"
    mass = "mass known" if problem.mass_known else "mass unknown"
    console.print(f"[dim]verdict[/]    {diagnosis.verdict}")
    console.print(f"[dim]from[/]       {problem.rows:,} s with open gates in {drives}")
    console.print(f"[dim]reference[/]  {diagnosis.references[0].text}; {mass}\n")
    table = Table(box=None, header_style="dim", pad_edge=False)
    for name in ("", "before", "after"):
        table.add_column(name, justify="left" if not name else "right")
    for label, _, before, after in score_rows(diagnosis):
        table.add_row(label, before, after)
    console.print(table)
    console.print()
    if not found:
        return
    table = Table(box=None, header_style="dim", pad_edge=False)
    table.add_column("effect")
    table.add_column("value", justify="right")
    table.add_column("removes", justify="right")
    table.add_column("inseparable from")
    for entry in found[:SHOWN]:
        cells = (
            ("* " if entry.selected else "  ") + entry_name(entry),
            entry_value(entry),
            f"{100 * entry.explained:.1f} %",
            ", ".join(entry.equivalent),
        )
        # a signal's name is the user's: as text, since a bracket in it is no markup
        table.add_row(*map(Text, cells), style="bold" if entry.selected else "dim")
    console.print(table)
    left = len(found) - SHOWN
    more = f"and {left} more in diagnosis.json; " if left > 0 else ""
    console.print(f"[dim]{more}*: added to the model, removes what comes back without it; others: alone[/]")
    console.print("[dim]removes: share of the held-out residual variance once whitened, not in newtons[/]")
    console.print()


def _files(paths: Sequence[Path]) -> str:
    return "\n".join(f"written {path}" for path in paths)
