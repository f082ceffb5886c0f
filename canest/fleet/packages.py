"""The packages of the extra `fleet`: asked for before any work is done."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from canest.core.errors import UsageError
from canest.system.installation import how_to_add


def require(*packages: str, why: str) -> list[Any]:
    """Return the imported packages. Errors: UsageError that names the command which installs them."""
    found = []
    for package in packages:
        try:
            found.append(import_module(package))
        except ImportError:
            raise UsageError(
                f"{why} needs the package {package.partition('.')[0]}",
                expected=how_to_add("fleet"),
            ) from None
    return found
