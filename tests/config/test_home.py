"""A user without a home, as in a container whose number has no entry."""

from __future__ import annotations

from pathlib import Path

import pytest

from canest.config import load_config
from canest.config.state_directory import state_dir
from canest.core.errors import ConfigError
from canest.telemetry.status_socket import find_sockets


@pytest.fixture(autouse=True)
def nobody(monkeypatch):
    def homeless(path):
        if path.parts[:1] == ("~",):
            raise RuntimeError("Could not determine home directory.")
        return path

    monkeypatch.setattr(Path, "expanduser", homeless)


def test_where_state_lives_must_be_given(tmp_path):
    with pytest.raises(ConfigError, match=r"service.state_dir: is not given.* STATE_DIRECTORY or HOME"):
        state_dir(load_config("class8"), {})
    assert state_dir(load_config("class8"), {"STATE_DIRECTORY": str(tmp_path)}) == tmp_path


def test_daemons_are_looked_for_elsewhere():
    assert isinstance(list(find_sockets({})), list)
