"""Refuses YAML that would take minutes, gigabytes or the C stack to load, before anything of it is built.

libyaml's events come one at a time and need no recursion; what composes nodes of them recurses in C, and an
alias or a merge key (``<<``) makes of a few hundred bytes as much as somebody likes. So the events are
counted first. The shipped configs have up to 302 values, three levels deep.
"""

from __future__ import annotations

from pathlib import Path

import yaml

from canest.config.yaml_loader import LOADER
from canest.core.errors import ConfigError

MOST_BYTES = 256 * 1024
MOST_LEVELS = 32
MOST_VALUES = 10_000  #: keys, values and list entries, those that aliases repeat counted each time
MOST_ALIASES = 100
#: of one key or value; Python writes no whole number of more than 4300 digits, and 3500 hexadecimal ones
#: are fewer
MOST_CHARACTERS = 3500


def read_text(path: Path) -> str:
    """Return the text of a YAML file. Errors: ConfigError when it is too large or cannot be read."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        _refuse_size(len(content), str(path))
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            "cannot be read, its letters are not UTF-8",
            where=f"{path}:{line}",
            found=f"byte 0x{content[error.start]:02x}",
            expected="a file saved as UTF-8",
        ) from error
    except OSError as error:
        raise ConfigError(
            f"cannot be read: {error.strerror or error}", where=str(path), expected=how_to_read(error)
        ) from error


def how_to_read(error: OSError) -> str:
    """Return what lets a file be read that could not: '' where the reason says it."""
    # a service runs as a user of its own, and a file that root has written under umask 077 is root's alone
    return (
        "a file that this user may read (chmod a+r, and a+x for its folder)"
        if isinstance(error, PermissionError)
        else ""
    )


def mistake_in_yaml(error: Exception, text: str) -> tuple[str, str]:
    """Return what is wrong with YAML, and its line as ":7", "" where that is not known."""
    problem, mark = str(getattr(error, "problem", None) or error), getattr(error, "problem_mark", None)
    if mark is None:
        return problem, ""
    lines = text.split("\n")
    line = lines[mark.line] if mark.line < len(lines) else ""
    indentation = line[: len(line) - len(line.lstrip())]
    if "\t" in indentation or line[mark.column : mark.column + 1] == "\t":
        problem = "a tab: only spaces may indent a line"
    return problem, f":{mark.line + 1}"


def refuse_excess(text: str, where: str) -> None:
    """Refuse YAML text beyond any limit of this module, in the time that reading it once takes.

    Errors: ConfigError naming the limit and the line; yaml.YAMLError for what is no YAML.
    """
    _refuse_size(len(text.encode("utf-8", "surrogatepass")), where)
    count = _Count(where)
    try:
        for event in yaml.parse(text, Loader=LOADER):
            count.take(event)
    except yaml.MarkedYAMLError as error:
        # libyaml looks ahead, and since 0.2.6 gives up at 1000 levels before the first event is there
        if "nesting depth" not in str(error.problem):
            raise
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        refuse_depth(MOST_LEVELS + 1, f"{where}:{line}")


def refuse_depth(levels: int, where: str) -> None:
    """Refuse more levels of keys than a config may have. Errors: ConfigError."""
    if levels > MOST_LEVELS:
        raise ConfigError("nested too deeply", where=where, expected=f"at most {MOST_LEVELS} levels")


def _refuse_size(size: int, where: str) -> None:
    if size > MOST_BYTES:
        raise ConfigError(
            "too large",
            where=where,
            found=f"more than {MOST_BYTES // 1024} kB",
            expected="a config (the shipped ones have 3 kB)",
        )


class _Open:
    """A list or mapping whose end has not come yet. values: what is in it, aliases written out."""

    def __init__(self, anchor: str | None, is_mapping: bool) -> None:
        self.anchor = anchor
        self.is_mapping = is_mapping
        self.values = 1


class _Count:
    """Follows the events of one document."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.open: list[_Open] = []
        self.sizes: dict[str, int] = {}  #: anchor -> values of what it names
        self.values = 0
        self.aliases = 0

    def take(self, event: yaml.Event) -> None:
        """Count one event. Errors: ConfigError."""
        if isinstance(event, yaml.CollectionStartEvent):
            refuse_depth(len(self.open) + 1, self._at(event))
            self.open.append(_Open(event.anchor, isinstance(event, yaml.MappingStartEvent)))
            self._add(0, event)
        elif isinstance(event, yaml.CollectionEndEvent):
            ended = self.open.pop()
            if ended.anchor is not None:
                self.sizes[ended.anchor] = ended.values
            if self.open:
                self.open[-1].values += ended.values
        elif isinstance(event, yaml.ScalarEvent):
            self._refuse_long(event)
            if event.anchor is not None:
                self.sizes[event.anchor] = 1
            self._add(1, event)
        elif isinstance(event, yaml.AliasEvent):
            self._alias(event)

    def _alias(self, event: yaml.AliasEvent) -> None:
        self.aliases += 1
        if self.aliases > MOST_ALIASES:
            expected = f"at most {MOST_ALIASES}"
            raise ConfigError("too many aliases (*)", where=self._at(event), expected=expected)
        holder = next((o for o in reversed(self.open) if o.anchor == event.anchor), None)
        # a list in itself is refused by whoever validates it; a mapping that merges itself doubles each time
        if holder is not None and (holder.is_mapping or self.open[-1].is_mapping):
            raise ConfigError(
                "alias to what holds it", where=self._at(event), found=f"*{event.anchor}", expected="a value"
            )
        self._add(1 if holder is not None else self.sizes.get(event.anchor or "", 1), event)

    def _add(self, values: int, event: yaml.Event) -> None:
        """Count values of the innermost collection; what is still open holds them all."""
        if self.open:
            self.open[-1].values += values
        self.values += max(values, 1)
        if self.values > MOST_VALUES:
            raise ConfigError(
                "too many keys and values", where=self._at(event), expected=f"at most {MOST_VALUES:,}"
            )

    def _refuse_long(self, event: yaml.ScalarEvent) -> None:
        if len(event.value) > MOST_CHARACTERS:
            raise ConfigError(
                "key or value too long",
                where=self._at(event),
                found=f"{len(event.value):,} characters",
                expected=f"at most {MOST_CHARACTERS:,}",
            )

    def _at(self, event: yaml.Event) -> str:
        return f"{self.where}:{event.start_mark.line + 1 if event.start_mark else 1}"
