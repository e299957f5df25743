"""What is done with DTR and RTS of a port that is opened to listen."""

# When a port is opened, the kernel raises both, and when it is closed, drops both; no program can
# prevent the first. Some adapters for RS-485 send, or are powered, by one of them.

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ModemLine(StrEnum):
    """What is done with one of the two lines."""

    RAISED = "raised"
    """Raised while the port is open, dropped at the end: what the kernel does."""
    KEEP = "keep"
    """Raised, and not dropped at the end. Drivers can do this for both lines only."""
    OFF = "off"
    """Dropped right after the opening."""


@dataclass(frozen=True, slots=True)
class ModemLines:
    """DTR and RTS of a port."""

    dtr: ModemLine = ModemLine.RAISED
    rts: ModemLine = ModemLine.RAISED

    def __str__(self) -> str:
        return f"{self.dtr},{self.rts}"

    @classmethod
    def parse(cls, text: str) -> ModemLines:
        """The opposite of str()."""
        dtr, _, rts = text.partition(",")
        return cls(ModemLine(dtr), ModemLine(rts))
