"""Messages in use that share their name or their identifier with another one of the databases."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from canest.pipeline.signal_map import signal_of

if TYPE_CHECKING:
    from cantools.database.can import Message

    from canest.config import Config

_Place = tuple[str, "Message"]  #: a database's file, and a message in it


def same_message_warnings(config: Config) -> list[str]:
    """Return which messages in use are not the only ones of their name or identifier, one sentence each."""
    used = {id(found[0]) for role in config.signals if (found := signal_of(config, role)) is not None}
    messages: list[_Place] = [
        (Path(name).name, message)
        for name, database in zip(config.dbc, config.databases, strict=False)
        for message in database.messages
    ]
    sentences = {}
    for mine in (place for place in messages if id(place[1]) in used):
        for other in messages:
            pair = frozenset((id(mine[1]), id(other[1])))
            if len(pair) > 1 and pair not in sentences and (sentence := _same(mine, other)):
                sentences[pair] = sentence
    return list(sentences.values())


def _same(mine: _Place, other: _Place) -> str:
    """Return what a message in use and another one share, '' where that is nothing."""
    (file, message), (other_file, another) = mine, other
    if message.name == another.name:
        twice = f"twice in {file}" if file == other_file else f"in {file} and in {other_file}"
        return f"message {message.name} is {twice}: the first one is used"
    if (message.frame_id, message.is_extended_frame) != (another.frame_id, another.is_extended_frame):
        return ""
    return (
        f"messages {message.name} ({file}) and {another.name} ({other_file}) have the same identifier "
        f"0x{message.frame_id:X}: one of them is wrong"
    )
