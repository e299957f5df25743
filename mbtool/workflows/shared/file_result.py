"""The result of reading one file of several: its records and errors, for a table at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import CutError, DamageError, InputError, WireEvent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.decode.decoder import Record


@dataclass(slots=True)
class FileResult:
    """The number of records that a file gave, and the error if it could not be read."""

    name: str
    transactions: int = 0
    events: int = 0
    error: InputError | None = None
    """The error if the file could not be read, or not to its end; None if there was none."""

    def note(self, record: Record) -> None:
        """Count a record of this file."""
        if isinstance(record, WireEvent):
            self.events += 1
        else:
            self.transactions += 1

    @property
    def remark(self) -> str:
        """A line that says what is wrong or unusual about the file; empty if nothing is."""
        if self.error is not None:
            why = str(self.error).removeprefix(f"{self.name}: ")
            is_read = isinstance(self.error, (CutError, DamageError))
            return f"{'read in part' if is_read else 'not read'}: {why}"
        return "" if self.transactions or self.events else "no Modbus found"


def file_table(results: Sequence[FileResult]) -> list[str]:
    """A line for each file, under a heading; empty where there is only one file."""
    if len(results) < 2:
        return []
    rows = [("file", "transactions", "events", "")]
    rows += [(one.name, f"{one.transactions:,}", f"{one.events:,}", one.remark) for one in results]
    name, transactions, events = (max(len(row[column]) for row in rows) for column in range(3))
    return [
        f"{row[0]:<{name}}  {row[1]:>{transactions}}  {row[2]:>{events}}  {row[3]}".rstrip()
        for row in rows
    ]
