"""Messages on a bus that no role takes, though mass and grade are wrong without them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from canest.core.frames import EXTENDED, FrameBlock
from canest.decode import j1939
from canest.decode.database import is_j1939
from canest.decode.groups import exact_id
from canest.doctor.missing_signals import FRICTION, RETARDER
from canest.doctor.second_motor import SecondMotorCheck
from canest.doctor.unused_signals import messages_that_could_check
from canest.vehicle.role_sources import torque_role

if TYPE_CHECKING:
    from cantools.database.can import Message

    from canest.config import Config


class _Group(NamedTuple):
    role: str
    message: str
    signal: str
    torques: tuple[str, ...]  #: that lack it
    without: str  #: what happens then, and what else it needs


_GROUPS = (
    _Group(
        FRICTION, "EEC3", "NominalFrictionPercentTorque", ("engine_torque_pct",),
        "the engine's friction is another number",
    ),
    _Group(
        RETARDER, "ERC1", "ActualRetarderPercentTorque", ("engine_torque_pct", "engine_torque"),
        "what a retarder takes counts as weight or a hill; vehicle.retarder says how much it is",
    ),
)  # fmt: skip


class UnmappedGroups:
    """Looks for them in a stream: parameter groups of J1939, and the message of a second motor.

    came: names of the messages that came, of those that lack a role or could check other signals.
    """

    def __init__(self, config: Config) -> None:
        self._groups, messages = _unmapped(config)
        self._awaited = {m.name: m for m in (*messages, *messages_that_could_check(config))}
        self.came = set[str]()
        self._second_motor = SecondMotorCheck(config)

    def push(self, block: FrameBlock) -> None:
        """Take the frames of a block."""
        self._second_motor.push(block)
        self.came |= {m.name for name, m in self._awaited.items() if name not in self.came and _in(block, m)}

    def hints(self) -> list[str]:
        """Return what else to map, one sentence each."""
        return [
            f"the bus has {group.message}, and no role takes it: {group.without} (signals.{group.role}: "
            f"{{message: {group.message}, signal: {group.signal}}})"
            for group in self._groups
            if group.message in self.came
        ] + self._second_motor.hints()


def _in(block: FrameBlock, message: Message) -> bool:
    """Return whether a block has frames of a message. None of `_GROUPS` is addressed to one node."""
    if not is_j1939(message):
        return bool((block.can_id == np.uint32(exact_id(message))).any())
    groups = (block.can_id >> np.uint32(8)) & np.uint32(j1939.PGN_MASK)
    of_group = groups == np.uint32(j1939.pgn_of(message.frame_id))
    return bool((of_group & ((block.can_id & np.uint32(EXTENDED)) != 0)).any())


def _unmapped(config: Config) -> tuple[list[_Group], list[Message]]:
    """Return the groups of the databases that no role of the config takes, and their messages."""
    torque = torque_role(config.signals, config.vehicle)
    known = {message.name: message for base in config.databases for message in base.messages}
    groups = [
        group
        for group in _GROUPS
        if group.role not in config.signals
        and torque in group.torques
        and (message := known.get(group.message)) is not None
        and is_j1939(message)
        and any(signal.name == group.signal for signal in message.signals)
    ]
    return groups, [known[group.message] for group in groups]
