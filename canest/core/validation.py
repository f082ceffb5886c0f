"""What pydantic found wrong, in the words of somebody who wrote YAML."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from pydantic import ValidationError

from canest.core.section import MisplacedError

_LONGEST_SHOWN = 80  #: characters of a wrong value in a message
#: pydantic's words -> words for somebody who writes YAML
_WORDS = {"a valid ": "a ", "a integer": "a whole number", "a tuple": "a list", "a dictionary": "a section"}

Kind = Literal["unknown key", "missing", "contradiction", "wrong value"]


class Mistake(NamedTuple):
    """One mistake in nested keys and values.

    path: keys from the outermost to the wrong one, () for the whole. words: the whole sentence of a
    contradiction, else what was expected of a wrong value. found: a wrong value as it was written, a very
    long one cut; the type of what should be a single value. siblings: keys that are missing beside an
    unknown one. more: " (and 2 more)", with the names of keys that are missing beside it; "" when there is
    no other mistake.
    """

    kind: Kind
    path: tuple[str, ...]
    words: str
    found: object
    siblings: tuple[str, ...]
    more: str

    @property
    def key(self) -> str:
        """The path with dots between its keys."""
        return ".".join(self.path)


def first_mistake(error: ValidationError, section: tuple[str, ...] = ()) -> Mistake:
    """Return the mistake that explains most: a misspelt key comes before the one that it leaves missing.

    section: the path of what was validated, where that is a part of the whole.
    """
    problems = error.errors(include_url=False)
    first = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    context = first.get("ctx", {})
    cause = context.get("error")
    inner = cause.keys if isinstance(cause, MisplacedError) else ()
    words = _plain(first["msg"])
    found = _shown(first.get("input"), wrong_length=first["type"] in ("too_short", "too_long"))
    if first["type"] == "union_tag_invalid":
        words, found = context["expected_tags"], context["tag"]
    siblings = tuple(
        str(p["loc"][-1]) for p in problems if p["type"] == "missing" and p["loc"][:-1] == first["loc"][:-1]
    )
    return Mistake(
        _KINDS.get(first["type"], "wrong value"),
        tuple(str(key) for key in (*section, *first["loc"], *inner) if key != "[key]"),
        words,
        found,
        siblings,
        _more(len(problems) - 1, siblings[1:] if first["type"] == "missing" else siblings),
    )


def _more(count: int, missing: tuple[str, ...]) -> str:
    """Return how many mistakes there are besides, and which keys are missing beside the first."""
    if not count:
        return ""
    names = ", ".join(missing) + (", ..." if 0 < len(missing) < count else "")
    return f" (and {count} more: {names})" if names else f" (and {count} more)"


_KINDS: dict[str, Kind] = {
    "extra_forbidden": "unknown key",
    "missing": "missing",
    "value_error": "contradiction",
}


def _plain(message: str) -> str:
    if message.startswith("Value error, "):  # a sentence of our own
        return message.removeprefix("Value error, ")
    message = message.removeprefix("Input should be ")
    for theirs, ours in _WORDS.items():
        message = message.replace(theirs, ours)
    return message.partition(", unable")[0].partition(" or instance of")[0]


def _shown(value: Any, *, wrong_length: bool) -> object:
    if not isinstance(value, str | int | float | None) and not wrong_length:
        return type(value).__name__
    text = str(value)
    return value if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
