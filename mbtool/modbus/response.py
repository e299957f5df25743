"""A response that a simulated slave gives, and the interface of simulated slaves."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol


class ConnectionEnding(StrEnum):
    """The way in which a simulated slave ends a TCP connection after a response."""

    CLOSE = "close"
    """The slave closes the connection in the normal way, with a FIN."""
    RESET = "reset"
    """The slave ends the connection at once, with a RST."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distortion:
    """The faults of one response; by default none."""

    unit_by: int = 0
    """A number that is added to the unit of the response, modulo 256."""
    id_by: int = 0
    """A number that is added to the transaction id of a Modbus/TCP response, modulo 65536."""
    wrong_check: bool = False
    """True if the response is sent with a wrong CRC or LRC."""
    cut: int = 0
    """Number of bytes at the end of the ADU that are not sent."""
    extra: bytes = b""
    """Bytes that are sent directly after the ADU."""
    pieces: int = 1
    """The number of pieces in which the bytes are sent."""
    gap_ns: int = 0
    """The time from the beginning of one piece to the beginning of the next, in ns."""
    silent: bool = False
    """True if the response is not sent at all."""
    ending: ConnectionEnding | None = None
    """The way in which the connection ends after the response; None if it stays open."""


@dataclass(frozen=True, slots=True)
class Response:
    """A response PDU and the time that the slave waits before it sends the response."""

    pdu: bytes
    delay_ns: int = 0
    """The time from the end of the request to the start of the response, in ns."""
    distortion: Distortion | None = None
    """The faults with which the response is sent; None if it is sent without faults."""


class Responder(Protocol):
    """Responds to requests as one or more slaves."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        """The response to a request PDU; None if the slave stays silent. Never raises for a PDU."""
        ...
