"""`canest install-service`: prints or installs the systemd unit."""

from __future__ import annotations

from pathlib import Path

import click

from canest.cli.options import config_option, load

EPILOG = """\b
Examples:
  canest install-service                                   print the unit
  sudo canest install-service --install -c my-truck.yaml   as canest@my-truck
  sudo canest install-service --install -c my-truck.yaml --name bus1
"""


@click.command(epilog=EPILOG)
@click.option("--install", "write", is_flag=True, help="Write the unit to /etc/systemd/system.")
@config_option(required=False)
@click.option("--name", metavar="NAME", help="Name of the instance (default: the config's).")
@click.option("--root", metavar="DIR", default="/", help="Install below this directory (for images).")
@click.option("--force", is_flag=True, help="Overwrite a unit that was edited (configs are kept anyway).")
def command(write: bool, config_name: str | None, name: str | None, root: str, force: bool) -> None:
    """Print the systemd unit, or install it together with a config."""
    from canest.live.install import databases_of, install, unit_text

    if config_name is not None:
        from canest.pipeline.pipeline import Pipeline

        Pipeline(load(config_name))  # a config that is refused must not become a service
    if not write:
        print(unit_text(), end="")
        return
    path, databases = None, {}
    if config_name is not None:
        from canest.system.shipped_files import find

        path = find("configs", config_name)
        databases = databases_of(path)
    done = install(path, name, Path(root), databases, force=force)
    for written in done.written:
        print(f"written  {written}")
    for note in done.notes:
        print(note)
    if done.config is not None:
        Pipeline(load(str(done.config)))  # one that was there before may be refused
