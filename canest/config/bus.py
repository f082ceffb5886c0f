"""The sections `bus` and `broadcast`: where frames come from, who we are there and what we send."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from canest.core.section import MisplacedError, Number, Section, Whole, empty_section


def _word_of_number(value: Any) -> Any:
    """Return a name that was written as a whole number."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class Bus(Section):
    """The CAN interface, as python-can names it."""

    interface: str = "socketcan"
    #: some interfaces number theirs (kvaser, vector, ...)
    channel: Annotated[str, BeforeValidator(_word_of_number)] = "vcan0"
    bitrate: Whole | None = Field(None, gt=0)
    options: dict[str, Any] = Field(default_factory=dict)

    @property
    def file_name(self) -> str:
        """Return what files of this bus are named by: the channel, which other interfaces number from 0."""
        name = self.channel if self.interface == "socketcan" else f"{self.interface}-{self.channel}"
        return re.sub(r"[^A-Za-z0-9_.-]", "_", name)


class Name(Section):
    """The 64-bit J1939 NAME (ISO 11783-5) in our address claim."""

    identity: Whole = Field(1, ge=0, lt=2**21)
    manufacturer: Whole = Field(0, ge=0, lt=2**11)
    ecu_instance: Whole = Field(0, ge=0, lt=8)
    function_instance: Whole = Field(0, ge=0, lt=32)
    #: 33 = system monitor, valid for any industry group
    function: Whole = Field(33, ge=0, lt=256)
    vehicle_system: Whole = Field(0, ge=0, lt=128)
    vehicle_system_instance: Whole = Field(0, ge=0, lt=16)
    industry_group: Whole = Field(0, ge=0, lt=8)
    arbitrary_address_capable: bool = True


class Broadcast(Section):
    """What goes back on the bus."""

    #: None: only on a virtual bus (vcan, virtual, udp_multicast); a physical bus must be asked for
    enabled: bool | None = None
    #: no transmission at all, not even an address claim
    listen_only: bool = False
    pgn: Whole = Field(0xFF5A, ge=0xFF00, le=0x1FFFF)
    priority: Whole = Field(6, ge=0, le=7)
    #: `canest` learns five times a second; between, grade is carried on
    rate_hz: Number = Field(5.0, gt=0, le=50)
    preferred_address: Whole = Field(158, ge=128, le=247)
    name: Name = empty_section()
    #: also as SPN 1760 in PGN 65136, 1 Hz, only while valid
    cvw: bool = False
    #: also as SPN 7432 in PGN 61651: map-based controllers may act on it
    pcc1: bool = False

    @model_validator(mode="after")
    def _proprietary_b(self) -> Broadcast:
        if not (0xFF00 <= self.pgn <= 0xFFFF or 0x1FF00 <= self.pgn <= 0x1FFFF):
            raise MisplacedError(
                f"found {self.pgn:#x}, expected a proprietary-B group, 0xFF00..0xFFFF or 0x1FF00..0x1FFFF",
                "pgn",
            )
        return self
