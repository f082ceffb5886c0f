"""`canest config`, options given twice, and how an extra is installed."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import click
import pytest
import yaml

from canest.cli.main import COMMANDS
from canest.system.installation import command
from canest.system.shipped_files import shipped


def test_a_shipped_config_is_printed_as_it_is(canest):
    assert canest("config", "show", "class8").out == (shipped("configs") / "class8.yaml").read_text()
    assert canest("config", "show", "class8.yaml").out == canest("config", "show", "class8").out


def test_without_a_name_the_names_are_listed(canest):
    done = canest("config", "show")
    assert done.code == 0
    assert done.out.split() == sorted(path.stem for path in shipped("configs").glob("*.yaml"))


@pytest.mark.parametrize(
    ("name", "words"), [("klass8", "perhaps class8"), ("xyz", "one of bmw-i3, class8, ")]
)
def test_an_unknown_name_is_refused_with_the_names_there_are(canest, name, words):
    done = canest("config", "show", name)
    assert done.code == 2 and words in done.err and "class8-j1587" in done.err


def test_the_schema_describes_every_key_that_holds_a_value(canest):
    schema = json.loads(canest("config", "schema").out)
    models = schema["$defs"]

    def described(section):
        for name, value in section["properties"].items():
            inner = value.get("$ref") or next(
                (o["$ref"] for o in value.get("anyOf", ()) if "$ref" in o), None
            )
            if "description" in value:
                continue
            assert inner is not None, name
            described(models[inner.rpartition("/")[2]])

    described(schema)
    assert schema["properties"]["signals"]["properties"]["engine_speed"]["description"]
    assert models["Vehicle"]["properties"]["wheel_radius_m"]["exclusiveMaximum"] == 2
    assert "canest" in models["EstimatorSection"]["properties"]["name"]["enum"]


def _with_text_keys(value):
    """Return what JSON can say: an editor takes the key 1 as "1"."""
    if isinstance(value, dict):
        return {str(key): _with_text_keys(inner) for key, inner in value.items()}
    return [_with_text_keys(inner) for inner in value] if isinstance(value, list) else value


@pytest.mark.parametrize("path", sorted(shipped("configs").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_schema_takes_the_shipped_configs_and_refuses_a_misspelt_key(canest, path):
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(json.loads(canest("config", "schema").out))
    config = _with_text_keys(yaml.safe_load(path.read_text()))
    assert list(validator.iter_errors(config)) == []
    config["vehicle"]["wheel_radius"] = 0.5
    assert len(list(validator.iter_errors(config))) == 1


def options_with_a_value():
    """Yield (words of a command, option) of every option of every command that takes one value."""

    def walk(found, words):
        if isinstance(found, click.Group):
            for name, inner in found.commands.items():
                yield from walk(inner, [*words, name])
            return
        for option in found.params:
            if isinstance(option, click.Option) and not (option.multiple or option.is_flag or option.count):
                yield words, option

    for name, (module, _) in COMMANDS.items():
        yield from walk(import_module(f"canest.cli.{module}").command, [name])


@pytest.mark.parametrize(("words", "option"), list(options_with_a_value()), ids=lambda value: str(value)[:40])
def test_an_option_given_twice_is_refused(canest, words, option):
    values = [str(n) for n in range(1, option.nargs + 1)]
    done = canest(*words, option.opts[0], *values, option.opts[-1], *values)
    assert done.code == 2
    assert f"option given twice, found {'/'.join(option.opts)} 2 times, expected once" in done.err


def test_the_form_with_an_equals_sign_counts_too_and_set_may_be_repeated(canest):
    assert "given twice" in canest("check", "--config=class8", "-c", "vcan").err
    assert canest("check", "-c", "class8", "--set", "filter.order=1", "--set", "filter.cutoff_hz=1").code == 0


FOLDER = {"url": "file:///home/me/my%20canest", "dir_info": {}}


@pytest.mark.parametrize(
    ("origin", "marker", "expected"),
    [
        ({}, "", "pip install 'canest[report]'"),
        (FOLDER, "", "pip install '.[report]' in /home/me/my canest"),
        (
            {**FOLDER, "dir_info": {"editable": True}},
            "",
            "pip install -e '.[report]' in /home/me/my canest",
        ),
        (
            {"url": "file:///tmp/canest-0.1.0-py3-none-any.whl", "archive_info": {}},
            "",
            "pip install 'canest[report] @ file:///tmp/canest-0.1.0-py3-none-any.whl'",
        ),
        (
            {"url": "https://host/canest.git", "vcs_info": {"vcs": "git", "commit_id": "abc"}},
            "",
            "pip install 'canest[report] @ git+https://host/canest.git@abc'",
        ),
        ({}, "pipx_metadata.json", "pipx install --force 'canest[report]'"),
        ({}, "uv-receipt.toml", "uv tool install --force 'canest[report]'"),
    ],
)
def test_how_an_extra_is_added_fits_how_canest_was_installed(
    tmp_path: Path, origin: dict[str, object], marker: str, expected: str
) -> None:
    if marker:
        (tmp_path / marker).write_text("")
    assert command("report", origin, tmp_path) == expected
