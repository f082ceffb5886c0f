"""What somebody who misspelt a name probably meant: a short answer, however many names there are."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_MOST_LISTED = 12


def expected_name(name: str, names: Iterable[str], kind: str = "one", see: str = "") -> str:
    """Return what was expected instead of ``name``: the nearest names, else a short list of all.

    kind: what is named, with its article ("a role"). see: what lists them all, where there are many.
    """
    known = list(names)
    if near := nearest_names(name, known):
        return f"{kind}, perhaps {' or '.join(near)}"
    listed = "one of " + ", ".join(known[:_MOST_LISTED])
    if len(known) <= _MOST_LISTED:
        return listed
    return f"{listed} ... ({len(known)} in all{': ' + see if see else ''})"


def nearest_names(name: str, names: Iterable[str], cutoff: float = 0.6) -> list[str]:
    """Return the names, two at most, that differ from ``name`` by a slip; letter case does not count.

    cutoff: of 1, how alike they are at least.
    """
    spelled = {n.lower(): n for n in reversed(list(names))}
    return [spelled[n] for n in difflib.get_close_matches(name.lower(), spelled, n=2, cutoff=cutoff)]
