"""Says what is done with DTR and RTS of a port that is opened to listen."""

# When a port is opened, the kernel raises DTR and RTS, and when it is closed, drops both; no
# program can prevent the raising. Some RS-485 adapters send, or are powered, while one of them is
# raised.

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ModemLine(StrEnum):
    """What is done with DTR, or with RTS, of a port."""

    RAISED = "raised"
    """Raised while the port is open, dropped when it is closed: the kernel does so by itself."""
    KEEP = "keep"
    """Raised, and not dropped when the port is closed. Drivers can do this only for both lines
    together."""
    OFF = "off"
    """Dropped right after the port is opened."""


@dataclass(frozen=True, slots=True)
class ModemLines:
    """What is done with DTR and with RTS of a port."""

    dtr: ModemLine = ModemLine.RAISED
    rts: ModemLine = ModemLine.RAISED

    def __str__(self) -> str:
        return f"{self.dtr},{self.rts}"

    @classmethod
    def parse(cls, text: str) -> ModemLines:
        """Read the text that str() returns, such as `raised,off`: first DTR, then RTS."""
        dtr, _, rts = text.partition(",")
        return cls(ModemLine(dtr), ModemLine(rts))
