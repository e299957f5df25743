"""The user's options for the table of transactions."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class TimeStyle(StrEnum):
    """The kind of time that each row of the table shows."""

    UTC = "utc"
    LOCAL = "local"
    RELATIVE = "relative"
    """Each row shows the seconds since the first row."""
    DELTA = "delta"
    """Each row shows the seconds since the row before."""


class TableColumn(StrEnum):
    """A column that the user can choose for the table of transactions.

    Behind these columns, each row ends with the text of its request and response.
    """

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
    """The numbers of the packets with request and response in the capture file, as in Wireshark."""
    FILE = "file"


@dataclass(frozen=True, slots=True)
class TableOptions:
    """The choices of the user on how the table shows transactions."""

    time: TimeStyle = TimeStyle.UTC
    columns: tuple[TableColumn, ...] = ()
    """The columns that the user chose; empty for the default columns. The text of a row is always
    shown."""
    in_hex: bool = False
    """True to show values as 1234H, without the names of points (named values)."""
    wide: bool = False
    """True to print each row on one line, even if the terminal is narrower."""
    full: bool = False
    """True to show all values of a row, on as many lines as they need."""
