"""The states that DTR and RTS of a port get when the port is opened to listen."""

# When a port is opened, the kernel raises DTR and RTS, and when it is closed, drops both; no
# program can prevent the raising. Some RS-485 adapters send, or are powered, while one of them is
# raised.

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ModemLine(StrEnum):
    """The state of DTR, or of RTS, while a port is open to listen, and after it is closed."""

    RAISED = "raised"
    """The line is raised while the port is open, and dropped when the port is closed: the kernel
    does so by itself."""
    KEEP = "keep"
    """The line is raised, and not dropped when the port is closed. Drivers can do this only for DTR
    and RTS together."""
    OFF = "off"
    """The line is dropped right after the port is opened."""


@dataclass(frozen=True, slots=True)
class ModemLines:
    """The states of DTR and of RTS while a port is open to listen, and after it is closed."""

    dtr: ModemLine = ModemLine.RAISED
    rts: ModemLine = ModemLine.RAISED

    def __str__(self) -> str:
        return f"{self.dtr},{self.rts}"

    @classmethod
    def parse(cls, text: str) -> ModemLines:
        """Read the text that str() returns, such as `raised,off`: first DTR, then RTS."""
        dtr, _, rts = text.partition(",")
        return cls(ModemLine(dtr), ModemLine(rts))
