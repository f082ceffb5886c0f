"""Every error canest raises on purpose, all below one root.

The tree, with the exit code of the command that meets it::

    CanestError              1
    ├── UsageError           2   the command line, or a call, asks for something impossible
    ├── ConfigError          2   a config file, or a DBC it names, is wrong
    ├── LogError             1   a log cannot be read at all (single bad lines are counted, not raised)
    ├── BusError             1   a CAN interface cannot be opened or is gone
    └── OutputError          1   a result cannot be written (full disk, read-only directory)

The message form is always: where, what, what was found, what was expected.
"""

from __future__ import annotations

#: what steers a terminal or the order of its letters: control characters (but for tab and line feed), marks
#: of direction and of no width
_STEERING = (
    (0x00, 0x08), (0x0B, 0x1F), (0x7F, 0x9F), (0x200B, 0x200F), (0x2028, 0x202E), (0x2060, 0x206F),
    (0xFEFF, 0xFEFF),
)  # fmt: skip
#: code point -> how Python writes it; a table, since compiling a pattern would cost every start 1 ms
_WRITTEN = {code: ascii(chr(code))[1:-1] for first, last in _STEERING for code in range(first, last + 1)}


def printable(text: str) -> str:
    """Return text with whatever would steer a terminal as Python writes it."""
    return text.translate(_WRITTEN)


class CanestError(Exception):
    """Root of all deliberate errors; ``str(error)`` is one plain line.

    Parameters: ``what`` is wrong, ``where`` (file, line, key), what was ``found``, what was ``expected``.
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str = "", found: object = None, expected: str = "") -> None:
        self.what, self.where, self.found, self.expected = what, where, found, expected
        parts = [f"{where}: {what}" if where else what]
        if found is not None:
            parts.append(f"found {found!r}" if isinstance(found, str) else f"found {found}")
        if expected:
            parts.append(f"expected {expected}")
        super().__init__(printable(", ".join(parts).replace("\n", " ")))


class UsageError(CanestError):
    """The command line, or a call, asks for something impossible."""

    exit_code = 2


class ConfigError(CanestError):
    """A config file, or a DBC file that it names, is wrong."""

    exit_code = 2


class PluginError(CanestError):
    """Code of another package has failed, or does not do what canest asks of it."""


class LogError(CanestError):
    """A log cannot be read at all."""


class BusError(CanestError):
    """A CAN interface cannot be opened or has gone away."""


class OutputError(CanestError):
    """A result cannot be written."""
