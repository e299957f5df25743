"""The result of reading one file of several: its records and errors, for a table at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import CutError, DamageError, InputError, WireEvent
from mbtool.packets import CaptureHead
from mbtool.sources.files import shown_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.decode.decoder import Record
    from mbtool.logs import LogReader


@dataclass(slots=True)
class FileResult:
    """The number of records that a file gave, and the error if it could not be read."""

    name: str
    transactions: int = 0
    events: int = 0
    error: InputError | None = None
    """The error if the file could not be read, or not to its end; None if there was none."""

    @property
    def remark(self) -> str:
        """A line that says what is wrong or unusual about the file; empty if nothing is."""
        if self.error is not None:
            why = str(self.error).removeprefix(f"{self.name}: ")
            is_read = isinstance(self.error, (CutError, DamageError))
            return f"{'read in part' if is_read else 'not read'}: {why}"
        return "" if self.transactions or self.events else "no Modbus found"


class FileResults:
    """The results of the files of one reading."""

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = paths
        self.refused: dict[str, InputError] = {}
        """The errors of files that cannot be read at all, by path; the other files are read."""
        self._opened: dict[str, FileResult] = {}
        """The results of the files opened so far, by name."""
        self.heads: dict[str, CaptureHead] = {}
        """What logs, and captures made from logs, say of their recording, by the file's name;
        complete at the end of the file."""

    @property
    def names(self) -> str:
        """The names of all files, separated by commas."""
        return ", ".join(map(shown_name, self._paths))

    def note_head(self, name: str, head: CaptureHead | LogReader) -> None:
        """Keep what a file says of its recording. A LogReader adds to it while it reads on."""
        self.heads[name] = CaptureHead(capture=head.capture, links=head.links, devices=head.devices)

    def refuse(self, path: str, error: InputError) -> None:
        """Leave a file out, as it cannot be read at all."""
        self.refused[path] = error

    def begin(self, path: str) -> None:
        """Begin a file; it is about to be opened."""
        name = shown_name(path)
        self._opened[name] = FileResult(name)

    def note(self, name: str, record: Record) -> None:
        """Count a record of a file."""
        result = self._opened.get(name)
        if result is None:
            return
        if isinstance(record, WireEvent):
            result.events += 1
        else:
            result.transactions += 1

    def note_some(self, name: str, transactions: int, events: int) -> None:
        """Count several records of a file."""
        result = self._opened.get(name)
        if result is not None:
            result.transactions += transactions
            result.events += events

    def break_off(self, path: str, error: InputError) -> None:
        """Note why a file could not be read to its end."""
        self._opened[shown_name(path)].error = error

    def raise_first(self) -> None:
        """Raise the first error of a file that is cut or damaged, or else of one not read at all.

        Does nothing if all files were read to their ends.
        """
        broken = [one.error for one in self._opened.values() if one.error is not None]
        for error in (*broken, *self.refused.values()):
            raise error

    def table(self) -> list[str]:
        """A line for each file, under a heading; empty if there is only one or none was opened."""
        if len(self._paths) < 2 or not self._opened:
            return []
        results = []
        for path in self._paths:
            name = shown_name(path)
            error = self.refused.get(path)
            if error is not None:
                results.append(FileResult(name, error=error))
            elif name in self._opened:
                results.append(self._opened[name])
        rows = [("file", "transactions", "events", "")]
        rows += [
            (" ".join(one.name.split()), f"{one.transactions:,}", f"{one.events:,}", one.remark)
            for one in results
        ]
        name_width, *widths = (max(len(row[column]) for row in rows) for column in range(3))
        return [
            f"{row[0]:<{name_width}}  {row[1]:>{widths[0]}}  {row[2]:>{widths[1]}}  "
            f"{row[3]}".rstrip()
            for row in rows
        ]
