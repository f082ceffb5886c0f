"""What a command may load: a set of modules, since a time depends on the machine."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fresh_interpreter import output_of

KENWORTH = Path(__file__).parents[1] / "data" / "kenworth" / "normal.log.xz"

#: what the help of any command needs
HELP = {
    "canest",
    "canest.cli",
    "canest.cli.main",
    "canest.cli.repeated_options",
    "canest.core",
    "canest.core.errors",
    "canest.system",
    "canest.system.terminal",
}
HEAVY = {"dataclasses", "pathlib", "numpy", "pydantic", "yaml", "rich", "cantools", "numba"}


def loaded_by(*arguments: str) -> set[str]:
    code = (
        "import sys\n"
        "from canest.cli.main import main\n"
        "try:\n"
        f"    main({list(arguments)!r})\n"
        "except SystemExit as ended:\n"
        "    assert not ended.code\n"
        "print('MODULES', *sys.modules)\n"
    )
    return set(output_of(code).split("MODULES ")[-1].split())


def own(modules: set[str]) -> set[str]:
    return {name for name in modules if name.split(".")[0] == "canest"}


@pytest.mark.parametrize(
    ("arguments", "more"),
    [
        (["--help"], set()),
        (["replay", "--help"], {"canest.cli.options", "canest.cli.replay", "canest.core.masses"}),
    ],
)
def test_help_loads_the_command_line_alone(arguments, more):
    modules = loaded_by(*arguments)
    assert own(modules) == HELP | more
    assert modules & HEAVY == set()


def test_a_replay_of_a_vehicle_without_effects_loads_none():
    modules = own(loaded_by("replay", str(KENWORTH), "-c", "kenworth"))
    assert {name for name in modules if name.startswith("canest.vehicle.effects")} == set()


def test_a_replay_loads_no_other_commands_packages():
    rooms = {
        ".".join(name.split(".")[:2]) for name in own(loaded_by("replay", str(KENWORTH), "-c", "kenworth"))
    }
    unused = {"simulation", "diagnosis", "demo", "interface", "live", "node", "telemetry", "report", "api"}
    assert rooms & {f"canest.{room}" for room in unused} == set()


def test_a_replay_never_loads_scipy():
    modules = loaded_by("replay", str(KENWORTH), "-c", "kenworth")
    assert {name for name in modules if name.split(".")[0] == "scipy"} == set()


def test_the_daemon_never_loads_scipy():
    code = "import sys, canest.live.daemon, canest.cli.run; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert not {name for name in done.stdout.split() if name.split(".")[0] == "scipy"}
