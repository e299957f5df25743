"""Reads several files one after the other, and reports at the end the result for each.

If a file is cut or damaged, the other files are still read; its error is raised after all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from mbtool.core import CutError, DamageError, EmptyError, InputError, WireEvent
from mbtool.packets import CaptureHead
from mbtool.sources.files import shown_name

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.logs import LogReader

T = TypeVar("T")

MAX_LISTED = 20
"""The table of files lists all files if they are not more than this."""


@dataclass(slots=True)
class FileResult:
    """The result of reading one file: the numbers of transactions and events, and the error if
    there was one.
    """

    name: str
    transactions: int = 0
    events: int = 0
    error: InputError | None = None
    """The error if the file could not be read to its end; None if it could."""

    @property
    def remark(self) -> str:
        """A text that says what is wrong with the file, or that no Modbus was found in it; empty if
        neither is so.
        """
        if self.error is not None:
            why = str(self.error).removeprefix(f"{self.name}: ")
            is_read = isinstance(self.error, (CutError, DamageError))
            return f"{'read in part' if is_read else 'not read'}: {why}"
        return "" if self.transactions or self.events else "no Modbus found"


class FileResults:
    """Reads several files in turn, and keeps for each the numbers of transactions and events, and
    its error.
    """

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = paths
        self.refused: dict[str, InputError] = {}
        """The errors of files that cannot be read at all, so that they are left out; the key is the
        path."""
        self.files_read = 0
        """The number of files that are done: read to their end, read in part, or left out."""
        self._opened: dict[str, FileResult] = {}
        """The results of the files opened so far; the key is the file's name as messages show
        it."""
        self.heads: dict[str, CaptureHead] = {}
        """For each log, and each capture made from a log: the metadata of its recording, links and
        devices. The key is the file's name as messages show it. An entry is complete once the file
        is read to its end."""

    @property
    def names(self) -> str:
        """The names of all files, separated by commas."""
        return ", ".join(map(shown_name, self._paths))

    def note_head(self, name: str, head: CaptureHead | LogReader) -> None:
        """Keep the metadata of a file's recording. Its dicts are not copied, as a LogReader may add
        to them while it reads on.
        """
        self.heads[name] = CaptureHead(capture=head.capture, links=head.links, devices=head.devices)

    def refuse(self, path: str, error: InputError) -> None:
        """Leave the file at `path` out, as it cannot be read at all because of `error`."""
        self.refused[path] = error

    def error_of(self, path: str) -> InputError | None:
        """The error of the file at `path` if it is cut or damaged; None if it is not, or was not
        opened yet.
        """
        result = self._opened.get(shown_name(path))
        return None if result is None else result.error

    def in_turn(
        self,
        read: Callable[[str], Iterator[T]],
        go_on: Callable[[InputError], Iterator[T]],
        end: Callable[[], Iterator[T]],
    ) -> Iterator[T]:
        """Yield the items of `read(path)` for each file that is not left out, in order, and at the
        end those of `end()`.

        After a file that is cut or damaged, yield those of `go_on(error)`, unless it is the last
        file. After a text without frames, go on with the next file.

        If a file cannot be opened, reading stops: yield those of `end()`, and raise its
        InputError. Otherwise raise, after all items, the first error of a file that is cut, damaged
        or left out.
        """
        try:
            for number, path in enumerate(self._paths, 1):
                if path not in self.refused:
                    yield from self._items_of_file(
                        path, read, go_on, is_last=number == len(self._paths)
                    )
                self.files_read += 1
        except InputError:
            yield from end()
            raise
        yield from end()
        self.raise_first()

    def _items_of_file(
        self,
        path: str,
        read: Callable[[str], Iterator[T]],
        go_on: Callable[[InputError], Iterator[T]],
        *,
        is_last: bool,
    ) -> Iterator[T]:
        result = self._opened[shown_name(path)] = FileResult(shown_name(path))
        try:
            yield from read(path)
        except (CutError, DamageError) as error:
            result.error = error
            if not is_last:
                yield from go_on(error)
        except EmptyError as error:
            result.error = error

    def note(self, name: str, record: Record) -> None:
        """Count a record as read from the file with this name."""
        result = self._opened.get(name)
        if result is None:
            return
        if isinstance(record, WireEvent):
            result.events += 1
        else:
            result.transactions += 1

    def note_some(self, name: str, transactions: int, events: int) -> None:
        """Count several transactions and events as read from the file with this name."""
        result = self._opened.get(name)
        if result is not None:
            result.transactions += transactions
            result.events += events

    def raise_first(self) -> None:
        """Raise the first error of a file that is cut or damaged, or else of a file that was left
        out.

        Does nothing if all files were read to their ends.
        """
        broken = [one.error for one in self._opened.values() if one.error is not None]
        for error in (*broken, *self.refused.values()):
            raise error

    def table(self) -> list[str]:
        """Return the lines of a text table: a heading, and a line for each file.

        Empty if there is only one file, or if none was opened. If there are more than MAX_LISTED
        files, only those have a line that could not be read to their ends, or have no Modbus.
        """
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
        if len(results) > MAX_LISTED:
            results = [one for one in results if one.remark]
        if not results:
            return []
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
