"""Where the daemon of a config keeps what it learned."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from canest.config.schema import Config


def state_dir(config: Config, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where learned state lives: the config's, systemd's, or the user's directory."""
    if config.service.state_dir is not None:
        return Path(config.service.state_dir).expanduser()
    given = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(given) if given else Path("~/.local/state/canest").expanduser()
