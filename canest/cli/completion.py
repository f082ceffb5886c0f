"""What the Tab key offers for an option's value: names of files, shipped configs, scenarios, estimators."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem

#: metavar -> what is completed; others have values that nobody can guess
_KINDS = {
    "LOG": "file", "LOG...": "file", "[LOG]": "file", "PATH": "file", "HTML": "file", "CSV": "file",
    "FILE": "file", "SOURCE": "file", "LAKE": "dir", "DIR": "dir", "CONFIG": "config", "SCENARIO": "scenario",
}  # fmt: skip
_NAMES = {("config", "name"): "config", ("estimators", "name"): "estimator"}


class _Completed(click.types.StringParamType):
    """A text, completed by its ``kind``."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the names that begin so; the shell looks for files where there is none."""
        names = [CompletionItem(name) for name in _names(self._kind) if name.startswith(incomplete)]
        if names or self._kind == "estimator":
            return names
        return [CompletionItem(incomplete, type="dir" if self._kind == "dir" else "file")]


def complete_values(command: click.Command) -> click.Command:
    """Give the command's options and arguments what completes them, and return it."""
    for below in command.commands.values() if isinstance(command, click.Group) else ():
        if below.name == "show":
            for parameter in below.params:
                kind = _NAMES.get((command.name or "", parameter.name or ""))
                parameter.type = _Completed(kind) if kind else parameter.type
        complete_values(below)
    for parameter in command.params:
        kind = _KINDS.get(parameter.metavar or "")
        if kind and isinstance(parameter.type, click.types.StringParamType):
            parameter.type = _Completed(kind)
    return command


def _names(kind: str) -> list[str]:
    if kind == "config":
        from canest.system.shipped_files import shipped

        return sorted(path.stem for path in shipped("configs").glob("*.yaml"))
    if kind == "scenario":
        from canest.simulation.reading import shipped_scenarios

        return list(shipped_scenarios())
    if kind == "estimator":
        from canest.estimators.registry import BUILT_IN

        return list(BUILT_IN)
    return []
