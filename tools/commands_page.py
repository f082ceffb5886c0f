"""Writes docs/commands.md, the man pages and the completion files from the commands themselves (``--write``).

Without ``--write`` it prints what is not up to date, and exits with 1.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import click
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete

from canest import __version__
from canest.cli.main import COMMANDS, cli

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "commands.md"
MAN = ROOT / "shell" / "man"
COMPLETION: dict[str, type[ShellComplete]] = {
    "canest.bash": BashComplete,
    "_canest": ZshComplete,
    "canest.fish": FishComplete,
}
FILES_SECTION = [
    ("/etc/canest/NAME.yaml", "config of the service canest@NAME"),
    ("/var/lib/canest/NAME", "what the service has learned"),
    ("/run/canest/NAME", "status socket and metrics of the service"),
]
EXIT_STATUS = [
    ("0", "The command did its work."),
    ("1", "Anything else went wrong."),
    ("2", "The command line or the config is wrong."),
]


def commands() -> Iterator[tuple[str, click.Context]]:
    """Yield ("canest", the group), then every command by its whole name, each within its context."""

    def walk(name: str, context: click.Context) -> Iterator[tuple[str, click.Context]]:
        yield name, context
        command = context.command
        if isinstance(command, click.Group):
            for below in command.list_commands(context):
                inner = command.get_command(context, below)
                assert inner is not None
                made = inner.make_context(below, [], parent=context, resilient_parsing=True)
                yield from walk(f"{name} {below}", made)

    yield from walk("canest", cli.make_context("canest", [], resilient_parsing=True))


def text_of(command: click.Command) -> list[str]:
    """Return the paragraphs of a command's help text."""
    return [" ".join(part.split()) for part in (command.help or "").replace("\b", "").split("\n\n")]


def usage(context: click.Context) -> str:
    """Return what follows the name on a command line."""
    return " ".join(context.command.collect_usage_pieces(context))


def options(context: click.Context) -> list[tuple[str, str]]:
    """Return (option with its value, what it does), as ``--help`` has them."""
    own = [p for p in context.command.get_params(context) if isinstance(p, click.Option)]
    found = [option.get_help_record(context) for option in own]
    return [(flags, " ".join(text.split())) for flags, text in filter(None, found)]


def blocks(command: click.Command) -> list[tuple[str, str, list[str]]]:
    """Return (title, prose, lines as they stand) of each part below the options: examples and more."""
    found = []
    for part in (command.epilog or "").split("\n\n"):
        lines = part.replace("\b", "").strip("\n").split("\n")
        if "\b" not in part:
            found.append(("", " ".join(" ".join(lines).split()), []))
        elif lines[0].endswith(":"):
            found.append((lines[0].removesuffix(":"), "", lines[1:]))
        else:
            found.append(("", "", lines))
    return [block for block in found if any(block)]


def below(command: click.Command) -> list[tuple[str, str]]:
    """Return (name, first sentence) of the commands of a group."""
    if command is cli:
        return [(name, text) for name, (_, text) in COMMANDS.items()]
    if isinstance(command, click.Group):
        return [(name, text_of(inner)[0]) for name, inner in command.commands.items()]
    return []


def page() -> str:
    """Return docs/commands.md."""
    parts = [
        "# Commands",
        "Every command with its options, as `--help` and the man pages show them. "
        "This page is made by\n`python tools/commands_page.py --write`.",
    ]
    for name, context in commands():
        command = context.command
        parts += [f"## {name}", "\n\n".join(text_of(command)), f"```text\n{name} {usage(context)}\n```"]
        if rows := below(command):
            parts.append(_table("command", rows, lambda row, name=name: f"[{row}](#{_anchor(name, row)})"))
        parts.append(_table("option", options(context), lambda flags: f"`{flags}`"))
        for title, prose, lines in blocks(command):
            shown = "\n".join(["```text", *lines, "```"]) if lines else ""
            parts += filter(None, (title and f"{title}:", prose, shown))
    return "\n\n".join(parts) + "\n"


def _anchor(name: str, row: str) -> str:
    return f"{name} {row}".replace(" ", "-")


def _table(head: str, rows: list[tuple[str, str]], shown: Callable[[str], str]) -> str:
    lines = [f"| {head} | what it does |", "|---|---|"]
    for first, text in rows:
        lines.append(f"| {shown(first)} | {_cell(text)} |")
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def man(name: str, context: click.Context) -> str:
    """Return the man page of a command, in the macros of man(7)."""
    command = context.command
    dashed = name.replace(" ", "-")
    paragraphs = text_of(command)
    first = paragraphs[0].removesuffix(".")
    lines = [
        f'.TH {_roff(dashed.upper())} 1 "" "canest {__version__}" "User Commands"',
        ".SH NAME",
        f"{_roff(dashed)} \\- {_roff(first[0].lower() + first[1:])}",
        ".SH SYNOPSIS",
        f".B {_roff(name)}",
        _roff(usage(context)),
        ".SH DESCRIPTION",
        "\n.PP\n".join(_roff(p) for p in paragraphs),
    ]
    if rows := below(command):
        lines += [".SH COMMANDS", *_list((f"{dashed}-{row}(1)", text) for row, text in rows)]
    lines += [".SH OPTIONS", *_list(options(context))]
    for title, prose, block in blocks(command):
        lines += [f".SH {_roff(title.upper() or 'NOTES')}", *filter(None, [_roff(prose)])]
        lines += [".nf", *(_roff(row) for row in block), ".fi"] if block else []
    lines += [".SH EXIT STATUS", *_list(EXIT_STATUS)]
    if name in ("canest", "canest run", "canest install-service"):
        lines += [".SH FILES", *_list(FILES_SECTION)]
    parent = name.rsplit(" ", 1)[0].replace(" ", "-")
    lines += [".SH SEE ALSO", f".BR {_roff(parent)} (1)" if name != "canest" else ".BR candump (1)"]
    return "\n".join(lines) + "\n"


def _list(rows: Iterable[tuple[str, str]]) -> Iterator[str]:
    for term, text in rows:
        yield f".TP\n.B {_roff(term)}\n{_roff(text)}"


def _roff(text: str) -> str:
    text = text.replace("\\", "\\e").replace("-", "\\-").rstrip()
    text = text.replace("'", "\\(aq").replace("…", "...").replace("–", "\\(en").replace("`", "\\(ga")
    return f"\\&{text}" if text.startswith((".", "'")) else text


def files() -> dict[Path, str]:
    """Return every generated file with its content."""
    found = {PAGE: page()}
    for name, context in commands():
        found[MAN / f"{name.replace(' ', '-')}.1"] = man(name, context)
    for file, kind in COMPLETION.items():
        source = kind(cli, {}, "canest", "_CANEST_COMPLETE").source()
        found[ROOT / "shell" / "completion" / file] = source.strip("\n") + "\n"
    return found


def main(arguments: list[str]) -> int:
    """Write the files, or name those that are not up to date."""
    made = files()
    known = set((ROOT / "shell").rglob("*.*")) | set((ROOT / "shell" / "completion").glob("_canest"))
    gone = {path for path in known if path.is_file()} - set(made)
    old = {p for p, text in made.items() if not p.exists() or p.read_text(encoding="utf-8") != text}
    if "--write" not in arguments:
        for path in sorted(old | gone):
            print(f"not up to date, python tools/commands_page.py --write: {path.relative_to(ROOT)}")
        return 1 if old | gone else 0
    for path in gone:
        path.unlink()
    for path in old:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(made[path], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
