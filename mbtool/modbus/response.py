"""The response of a slave that this program plays, and the interface of such a slave."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol


class ConnectionEnding(StrEnum):
    """How a connection is ended after a response."""

    CLOSE = "close"
    """With a FIN, in order."""
    RESET = "reset"
    """With a RST, at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distortion:
    """The faults of one response; by default none."""

    unit_by: int = 0
    """A number to add to the unit."""
    id_by: int = 0
    """A number to add to the transaction id of Modbus/TCP."""
    wrong_check: bool = False
    """True if the CRC or LRC is wrong."""
    cut: int = 0
    """How many bytes are missing at the end of the ADU."""
    extra: bytes = b""
    """Bytes that follow the ADU."""
    pieces: int = 1
    """In how many pieces the bytes are sent."""
    gap_ns: int = 0
    """The pause between two pieces, in ns."""
    silent: bool = False
    """True if nothing is sent."""
    ending: ConnectionEnding | None = None
    """How the connection ends after the response; None if it stays open."""


@dataclass(frozen=True, slots=True)
class Response:
    """A response PDU and how long the slave takes before it sends it."""

    pdu: bytes
    delay_ns: int = 0
    """From the end of the request to the start of the response, in ns."""
    distortion: Distortion | None = None
    """The faults of its ADU on the wire; None if it has none."""


class Responder(Protocol):
    """Plays one or more slaves."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        """The response to a request PDU; None if the slave stays silent. Never raises for a PDU."""
        ...
