"""Groups of commands that refuse an option given twice: which of two configs was meant, nobody can know."""

from __future__ import annotations

from collections import Counter

import click


class Group(click.Group):
    """A group whose commands take each option with a value once, those made to be repeated excepted."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, and look through its options. Errors: UsageError."""
        name, command, rest = super().resolve_command(ctx, args)
        # the Tab key asks about a line that is not complete yet
        if command is not None and not isinstance(command, click.Group) and not ctx.resilient_parsing:
            _refuse_repeated(command, click.Context(command, ctx, name), rest)
        return name, command, rest


def _refuse_repeated(command: click.Command, ctx: click.Context, args: list[str]) -> None:
    _, _, order = command.make_parser(ctx).parse_args(args=list(args))
    options = [p for p in order if isinstance(p, click.Option)]
    given = Counter(o for o in options if not (o.multiple or o.is_flag or o.count))
    for option, times in given.items():
        if times > 1:
            names = "/".join(option.opts)
            raise click.UsageError(f"option given twice, found {names} {times} times, expected once", ctx)
