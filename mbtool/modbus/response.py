"""What a slave gives back for a request, whoever plays the slave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from mbtool.modbus.distortion import Distortion


@dataclass(frozen=True, slots=True)
class Response:
    """A response PDU and how long the slave takes before it sends it."""

    pdu: bytes
    delay_ns: int = 0
    """From the end of the request to the start of the response."""
    spoiling: Distortion | None = None
    """What is done to it on its way out; None: nothing."""


class Responder(Protocol):
    """Plays one or more slaves."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        """Answer a request PDU, or None where the slave stays silent. Never raises for a PDU."""
        ...
