"""How canest was installed here, and so how an optional part of it is added."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit


def how_to_add(extra: str) -> str:
    """Return the command that installs an optional part of canest, fitting how canest itself was."""
    return command(extra, _origin(), Path(sys.prefix))


def command(extra: str, origin: Mapping[str, Any], prefix: Path) -> str:
    """Return the command that adds an extra.

    origin: what the installer noted (PEP 610, direct_url.json; empty for a package of an index). prefix: of
    the environment.
    """
    url = str(origin.get("url", ""))
    name, place = f"canest[{extra}]", ""
    options = ""
    if "dir_info" in origin:
        name, place = f".[{extra}]", f" in {unquote(urlsplit(url).path)}"
        options = "-e " if origin["dir_info"].get("editable") else ""
    elif "vcs_info" in origin:
        vcs = origin["vcs_info"]
        name += f" @ {vcs.get('vcs', 'git')}+{url}@{vcs.get('commit_id', 'HEAD')}"
    elif url:
        name += f" @ {url}"
    if (prefix / "pipx_metadata.json").exists():
        installer = "pipx install --force"
    elif (prefix / "uv-receipt.toml").exists():
        installer = "uv tool install --force"
    else:
        installer = "pip install"
    return f"{installer} {options}'{name}'{place}"


def _origin() -> dict[str, Any]:
    from importlib.metadata import PackageNotFoundError, distribution  # 30 ms, for an error alone

    try:
        noted = distribution("canest").read_text("direct_url.json")
        origin = json.loads(noted) if noted else {}
    except (PackageNotFoundError, OSError, ValueError):
        return {}
    return origin if isinstance(origin, dict) else {}
