"""The response of a slave that this program plays, and the interface of such a slave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from mbtool.modbus.distortion import Distortion


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
