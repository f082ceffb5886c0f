"""What other packages add: the objects that their entry points name.

A package declares an entry point in its pyproject.toml, for example

    [project.entry-points."canest.effects"]
    trailer_drag = "canest_trailer_drag:TrailerDrag"

Reading the metadata of all installed packages costs tens of milliseconds. So a group is read when something
asks for it, not when canest starts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from canest.core.errors import CanestError, PluginError

#: how the names of canest's own modules begin
OWN = "canest."


@cache
def load_plugins(group: str) -> tuple[dict[str, object], dict[str, str]]:
    """Return the objects of an entry point group by name, and what was skipped: name -> why, in one line.

    Skipped is what cannot be imported, and a name that two packages give. Nothing is raised. A group is read
    once per process; `load_plugins.cache_clear()` forgets it.
    """
    from importlib.metadata import EntryPoint, entry_points  # mail, zip, json ...: heavy, and rarely wanted

    found: dict[str, dict[str, EntryPoint]] = {}
    for entry in entry_points(group=group):
        package = entry.dist.name if entry.dist is not None else entry.module
        found.setdefault(entry.name, {})[f"{entry.value} of {package}"] = entry
    loaded: dict[str, object] = {}
    skipped: dict[str, str] = {}
    for name, givers in sorted(found.items()):
        if len(givers) > 1:
            skipped[name] = f"several packages give it: {', '.join(sorted(givers))}"
            continue
        ((giver, entry),) = givers.items()
        try:
            loaded[name] = entry.load()
        except (Exception, SystemExit) as error:  # whatever a foreign module does when it is imported
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            skipped[name] = f"{giver} cannot be imported: {reason}"
    return loaded, skipped


def usable_plugins(
    group: str, unfit: Callable[[str, object], str]
) -> tuple[dict[str, type[Any]], dict[str, str]]:
    """Return the classes of an entry point group by name, and what was skipped: name -> why, in one line.

    unfit: (name, object) -> why the object cannot be used, "" for a class that can.
    """
    loaded, failed = load_plugins(group)
    usable: dict[str, type[Any]] = {}
    skipped = dict(failed)
    for name, value in loaded.items():
        reason = unfit(name, value)
        if reason:
            skipped[name] = reason
        elif isinstance(value, type):
            usable[name] = value
    return usable, skipped


def is_of_canest(value: object) -> bool:
    """Return whether an object's class is one of canest itself."""
    return type(value).__module__.startswith(OWN)


@contextmanager
def named_failures(what: str) -> Iterator[None]:
    """Turn what the code of another package raises into an error with its name. Errors: PluginError."""
    try:
        yield
    except CanestError:
        raise
    except Exception as error:
        raise PluginError(f"{type(error).__name__}: {error}", where=what) from error
