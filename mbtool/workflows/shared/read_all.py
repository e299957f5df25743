"""Reads all records of files, and tells the user if a file is cut or damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

from mbtool.core import CutError, DamageError

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.workflows.shared.reading import Reading

T = TypeVar("T")


class Work(Protocol):
    """Work that takes long, such as a reading, and knows how much of it is done."""

    @property
    def fraction(self) -> float | None:
        """The share (0 to 1) that is done; None if it is unknown."""

    @property
    def progress_text(self) -> str:
        """The part that is being done: `file 3 of 60`."""

    @property
    def noun(self) -> str:
        """What is counted, in the plural: `transactions`."""


FILES = "files"


@dataclass
class CountedWork:
    """Work of which the number of items is known; `counted` counts them as they pass."""

    total: int
    noun: str = FILES
    text: str = ""
    """The name of the work, for the user; empty for the number of the item: `file 3 of 60`."""
    done: int = 0

    @property
    def fraction(self) -> float | None:
        return min(self.done / self.total, 1.0) if self.total else None

    @property
    def progress_text(self) -> str:
        item = self.noun.removesuffix("s")
        return self.text or f"{item} {min(self.done + 1, self.total)} of {self.total}"

    def counted(self, items: Iterable[T]) -> Iterator[T]:
        for item in items:
            self.done += 1
            yield item


class Watch(Protocol):
    """A function that yields the items of some work unchanged, and may show a progress bar."""

    def __call__(self, work: Work, items: Iterator[T], /) -> Iterator[T]: ...


def unwatched(_: Work, records: Iterator[T]) -> Iterator[T]:
    return records


def read_all(
    reading: Reading,
    on_remark: Callable[[str], None],
    told_as: str = "{error}",
    watch: Watch = unwatched,
) -> Iterator[Record]:
    """Yield the transactions and events of all files; of a file that is cut or damaged, those that
    can be read.

    About a cut or damaged file `on_remark` gets the text `told_as`, with the error in place of
    `{error}`. At the end `on_remark` gets the reading's lines for the user about the files. Raises
    InputError for a file that cannot be read at all, UsageError if the options do not fit the file.
    """
    try:
        yield from watch(reading, reading.records())
    except (CutError, DamageError) as error:
        on_remark(told_as.format(error=error))
    for remark in reading.remarks:
        on_remark(remark)
