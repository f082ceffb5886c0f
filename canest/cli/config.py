"""`canest config`: the configs that ship, and the schema of all of them for editors."""

from __future__ import annotations

import click

from canest.cli.repeated_options import Group

EPILOG = """\b
Examples:
  canest config show                        the names of the configs that ship
  canest config show class8 > my-truck.yaml
  canest config schema > canest.schema.json
"""


@click.group(cls=Group, epilog=EPILOG)
def command() -> None:
    """Print a shipped config to begin with, or the JSON Schema of configs for an editor."""


@command.command()
@click.argument("name", required=False)
def show(name: str | None) -> None:
    """Print the shipped config NAME; without NAME, the names there are."""
    from canest.core.errors import UsageError
    from canest.core.nearest_name import expected_name
    from canest.system.shipped_files import shipped

    files = {path.stem: path for path in shipped("configs").glob("*.yaml")}
    names = sorted(files)
    if name is None:
        click.echo("\n".join(names))
        return
    file = files.get(name.removesuffix(".yaml"))
    if file is None:
        expected = expected_name(name, names, f"one of {', '.join(names)}")
        raise UsageError("no such shipped config", where="canest config show", found=name, expected=expected)
    click.echo(file.read_text(encoding="utf-8"), nl=False)


@command.command()
def schema() -> None:
    """Print the JSON Schema of a config, for editors (see docs/config.md)."""
    import json

    from canest.config.json_schema import json_schema

    click.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))
