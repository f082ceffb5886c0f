"""The config that a report was made with, on its page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from canest import __version__
from canest.report.page import Section

if TYPE_CHECKING:
    from canest.config import Config


def config_section(config: Config) -> Section:
    """Return the config as it was used, defaults left out; how it was named is in the title."""
    used = config.model_dump(mode="json", exclude_unset=True)
    text = f"Used by canest {__version__}; what is not in it has its default (docs/config.md)."
    listing = yaml.safe_dump(used, sort_keys=False, allow_unicode=True)
    return Section("Config", text=text, listing=listing)
