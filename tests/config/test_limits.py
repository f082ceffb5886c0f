"""Configs and databases that would take minutes, gigabytes or the C stack are refused at once."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from canest.config import load_config, parse_config
from canest.config.limits import MOST_BYTES, MOST_LEVELS, MOST_VALUES
from canest.core.errors import ConfigError
from canest.system.shipped_files import shipped

TRUCK = (shipped("configs") / "class8.yaml").read_text()


def refused(text: str, *overrides: str) -> str:
    begin = time.monotonic()
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "truck.yaml", overrides)
    assert time.monotonic() - begin < 5
    assert len(str(caught.value)) < 300
    return str(caught.value)


def bomb(width: int, entry: str) -> str:
    """Each line repeats the one before ``width`` times."""
    lines = (f"a{i}: &a{i} {entry.format(', '.join([f'*a{i - 1}'] * width))}" for i in range(1, 12))
    return "\n".join(["a0: &a0 {x: 1}", *lines])


@pytest.mark.parametrize(
    "text",
    ["a: " + "[" * 100_000 + "]" * 100_000, "a: " + "{b: " * 50_000, "a:\n " + "- " * 50_000],
    ids=["lists", "sections", "entries"],
)
def test_brackets_without_end_are_refused_and_do_not_crash_the_process(text: str, tmp_path: Path) -> None:
    """In a process of its own: libyaml's recursion ended it with SIGSEGV."""
    path = tmp_path / "deep.yaml"
    path.write_text(text)
    command = [sys.executable, "-m", "canest", "check", "-c", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert f"nested too deeply, expected at most {MOST_LEVELS} levels" in done.stderr


@pytest.mark.parametrize("entry", ["{{<<: [{}]}}", "[{}]"])
def test_a_small_file_whose_aliases_multiply_is_refused(entry: str) -> None:
    assert "too many keys and values" in refused(bomb(9, entry))


def test_more_aliases_than_anybody_writes_are_refused() -> None:
    assert "too many aliases" in refused("a: &a 1\nb: [" + "*a, " * 101 + "]")


@pytest.mark.parametrize(
    "text", ["a: &a {b: 1, <<: *a}", "a: &s [{b: 1, <<: *s}, {c: 1, <<: *s}]", "&a {k: {<<: [*a, *a]}}"]
)
def test_a_mapping_that_merges_what_holds_it_is_refused(text: str) -> None:
    assert "alias to what holds it" in refused(text)


def test_half_a_million_unknown_keys_are_refused_by_the_size_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "keys.yaml"
    path.write_text(TRUCK + "\n".join(f"k{i}: 1" for i in range(500_000)))
    with pytest.raises(ConfigError, match=r"keys\.yaml: too large, found 'more than 256 kB'"):
        load_config(path)
    assert "too large" in refused("#" * (MOST_BYTES + 1))


def test_too_many_keys_in_a_small_file_are_refused_with_the_line_where_they_become_too_many() -> None:
    assert refused("\n".join(f"k{i}: 1" for i in range(MOST_VALUES))).startswith(
        f"truck.yaml:{MOST_VALUES // 2}: "
    )


def test_a_value_of_thousands_of_characters_is_refused_and_a_long_one_is_shown_cut() -> None:
    assert "key or value too long, found '4,000 characters'" in refused("a: " + "9" * 4000)
    assert "..., expected a number" in refused(
        TRUCK.replace("mass_min_kg: 7000", "mass_min_kg: 0x" + "f" * 3400)
    ).replace("...'", "...")


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("effects=" + "[" * 100_000, "--set effects:1: nested too deeply"),
        (
            "effects=[&a [" + "1," * 1000 + "]," + "*a," * 50 + "]",
            "--set effects:1: too many keys and values",
        ),
        ("filter.order=" + "9" * 5000, "--set filter.order:1: key or value too long"),
        ("a." * 100_000 + "b=1", "--set: nested too deeply"),
    ],
)
def test_values_of_the_command_line_pass_the_same_limits(override: str, words: str) -> None:
    assert words in refused(TRUCK, override)


def test_anchors_and_merges_as_people_write_them_are_kept() -> None:
    text = "common: &c {enabled: true}\n" + TRUCK
    assert "common: unknown key" in refused(text)
    text = TRUCK + "\ngates:\n  brake: &b {recovery_s: 2}\n  retarder: {<<: *b, enabled: false}\n"
    gates = parse_config(text).gates
    assert gates.retarder.recovery_s == 2 and not gates.retarder.enabled


HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A\n\n'
MESSAGE = 'BO_ {} M{}: {} A\n SG_ X M : 0|8@1+ (1,0) [0|1] "" A\n SG_ S m0 : {} (1,0) [0|1] "" A\n\n'


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (MESSAGE.format(1, 1, 10**9, "8|8@1+"), ":9: message too long, found '1,000,000,000 bytes'"),
        (MESSAGE.format(1, 1, 8, "8|1000000000@1+"), ":11: signal outside any message"),
        (MESSAGE.format(1, 1, 8, "1000000000|8@1+"), ":11: signal outside any message"),
        (
            MESSAGE.format(1, 1, 8, "8|8 @ 1+").replace("|", " |\n 9" + "9" * 5000 + " "),
            "signal outside any message",
        ),
        ("".join(MESSAGE.format(i, i, 4096, "8|8@1+") for i in range(1, 100)), "too long altogether"),
        (
            MESSAGE.format(1, 1, 8, "8|8@1+") + "SG_MUL_VAL_ 1 S X 0-4294967295;\n",
            "too many multiplexer values",
        ),
        (" " * (16 * 1024 * 1024), "database too large"),
    ],
)
def test_a_database_of_absurd_numbers_is_refused_before_anything_is_made_of_it(
    content: str, words: str, tmp_path: Path
) -> None:
    from canest.config.database_files import read_database

    path = tmp_path / "absurd.dbc"
    path.write_text(HEAD + content)
    begin = time.monotonic()
    with pytest.raises(ConfigError) as caught:
        read_database(path)
    assert time.monotonic() - begin < 10
    assert words in str(caught.value)


def test_the_text_of_a_comment_is_no_message(tmp_path: Path) -> None:
    from canest.config.database_files import read_database

    path = tmp_path / "comment.dbc"
    path.write_text(HEAD + MESSAGE.format(1, 1, 8, "8|8@1+") + 'CM_ "BO_ 2 M2: 99999999 A";\n')
    assert [m.name for m in read_database(path).messages] == ["M1"]
