"""What the config wants of one parameter group: its signals, their compiled form, and who owns each role."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from canest.core.errors import ConfigError
from canest.core.frames import EXTENDED
from canest.decode.compile import FRAME_BYTES, CompiledSignal, Field, known_selectors
from canest.decode.database import find_signal, is_j1939
from canest.decode.j1939 import pgn_of
from canest.decode.ownership import Owner

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

    from canest.decode.value_table import TextTable

MAX_GROUPS = 250  #: slots of one byte


class Want(NamedTuple):
    """One entry of a config's signal map, resolved.

    source: address that may send it, None for any (see `canest.decode.ownership`).
    validity: a rule of `canest.decode.validity.RULES`.
    factor, offset: from the DBC's unit to the role's, value_role = value_dbc * factor + offset.
    where: the place in the config, for messages.
    values: raw bits -> what is taken for the DBC's physical value; None: the DBC's own factor and offset.
    texts: the same for characters (rule ``ascii``); None: as gears are written.
    """

    role: str
    message: str
    signal: str
    source: int | None = None
    validity: str = "j1939"
    factor: float = 1.0
    offset: float = 0.0
    where: str = ""
    values: Mapping[int, float] | None = None
    texts: TextTable | None = None


class WantedSignal(NamedTuple):
    """A compiled signal with the role it serves; ``owner`` is None when the config names the source."""

    role: str
    signal: CompiledSignal
    source: int | None
    owner: Owner | None


@dataclass(slots=True)
class Group:
    """One wanted parameter group (``pgn``) or one exact identifier (``exact_id``, with flags)."""

    pgn: int | None
    exact_id: int | None
    length: int
    selector: tuple[Field, frozenset[int]] | None
    signals: list[WantedSignal] = field(default_factory=list)

    @property
    def number(self) -> int:
        """The parameter group's number, or the exact identifier."""
        number = self.exact_id if self.pgn is None else self.pgn
        assert number is not None
        return number

    @property
    def multi_packet(self) -> bool:
        """True for a parameter group that does not fit into one frame."""
        return self.pgn is not None and self.length > FRAME_BYTES


def build_groups(wants: Mapping[str, Want], databases: Sequence[Database]) -> list[Group]:
    """Return the groups that serve the wants.

    Errors: ConfigError for a message or signal that is missing, or that no frame can carry.
    """
    groups: dict[tuple[bool, int], Group] = {}
    for role, want in wants.items():
        where = want.where or f"signals.{role}"
        message, signal = find_signal(databases, want.message, want.signal, where)
        j1939 = is_j1939(message)
        identifier = pgn_of(message.frame_id) if j1939 else exact_id(message)
        group = groups.get((j1939, identifier))
        if group is None:
            group = Group(
                pgn=identifier if j1939 else None,
                exact_id=None if j1939 else identifier,
                length=message.length,
                selector=known_selectors(message),
            )
            groups[j1939, identifier] = group
        if group.length != message.length:
            raise ConfigError(
                "two messages of one parameter group differ in length",
                where=where,
                found=f"{message.length} bytes in {message.name}",
                expected=f"{group.length} bytes",
            )
        compiled = _compiled(message, signal, want, where, group)
        if compiled.needs > (message.length if group.multi_packet else FRAME_BYTES):
            raise ConfigError("signal beyond the eighth byte of a frame", where=where, found=want.signal)
        source = want.source if j1939 else None
        owner = Owner() if j1939 and source is None else None
        group.signals.append(WantedSignal(role, compiled, source, owner))
    if len(groups) > MAX_GROUPS:
        raise ConfigError(
            "too many messages", where="signals", found=len(groups), expected=f"{MAX_GROUPS} at most"
        )
    return list(groups.values())


def _compiled(message: Message, signal: Signal, want: Want, where: str, group: Group) -> CompiledSignal:
    try:
        return CompiledSignal(
            message,
            signal,
            validity=want.validity,
            factor=want.factor,
            offset=want.offset,
            values=want.values,
            texts=want.texts,
            size=max(FRAME_BYTES, message.length) if group.multi_packet else FRAME_BYTES,
        )
    except ConfigError as error:  # it knows the signal, but not where the config asks for it
        raise ConfigError(
            error.what, where=f"{where}: {error.where}", found=error.found, expected=error.expected
        ) from None


def exact_id(message: Message) -> int:
    """Return a message's whole identifier, with the `EXTENDED` flag where it has 29 bits."""
    return message.frame_id | (EXTENDED if message.is_extended_frame else 0)
