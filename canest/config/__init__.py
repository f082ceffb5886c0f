"""The config: YAML in, one validated, immutable object out."""

from canest.config.database_files import read_databases
from canest.config.load import load_config, parse_config
from canest.config.schema import Config

__all__ = ["Config", "load_config", "parse_config", "read_databases"]
