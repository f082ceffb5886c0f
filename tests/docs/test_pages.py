"""README and docs are correct: commands run, options exist, links lead somewhere, tables are complete."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: commands.md is made from the help of the commands, with its usage lines and comments
PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").glob("*.md") if p.name != "commands.md")]
COMMAND = re.compile(r"^ *(?:\$ )?canest +(.+)$", re.MULTILINE)
TESTED = re.compile(r"<!-- tested -->\n```sh\n(.*?)```", re.DOTALL)


@pytest.fixture(autouse=True)
def tools_import_each_other(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tools")


def command_lines() -> list[tuple[str, str]]:
    lines = []
    for page in PAGES:
        blocks = re.findall(
            r"^```(?:sh|bash)?\n(.*?)^```|((?:^ {4,}\S.*\n)+)", page.read_text(), re.DOTALL | re.M
        )
        for fenced, indented in blocks:
            found = COMMAND.findall(fenced or indented)
            lines += [(page.name, line.split("  #")[0].strip()) for line in found]
    return lines


LINES = command_lines()


def test_pages_show_commands():
    assert len(LINES) >= 12


@pytest.mark.parametrize(("page", "line"), LINES, ids=lambda value: value[:40])
def test_every_command_shown_is_one_that_exists(page, line):
    from canest.cli.main import cli

    words = shlex.split(line)
    with cli.make_context("canest", list(words), resilient_parsing=True) as group:
        name, command, arguments = cli.resolve_command(group, words)
        with command.make_context(name, arguments, parent=group):
            pass


@pytest.mark.parametrize("page", [p for p in PAGES if TESTED.search(p.read_text())], ids=lambda p: p.name)
def test_blocks_marked_as_tested_run(page, tmp_path):
    commands = tmp_path / "bin"
    commands.mkdir()
    script = commands / "canest"
    script.write_text(
        f'#!/bin/sh\nPYTHONPATH={shlex.quote(str(ROOT))} exec {sys.executable} -m canest "$@"\n'
    )
    script.chmod(0o755)
    environment = os.environ | {"PATH": f"{commands}:{os.environ['PATH']}", "HOME": str(tmp_path)}
    for block in TESTED.findall(page.read_text()):
        done = subprocess.run(
            ["sh", "-eu", "-c", block], cwd=tmp_path, env=environment, capture_output=True, text=True,
            timeout=300, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr + done.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
        if not target.startswith(("http:", "https:")):
            assert (page.parent / target).exists(), target


def test_config_page_is_made_from_the_schema():
    tool = runpy.run_path(str(ROOT / "tools" / "config_page.py"))
    assert tool["PAGE"].read_text() == tool["page"](), "python tools/config_page.py --write"


def test_every_column_of_the_model_is_on_its_page_and_in_the_help():
    from canest.cli.replay import command
    from canest.offline.extra_columns import COLUMNS

    text = (ROOT / "docs" / "outputs.md").read_text()
    rows = "\n".join(f"| `{name}` | {column.meaning} |" for name, column in COLUMNS.items())
    assert f"|---|---|\n{rows}\n<!-- end of the columns -->" in text
    (option,) = (option for option in command.params if option.name == "columns")
    assert ", ".join(COLUMNS) in option.help


def test_road_map_page_has_the_columns_of_the_map():
    from canest.road.table import COLUMNS

    text = (ROOT / "docs" / "road_map.md").read_text()
    rows = "\n".join(f"| `{name}` | {meaning} |" for name, meaning in COLUMNS.items())
    assert f"|---|---|\n{rows}\n<!-- end of the map -->" in text


def test_fleet_page_has_the_columns_of_the_tables():
    tool = runpy.run_path(str(ROOT / "tools" / "fleet_page.py"))
    assert tool["PAGE"].read_text() == tool["page"](), "python tools/fleet_page.py --write"


def test_every_key_is_described_and_no_other():
    from canest.config.meanings import MEANINGS, meaning

    tool = runpy.run_path(str(ROOT / "tools" / "config_page.py"))
    from canest.config.schema import Config
    from canest.config.sections import Source

    known = {key for key, _, _ in tool["keys"](Config)}
    for key in known:
        assert meaning(key)
    assert {key for key in MEANINGS if "*" not in key} <= known
    assert set(tool["SOURCE_MEANINGS"]) == set(Source.model_fields)


def test_every_estimator_and_command_has_its_line():
    from canest.cli.main import COMMANDS
    from canest.estimators.registry import BUILT_IN

    estimators = (ROOT / "docs" / "estimators.md").read_text()
    assert [name for name in BUILT_IN if f"`{name}`" not in estimators] == []
    readme = (ROOT / "README.md").read_text()
    assert [name for name in COMMANDS if f"canest {name}" not in readme] == []


def test_every_extra_has_its_row_in_the_readme():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    readme = (ROOT / "README.md").read_text()
    assert [name for name in extras if f"\n| `{name}` | " not in readme] == []


def test_the_readme_prints_what_its_commands_print():
    """To a kilogram and 0.02 %, since processors round differently."""
    import canest

    readme = (ROOT / "README.md").read_text()
    drive = canest.simulate("pulse-21t")
    shown = canest.replay(drive, drive.config, truth=drive.truth).summary
    mass = re.search(r"mass +([\d,]+) \+- ([\d,]+) kg at the end \(valid, .*; (\d+) % of the driving", readme)
    assert mass is not None
    found = shown["mass_kg"], shown["mass_std_kg"], 100.0 * shown["valid_share"]
    assert [float(x.replace(",", "")) for x in mass.groups()] == pytest.approx(found, abs=1.0)
    errors = re.search(
        r"all samples, .*: mass RMS ([\d.]+) %, worst ([\d.]+) %, grade RMS ([\d.]+) deg", readme
    )
    assert errors is not None
    names = ("mass_rms_pct", "mass_max_pct", "grade_rms_deg")
    assert [float(x) for x in errors.groups()] == pytest.approx([shown["errors"][n] for n in names], abs=0.02)


def test_result_columns_in_the_readme_are_the_writers():
    from canest.logs.estimate_writer import HEADER

    assert HEADER.decode().strip() in (ROOT / "README.md").read_text()


def test_every_page_can_be_reached_from_the_readme():
    reached, waiting = set(), {ROOT / "README.md"}
    while waiting:
        page = waiting.pop()
        reached.add(page)
        targets = re.findall(r"\]\(([^)#:]+\.md)(?:#[^)]*)?\)", page.read_text())
        waiting |= {(page.parent / target).resolve() for target in targets} - reached
    assert set((ROOT / "docs").rglob("*.md")) - reached == set()
