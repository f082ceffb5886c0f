"""Where the daemon of a config keeps what it learned."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from canest.config.schema import Config
from canest.core.errors import ConfigError


def state_dir(config: Config, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where learned state lives: the config's, systemd's, or the user's directory.

    Errors: ConfigError where neither is given and the user has no home.
    """
    if config.service.state_dir is not None:
        return Path(config.service.state_dir).expanduser()
    given = environment.get("STATE_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given)
    try:
        return Path("~/.local/state/canest").expanduser()
    except RuntimeError:  # a user without an entry, as in containers
        raise ConfigError(
            "is not given, and this user has no home directory",
            where="service.state_dir",
            expected="a directory, or STATE_DIRECTORY or HOME in the environment",
        ) from None
