"""The `canest` command: finds the subcommand, runs it, turns every failure into one line and an exit code."""

from __future__ import annotations

import gc
import io
import os
import sys
from importlib import import_module
from typing import Any

import click

from canest import __version__
from canest.cli.repeated_options import Group

#: command -> (module below `canest.cli`, what it does); a module is imported when its command is called
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "See mass and grade settle on a bundled drive; needs no hardware."),
    "check": ("check", "Check a config against a log or a bus, signal by signal."),
    "run": ("run", "Estimate live on a CAN bus and put the result back on it."),
    "replay": ("replay", "Estimate from recorded logs, as fast as they can be read."),
    "compare": ("compare", "Run every estimator on one log and compare it with the truth."),
    "estimators": ("estimators", "Show the estimators there are, and their options."),
    "diagnose": ("diagnose", "Find what the vehicle model lacks in measured data, and add it."),
    "fleet": ("fleet", "Replay thousands of logs of many vehicles into tables, and report on them."),
    "map": ("map", "Fuse the grade of roads from many drives into a map."),
    "simulate": ("simulate", "Make a log with known truth from a scenario."),
    "status": ("status", "Show how a running daemon is doing."),
    "monitor": ("monitor", "Watch mass and grade live, from the broadcast alone."),
    "publish": ("publish", "Hand a running daemon's estimates to MQTT, Foxglove or KUKSA."),
    "serve": ("serve", "Show a running daemon live in a browser."),
    "config": ("config", "Print a shipped config, or the JSON Schema of configs."),
    "install-service": ("install", "Print or install the systemd unit."),
}

OK, FAILED = 0, 1

#: more than a replay makes, with numba and all (200,000): each look costs it 35 ms and finds next to nothing
_OBJECTS_BETWEEN_COLLECTIONS = 300_000
#: of the frame of `run`, 256 KB: it is put into 512 KB, of which no more memory is used than is written to
_SLOTS_OF_FRAME = 256 * 1024 // 8


class _LazyGroup(Group):
    """Knows the commands' names and one-line texts without importing any of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"canest.cli.{COMMANDS[cmd_name][0]}").command
        command.name = cmd_name
        if "_CANEST_COMPLETE" in os.environ:  # the shell asks, on behalf of the Tab key
            from canest.cli.completion import complete_values

            complete_values(command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            from difflib import get_close_matches

            near = get_close_matches(args[0], COMMANDS, n=1)
            hint = f"a command, perhaps {near[0]}" if near else f"one of {', '.join(COMMANDS)}"
            raise click.UsageError(f"no such command, found '{args[0]}', expected {hint}", ctx)
        return super().resolve_command(ctx, args)


EPILOG = """\b
Start here:
  canest demo                                         a drive, live, in half a minute
  canest check -c class8 drive.log                    does this config fit this truck?
  canest replay drive.log -c my-truck.yaml -o est.csv
  canest run -c my-truck.yaml                         the daemon

Errors are one line; add --debug to any command for the traceback.
"""


@click.group(
    cls=_LazyGroup,
    epilog=EPILOG,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, "-V", "--version", prog_name="canest")
@click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")
def cli() -> None:
    """Estimate a vehicle's mass and the road grade at 50 Hz from its CAN bus, live or from logs."""


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 2 bad usage or config, 1 anything else."""
    # threads of OpenBLAS cost 50 to 200 ms of start-up, and nothing here multiplies large matrices
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # nothing here has plugins for pydantic: looking for them reads every installed package's metadata
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # start-up makes objects by the hundred thousand and hardly any garbage: look for it less often
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    _have_streams()
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments
    code = run([a for a in arguments if a != "--debug"], debug)
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _forget_stdout()
    gc.freeze()  # all that is left goes with the process: looking for garbage in it takes 60 ms
    sys.exit(code)


def run(arguments: list[str], debug: bool = False) -> int:
    """Run the command line and return its exit code; failures are printed on stderr."""
    try:
        result: Any = cli.main(args=arguments, prog_name="canest", standalone_mode=False)
        return result if isinstance(result, int) else OK
    except click.exceptions.Exit as done:
        return done.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message(), file=sys.stderr)
        return error.exit_code
    except (click.exceptions.Abort, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
        return FAILED
    # the reader has closed the pipe: click and rich raise these for it, and no command exits by itself
    except (BrokenPipeError, SystemExit):
        _forget_stdout()
        return OK
    except Exception as error:
        if debug:
            import traceback

            traceback.print_exc()
        return _report(error, debug)


# CPython maps 16 KB for the frames of functions, 16 KB more where they are full, and unmaps them as soon as
# they are left: a loop whose calls cross such a border takes 8 us more for each (it was a tenth of a short
# replay). A frame that is larger comes with room for all that are called from it.
run.__code__ = run.__code__.replace(co_stacksize=_SLOTS_OF_FRAME)


def _report(error: Exception, debug: bool) -> int:
    from canest.core.errors import CanestError

    hint = "" if debug else " (--debug shows where)"
    if isinstance(error, CanestError):
        line, code = str(error), error.exit_code
    elif isinstance(error, click.ClickException):
        where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "canest"
        line, code = f"{where}: {error.format_message()} (see {where} --help)", error.exit_code
    elif isinstance(error, MemoryError):
        line, code = "out of memory", FAILED
    elif isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        line, code = f"{where}{error.strerror or error}{hint}", FAILED
    else:
        line, code = f"unexpected {type(error).__name__}: {error}{hint}", FAILED
    print("error: " + " ".join(line.split()), file=sys.stderr)
    return code


def _have_streams() -> None:
    """Write to nothing where a stream is closed, and what an encoding lacks as '?': no work is lost by it.

    What steers a terminal is shown instead: names of files, keys and logs hold anything.
    """
    from canest.system.terminal import EscapingStream

    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            # as long as the process, and `pathlib` would be a tenth of what --help costs
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, PTH123
        # what else an encoding may do with it is to give back the bytes of a file's name, as UTF-8 can
        elif isinstance(stream, io.TextIOWrapper) and (
            stream.errors == "strict" or not stream.encoding.lower().startswith("utf")
        ):
            stream.reconfigure(errors="replace")
        setattr(sys, name, EscapingStream(getattr(sys, name)))


def _forget_stdout() -> None:
    """Point stdout at nothing, so that the interpreter does not complain about it at its exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
