"""Plans which files of many captures are decoded together, and names what is made of them."""

# A file is the unit of the result: it gives one Parquet file. A connection may begin in one file of
# a rotated capture and end in the next, so files are decoded in runs, with one decoder:
#
#     files of one folder whose names differ only in digits, and whose folders differ only in dates,
#     are taken as one rotated capture, in the order of these numbers
#     a run has at most MAX_FILES of them; it begins behind the one before it, which is read
#     again, so that the decoder knows the connections and the requests that are still open
#
# Two captures that are taken as one do no harm: the times of their packets tell them apart
# (workflows/shared/capture_parts.py).
#
# A file is done if there is a record with the name that `record_name` gives. It tells the file's
# path, size and time, and those of the file before it. So a run does not depend on which other
# files were done when.

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

MIN_FILES, MAX_FILES = 4, 16
"""Files of a run. With fewer than MIN_FILES too much would be read twice; more than MAX_FILES would
be lost if its process is killed."""
MAX_RUN_BYTES = 512 * 1024 * 1024
"""A run ends behind the file with which it has so many bytes: it may be copied to a disk."""
RUNS_EACH = 4
"""Runs for each process, so that all of them end at about the same time."""

_VERSION = "1"
"""Changes when the same input gives another result."""
_DATE = re.compile(r"(?<!\d)20\d\d([-_./]?[01]\d([-_./]?[0-3]\d)?)?(?!\d)")
_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True, slots=True)
class InputFile:
    """A capture that is to be decoded."""

    path: str
    """Its path, or its address in an object store."""
    size: int
    changed_ns: int
    """When it was last written, in UTC ns."""


@dataclass(frozen=True, slots=True)
class FileRun:
    """Files that are decoded one after the other, by one decoder."""

    files: tuple[InputFile, ...]
    previous: InputFile | None
    """The file before them, if it is of the same rotated capture."""
    is_end: bool
    """True if the last one is the last of its rotated capture."""


def plan(files: Iterable[InputFile], most: int = MAX_FILES) -> list[FileRun]:
    """Put files into runs of at most `most`; equal paths count once."""
    unique = {one.path: one for one in files}.values()
    ordered = sorted(unique, key=lambda one: (_group(one.path), _natural(one.path)))
    runs: list[FileRun] = []
    for _, group in groupby(ordered, key=lambda one: _group(one.path)):
        runs += _runs([*group], most)
    return runs


def files_each(files: int, processes: int) -> int:
    """How many files a run should have for some processes to be busy."""
    return min(max(-(-files // (processes * RUNS_EACH)), MIN_FILES), MAX_FILES)


def remaining(
    run: FileRun, is_done: Callable[[InputFile, InputFile | None], bool]
) -> list[FileRun]:
    """The parts of a run whose files are not done; `is_done` takes a file and the one before it."""
    before = (run.previous, *run.files)
    found: list[FileRun] = []
    begun: int | None = None
    for index, file in enumerate((*run.files, None)):
        if file is not None and not is_done(file, before[index]):
            begun = index if begun is None else begun
        elif begun is not None:
            is_end = run.is_end and index == len(run.files)
            found.append(FileRun(run.files[begun:index], before[begun], is_end))
            begun = None
    return found


def share_of(run: FileRun, shares: int) -> int:
    """Which of some shares (counted from 0) a run belongs to; the same wherever it is asked."""
    return int(_hash(run.files[0].path)[:8], 16) % shares


def record_name(file: InputFile, previous: InputFile | None, options: str) -> str:
    """The name of the record that a file was decoded; `options` are those that change the result.

    The part before the dash is the same for all records of one path.
    """
    state = [_VERSION, options, _state(file), _state(previous)]
    return f"{path_name(file.path)}-{_hash(*state)}"


def path_name(path: str) -> str:
    """A name for a path, without any character that is special in paths."""
    return _hash(path)


def parquet_name(path: str, digest: str) -> str:
    """The name of the Parquet file of an input, from its name and the hash of its bytes."""
    return _hash(path.rpartition("/")[2], digest)


def _runs(group: Sequence[InputFile], most: int) -> Iterator[FileRun]:
    begun = size = 0
    for index, file in enumerate(group):
        size += file.size
        is_end = index == len(group) - 1
        if is_end or index - begun + 1 == most or size >= MAX_RUN_BYTES:
            previous = group[begun - 1] if begun else None
            yield FileRun(tuple(group[begun : index + 1]), previous, is_end)
            begun, size = index + 1, 0


def _group(path: str) -> tuple[str, str]:
    """The same for all files of a rotated capture."""
    folder, _, name = path.rpartition("/")
    return _DATE.sub("#", folder), _DIGITS.sub("#", name)


def _natural(path: str) -> list[str | int]:
    return [int(one) if one.isdigit() else one for one in _DIGITS.split(path)]


def _state(file: InputFile | None) -> str:
    return "" if file is None else f"{file.path}\n{file.size}\n{file.changed_ns}"


def _hash(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode("utf-8", "surrogateescape")).hexdigest()[:32]
