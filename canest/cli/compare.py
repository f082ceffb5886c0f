"""`canest compare`: every estimator on one log."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from canest.cli.options import (
    ConfigChoice,
    TruthChoice,
    config_option,
    grouped,
    log_budget_option,
    override_options,
    truth_options,
)
from canest.system import terminal

if TYPE_CHECKING:
    from canest.offline.compare import Comparison

EPILOG = """\b
Examples:
  canest compare drive.log -c class8 --truth drive.truth.csv
  canest compare drive.log -c my.yaml --mass 21250 --initial-mass 9000
  canest compare drive.log -c class8 --truth auto --only canest,rlsmf,ekf --report compare.html

The log is decoded once; every estimator then gets the same samples. The config's own (or --estimator) runs
with estimator.options and is marked, the others run with their defaults; --only leaves estimators out. One
that needs a signal which the log lacks has a note in its row. The column "to 5 %, s" has the seconds of
driving until the mass first stays within 5 % of the truth for 10 s (it may leave again). The column
"ns/sample" has what the estimator costs.
"""

#: columns of a table that goes to a file or a pipe
_FILE_WIDTH = 160


@click.command(epilog=EPILOG)
@click.argument("log", metavar="LOG")
@config_option()
@truth_options
@override_options
@click.option("--only", metavar="NAMES", help="Compare these only (comma between them).")
@click.option("--json", "json_path", metavar="PATH", help="Write the table as JSON ('-': to stdout).")
@click.option("--report", metavar="HTML", help="Write an HTML report with all curves over the truth.")
@click.option("--channel", metavar="NAME", help="Use this interface of the log only.")
@log_budget_option
@click.option("--compiled/--interpreted", default=None, help="Kernels by numba or not (default: by length).")
@grouped(chosen=ConfigChoice, truth=TruthChoice)
def command(
    log: str,
    chosen: ConfigChoice,
    truth: TruthChoice,
    only: str | None,
    json_path: str | None,
    report: str | None,
    channel: str | None,
    compiled: bool | None,
) -> int:
    """Run every estimator on one log and compare each with the truth."""
    if truth.truth is None and truth.mass_kg is None:
        raise click.UsageError("give the truth: --truth CSV, --truth auto or --mass KG")
    config = chosen.load()
    names = _known(only) if only is not None else None
    from canest.cli.progress import Bar
    from canest.cli.summary import write_json
    from canest.config.database_files import config_files
    from canest.logs.log_names import truth_file
    from canest.logs.truth import read_truth
    from canest.offline.compare import compare
    from canest.offline.scoring import Reference
    from canest.system.output_conflicts import keep_apart

    if report is not None:
        from canest.report.page import require_packages

        require_packages(report)
    path = truth_file(Path(log), truth.truth)
    keep_apart(
        [*config_files(config), ("the log", log), ("the truth", path)],
        [("--json", json_path), ("--report", report)],
    )
    with Bar(Path(log).name) as bar:
        result = compare(
            config,
            log,
            reference=Reference(read_truth(path) if path is not None else None, truth.mass_kg, truth.after_s),
            names=names,
            channel=channel,
            compiled=compiled,
            progress=bar.update,
        )
    if json_path is not None:
        write_json(result.table, json_path)
    if json_path != "-":
        _show(log, result)
    if report is not None:
        from canest.report.compare_page import write_compare_report

        write_compare_report(report, log, config, result)
        if json_path != "-":
            print(f"written {report}")
    return 0


def _known(only: str) -> list[str]:
    """Return the names of --only. Errors: ConfigError for one that no estimator has."""
    from canest.estimators.registry import require_known

    names = [name.strip() for name in only.split(",")]
    for name in names:
        require_known(name, where="--only")
    return names


def _show(log: str, result: Comparison) -> None:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from canest.report.compare_page import COLUMNS, ranked
    from canest.report.page import cells

    console = terminal.console(highlight=False, width=None if sys.stdout.isatty() else _FILE_WIDTH)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=escape(log), title_justify="left")
    table.add_column("estimator", no_wrap=True)
    for _, title, _ in COLUMNS:
        table.add_column(title, justify="right")
    table.add_column("note")
    estimators = result.table["estimators"]
    for name in ranked(estimators):
        style = "bold" if name == result.table["default"] else ""
        table.add_row(name, *cells(estimators[name], COLUMNS), escape(estimators[name]["note"]), style=style)
    console.print(table)
    for note in result.table["notes"]:
        console.print(f"[dim]note[/]  {escape(note)}", soft_wrap=True)
