"""The pipeline takes its databases as objects: what is on the disk by then does not matter."""

from __future__ import annotations

import builtins
import io
import os
import pickle
from pathlib import Path
from typing import Any

import pytest

from canest.config import load_config, parse_config, read_databases
from canest.core.errors import ConfigError
from canest.pipeline.pipeline import Pipeline
from canest.system.shipped_files import shipped


@pytest.fixture
def no_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nobody open, read or look at a file."""

    def refused(*arguments: Any, **_: Any) -> Any:
        raise AssertionError(f"a file is opened: {arguments}")

    for holder, name in (
        (builtins, "open"), (io, "open"), (os, "open"), (os, "stat"), (Path, "open"), (Path, "stat"),
        (Path, "is_file"), (Path, "read_bytes"), (Path, "read_text"),
    ):  # fmt: skip
        monkeypatch.setattr(holder, name, refused)


@pytest.mark.parametrize("name", ["class8", "testcar"])
def test_a_pipeline_is_built_without_opening_a_file(name: str, request: pytest.FixtureRequest) -> None:
    config = load_config(name)
    Pipeline(config)  # the estimator's modules are files too
    request.getfixturevalue("no_files")
    assert Pipeline(config).decoder.databases == config.databases != []


def test_a_rebuilt_pipeline_does_not_depend_on_a_file_that_somebody_replaces(tmp_path: Path) -> None:
    (tmp_path / "own.dbc").write_text((shipped("dbc") / "j1939.dbc").read_text())
    (tmp_path / "truck.yaml").write_text(
        (shipped("configs") / "class8.yaml").read_text().replace("j1939.dbc", "own.dbc")
    )
    config = load_config(tmp_path / "truck.yaml")
    first = Pipeline(config)
    (tmp_path / "own.dbc").write_text("half of it is")
    assert Pipeline(config).decoder.databases == first.decoder.databases
    with pytest.raises(ConfigError, match=r"own\.dbc: (not a readable database|database without)"):
        load_config(tmp_path / "truck.yaml")


def test_a_config_made_by_hand_is_given_its_databases() -> None:
    config = parse_config((shipped("configs") / "class8.yaml").read_text(), "truck.yaml")
    with pytest.raises(ConfigError, match=r"^truck\.yaml:\d+: dbc: its databases have not been read, exp"):
        Pipeline(config)
    given = config.with_databases(load_config("class8").databases)
    assert given == config and Pipeline(given).decoder.pgns == Pipeline(read_databases(config)).decoder.pgns
    with pytest.raises(ConfigError, match="have not been read"):
        Pipeline(given.model_copy(update={"dbc": ("canest.dbc",)}))


def test_a_table_needs_no_database() -> None:
    text = (shipped("configs") / "bmw-i3.yaml").read_text().replace("dbc: []", "dbc: [j1939.dbc]")
    assert Pipeline(parse_config(text)).decoder.databases == []


def test_another_process_reads_the_databases_anew() -> None:
    config = load_config("class8")
    sent = pickle.loads(pickle.dumps(config))
    assert sent == config
    with pytest.raises(ConfigError, match="have not been read"):
        Pipeline(sent)
    assert read_databases(sent).databases == config.databases


def test_who_decodes_nothing_needs_no_database() -> None:
    with pytest.raises(ConfigError, match=r"dbc\.0: no such dbc file, found 'gone\.dbc'"):
        load_config("class8", ["dbc=[gone.dbc]"])
    assert load_config("class8", ["dbc=[gone.dbc]"], databases=False).dbc == ("gone.dbc",)
