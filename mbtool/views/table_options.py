"""The user's options for the transaction table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class TimeStyle(StrEnum):
    """The kind of time that a row shows."""

    UTC = "utc"
    LOCAL = "local"
    RELATIVE = "relative"
    """Seconds since the first row."""
    DELTA = "delta"
    """Seconds since the row before."""


class TableColumn(StrEnum):
    """A column of the table that the user can choose. The text of a row always comes last."""

    NUMBER = "number"
    TIME = "time"
    LATENCY = "latency"
    LINK = "link"
    MASTER = "master"
    SLAVE = "slave"
    UNIT = "unit"
    DEVICE = "device"
    ID = "id"
    OUTCOME = "outcome"
    PACKET = "packet"
    """The numbers of request and response in the capture file, as Wireshark counts them."""
    FILE = "file"


@dataclass(frozen=True, slots=True)
class TableOptions:
    """How a table shows transactions."""

    time: TimeStyle = TimeStyle.UTC
    columns: tuple[TableColumn, ...] = ()
    """The columns that the user chose, beside the text; empty for the default columns."""
    in_hex: bool = False
    """True to show values as 1234H, without the names of points."""
    wide: bool = False
    """True for one line a row, whatever the width of the terminal."""
    full: bool = False
    """True for all values, on as many lines as they need."""
