"""Plans which files of many captures are decoded together, and names what is made of them."""

# A file is the unit of the result: its Parquet file has the transactions that begin in it. They may
# end in the next file of a rotated capture, whose connections may have begun in the one before. So
# files are decoded in runs, by one decoder:
#
#     files of one folder whose names differ only in digits, and whose folders differ only in dates,
#     are taken as one rotated capture, in the order of these numbers
#     a run has at most MAX_FILES of them
#     around a run, the file before it and the beginning of the next one are read, too (of small
#     files several), and their transactions left out
#
# Two captures that are taken as one do no harm: the times of their packets tell them apart
# (workflows/shared/capture_parts.py).
#
# A file is done if there is a record with the name that `record_name` gives. It tells the file's
# path, size and time, and those of the files around it. So a result does not depend on which other
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
NEAR_BYTES, MAX_NEAR = 1024 * 1024, 4
"""On each side of a run, files are read that have so many bytes together, but not more files than
that. Of those behind it, only so many bytes are read: more is not needed to end what is open."""
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
class Around:
    """The files of a rotated capture around one of its files, in order."""

    before: tuple[InputFile, ...]
    after: tuple[InputFile, ...]


@dataclass(frozen=True, slots=True)
class FileRun:
    """Files that are decoded one after the other, by one decoder."""

    files: tuple[InputFile, ...]
    around: tuple[Around, ...]
    """For each file, those that are read with it if it is the first or the last."""


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


def remaining(run: FileRun, is_done: Callable[[InputFile, Around], bool]) -> list[FileRun]:
    """The parts of a run whose files are not done."""
    found = []
    pairs = zip(run.files, run.around, strict=True)
    for done, some in groupby(pairs, key=lambda pair: is_done(*pair)):
        if not done:
            files, around = zip(*some, strict=True)
            found.append(FileRun(files, around))
    return found


def share_of(run: FileRun, shares: int) -> int:
    """Which of some shares (counted from 0) a run belongs to; the same wherever it is asked."""
    return int(_hash(run.files[0].path)[:8], 16) % shares


def record_name(file: InputFile, around: Around, options: str) -> str:
    """The name of the record that a file was decoded; `options` are those that change the result.

    The part before the dash is the same for all records of one path.
    """
    before, after = ("\n\n".join(map(_state, some)) for some in (around.before, around.after))
    state = _hash(_VERSION, options, _state(file), before, after)
    return f"{path_name(file.path)}-{state}"


def path_name(path: str) -> str:
    """A name for a path, without any character that is special in paths."""
    return _hash(path)


def parquet_name(path: str, digest: str) -> str:
    """The name of the Parquet file of an input, from its name and the hash of its bytes."""
    return _hash(path.rpartition("/")[2], digest)


def _runs(group: Sequence[InputFile], most: int) -> Iterator[FileRun]:
    around = [
        Around(
            tuple(reversed(_near(group[max(index - MAX_NEAR, 0) : index][::-1]))),
            _near(group[index + 1 : index + 1 + MAX_NEAR]),
        )
        for index in range(len(group))
    ]
    begun = size = 0
    for index, file in enumerate(group, 1):
        size += file.size
        if index == len(group) or index - begun == most or size >= MAX_RUN_BYTES:
            yield FileRun(tuple(group[begun:index]), tuple(around[begun:index]))
            begun, size = index, 0


def _near(files: Sequence[InputFile]) -> tuple[InputFile, ...]:
    """The first files that have NEAR_BYTES together."""
    size = 0
    for count, file in enumerate(files, 1):
        size += file.size
        if size >= NEAR_BYTES:
            return tuple(files[:count])
    return tuple(files)


def _group(path: str) -> tuple[str, str]:
    """The same for all files of a rotated capture."""
    folder, _, name = path.rpartition("/")
    return _DATE.sub("#", folder), _DIGITS.sub("#", name)


def _natural(path: str) -> list[str | int]:
    return [int(one) if one.isdigit() else one for one in _DIGITS.split(path)]


def _state(file: InputFile) -> str:
    return f"{file.path}\n{file.size}\n{file.changed_ns}"


def _hash(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode("utf-8", "surrogateescape")).hexdigest()[:32]
