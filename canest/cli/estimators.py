"""`canest estimators`: what there is to choose from, and the options of each."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from canest.cli.repeated_options import Group
from canest.system import terminal

if TYPE_CHECKING:
    from canest.estimators.description import Description

EPILOG = """\b
Examples:
  canest estimators list
  canest estimators show rlsmf
  canest estimators show ekf --json
"""

#: columns of a table that goes to a file or a pipe
_FILE_WIDTH = 160
_as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


@click.group(cls=Group, epilog=EPILOG)
def command() -> None:
    """Show the estimators of mass and grade, with their sources and options."""


@command.command(name="list", epilog=EPILOG)
@_as_json
def list_(as_json: bool) -> None:
    """List every estimator, those of other packages too."""
    from canest.estimators import registry
    from canest.estimators.description import PAPERS

    found = [registry.describe(name) for name in registry.names()]
    skipped = registry.skipped()
    if as_json:
        described = [_described(d) for d in found]
        _print_json({"estimators": described, "papers": PAPERS, "skipped": skipped})
        return
    table = _table("name", "method", "source", "needs")
    for d in found:
        table.add_row(d.name, d.text, d.source, ", ".join(d.needs))
    console = _console()
    console.print(table)
    for year, title in PAPERS.items():
        console.print(f"{year}: {title}", soft_wrap=True, markup=False)
    for name, reason in skipped.items():
        console.print(f"{name} is left out: {reason}", soft_wrap=True, markup=False)


@command.command(epilog=EPILOG)
@click.argument("name")
@_as_json
def show(name: str, as_json: bool) -> None:
    """Print what the estimator NAME is, every option of it, and the constants of its method."""
    from canest.estimators import registry
    from canest.estimators.description import PAPERS, constant_rows, option_rows, shown

    registry.require_known(name, where="canest estimators show")
    found = registry.describe(name)
    rows = list(option_rows(found.options))
    constants = list(constant_rows(registry.estimator_class(name).constants))
    if as_json:
        presets = {key: dict(values) for key, values in found.options.presets.items()}
        options = [row._asdict() for row in rows]
        of_method = [row._asdict() for row in constants]
        _print_json({**_described(found), "presets": presets, "options": options, "constants": of_method})
        return
    console = _console()
    for line in (
        f"{found.name}: {found.text}",
        f"source: {found.source}",
        *(f"  {year}: {title}" for year, title in PAPERS.items() if year in found.source),
        f"needs: {', '.join(found.needs)}",
        f"presets: {', '.join(found.presets) or 'none'}",
    ):
        console.print(line, soft_wrap=True, markup=False)
    if rows:
        table = _table("option", "default", "unit", "allowed", "meaning")
        for row in rows:
            table.add_row(row.name, shown(row.default), row.unit, row.allowed, row.text)
        console.print(table)
    else:
        console.print("options: none")
    if constants:
        table = _table("symbol", "constant", "value", "unit", "source")
        for c in constants:
            table.add_row(c.symbol, c.name, f"{c.value:g}", c.unit, c.source)
        console.print(table)


def _described(d: Description) -> dict[str, Any]:
    return {
        "name": d.name,
        "text": d.text,
        "source": d.source,
        "needs": list(d.needs),
        "presets": list(d.presets),
    }


def _console() -> Any:
    return terminal.console(highlight=False, width=None if sys.stdout.isatty() else _FILE_WIDTH)


def _table(*columns: str) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, no_wrap=i == 0)
    return table


def _print_json(value: Any) -> None:
    import json

    click.echo(json.dumps(value, indent=2, ensure_ascii=False))
