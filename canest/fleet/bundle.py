"""A config with all that it needs, as bytes: another machine has neither the file nor its DBCs."""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from canest import __version__
from canest.config import load_config
from canest.config.schema import Config
from canest.decode.database import parse
from canest.system.shipped_files import find


@dataclass(frozen=True, slots=True)
class Bundle:
    """A config and its databases' files. name: as the manifest calls it. digest: of its content."""

    name: str
    config: bytes
    databases: tuple[tuple[str, str, bytes], ...]  #: (name, suffix, content)
    digest: str

    def unpack(self) -> Config:
        """Return the config, with its databases read. Errors: ConfigError."""
        return _unpacked(self)


def bundle_of(name: str) -> Bundle:
    """Load a config with its databases. Errors: ConfigError."""
    # a map may be built of what is estimated here: it must not be its own evidence
    config = load_config(name, ["road_map=null"])
    files = [(dbc, find("dbc", dbc, config.at(f"dbc.{i}"))) for i, dbc in enumerate(config.dbc)]
    databases = tuple((dbc, path.suffix, path.read_bytes()) for dbc, path in files)
    # where the databases are makes no difference, their content does
    text = config.model_dump_json(exclude={"dbc", "bus", "broadcast", "service"})
    digest = hashlib.blake2b(text.encode(), digest_size=8)
    for _, suffix, content in databases:
        digest.update(suffix.encode() + hashlib.blake2b(content).digest())
    return Bundle(name, pickle.dumps(config), databases, digest.hexdigest())


def code_version() -> str:
    """Return the version of canest and a digest of its source: workers must run the same code."""
    return f"{__version__}+{_source_digest()}"


@lru_cache(maxsize=64)
def _unpacked(bundle: Bundle) -> Config:
    config: Config = pickle.loads(bundle.config)
    return config.with_databases([parse(content, suffix, name) for name, suffix, content in bundle.databases])


@lru_cache(maxsize=1)
def _source_digest() -> str:
    package = Path(__file__).parents[1]
    digest = hashlib.blake2b(digest_size=4)
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
