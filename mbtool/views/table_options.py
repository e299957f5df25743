"""What a user can choose of the transaction table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class TimeStyle(StrEnum):
    """Which time a row shows."""

    UTC = "utc"
    LOCAL = "local"
    RELATIVE = "relative"
    """Seconds since the first row."""
    DELTA = "delta"
    """Seconds since the row before."""


class TableColumn(StrEnum):
    """A column of the table. The text of a row comes last in any case."""

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


@dataclass(frozen=True, slots=True)
class TableOptions:
    """How a table shows transactions."""

    time: TimeStyle = TimeStyle.UTC
    columns: tuple[TableColumn, ...] = ()
    """The columns of each row, besides its text; empty for the usual ones."""
    in_hex: bool = False
    """True to show values as 1234H, without the names of points."""
    wide: bool = False
    """True for one line a row, whatever the width of the terminal."""
    full: bool = False
    """True for as many lines below a row as its text needs."""
