"""Plans which files of many captures are decoded together, and gives their results names."""

# Each capture file gives one Parquet file, with the transactions that begin in the capture file. A
# rotated capture is one capture in several files. There, a transaction may end in the next file,
# and a connection may have begun in the file before. So one decoder decodes several files one after
# the other; such files are a "run":
#
#     files are taken as one rotated capture if their names differ only in digits, and their folders
#     only in dates; these numbers give their order
#     a run has at most MAX_FILES files of one rotated capture
#     the file before a run and the beginning of the file after it are read, too (several, if they
#     are small), but their transactions are left out
#
# It does no harm if two captures are taken for one: the times of their packets tell them apart
# (workflows/shared/capture_parts.py).
#
# A file is done if the output has a record with the name that `record_name` gives. The name is a
# hash of the path, size and time of the file and of the files around it. So a result does not
# depend on which other files were decoded before.

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

MIN_FILES, MAX_FILES = 4, 16
"""The least and the greatest number of files that one decoder decodes in a row. With fewer, too
many files would be read twice. With more, too much work would be lost if the process is killed."""
MAX_RUN_BYTES = 512 * 1024 * 1024
"""A run (files that one decoder decodes in a row) ends after the file with which it reaches this
many bytes. This bounds the disk space for copies of files from an object store."""
NEAR_BYTES, MAX_NEAR = 1024 * 1024, 4
"""Before and after a run (the files that one decoder decodes), further files are read until they
have NEAR_BYTES bytes together, at most MAX_NEAR files. Only the first NEAR_BYTES of each file after
the run are read: that is enough for the responses to the last requests."""
RUNS_EACH = 4
"""Number of runs (files that one decoder decodes in a row) for each process. With several runs, all
processes end at about the same time."""

_VERSION = "1"
"""Part of the names of the records that say that a file was decoded. A new version of mbtool that
gives another result for the same file must change it, so that the file is decoded again."""
_DATE = re.compile(r"(?<!\d)20\d\d([-_./]?[01]\d([-_./]?[0-3]\d)?)?(?!\d)")
_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True, slots=True)
class InputFile:
    """A capture file that is to be decoded."""

    path: str
    """The path of the file, or its address in an object store."""
    size: int
    """The size of the file in bytes."""
    changed_ns: int
    """The time at which the file was last written, in UTC ns."""


@dataclass(frozen=True, slots=True)
class Around:
    """The neighbours of one file of a rotated capture that are read with it, in capture order."""

    before: tuple[InputFile, ...]
    after: tuple[InputFile, ...]


@dataclass(frozen=True, slots=True)
class FileRun:
    """Consecutive files of a rotated capture, which one decoder decodes one after the other."""

    files: tuple[InputFile, ...]
    around: tuple[Around, ...]
    """For each item of `files`, its neighbours in the capture. Files before the first
    item and behind the last one are read, but their transactions are left out."""


def plan(files: Iterable[InputFile], most: int = MAX_FILES) -> list[FileRun]:
    """Divide files into runs of at most `most` consecutive files of one rotated capture.

    A path that occurs several times counts once.
    """
    unique = {one.path: one for one in files}.values()
    ordered = sorted(unique, key=lambda one: (_group(one.path), _natural(one.path)))
    runs: list[FileRun] = []
    for _, group in groupby(ordered, key=lambda one: _group(one.path)):
        runs += _runs([*group], most)
    return runs


def files_each(files: int, processes: int) -> int:
    """Return the number of files that one decoder should decode in a row, so that all processes are
    busy.

    `files` is the number of all files, `processes` that of the processes that decode them.
    """
    return min(max(-(-files // (processes * RUNS_EACH)), MIN_FILES), MAX_FILES)


def remaining(run: FileRun, is_done: Callable[[InputFile, Around], bool]) -> list[FileRun]:
    """Return the files of a run that are not done, as runs of files that follow each other.

    `is_done` returns True for a file that was decoded by an earlier command.
    """
    found = []
    pairs = zip(run.files, run.around, strict=True)
    for done, some in groupby(pairs, key=lambda pair: is_done(*pair)):
        if not done:
            files, around = zip(*some, strict=True)
            found.append(FileRun(files, around))
    return found


def share_of(run: FileRun, shares: int) -> int:
    """The number of the share of a job, 0 to `shares` - 1, in which a run of files is decoded.

    It depends only on the path of the run's first file, so all machines of a job agree on it.
    """
    return int(_hash(run.files[0].path)[:8], 16) % shares


def record_name(file: InputFile, around: Around, options: str) -> str:
    """The name of the record, a small file in the output that says that a capture was decoded.

    It changes with the size and time of the capture and of the files around it, and with `options`,
    the options that change the result. The part before the dash depends on the path alone.
    """
    before, after = ("\n\n".join(map(_state, some)) for some in (around.before, around.after))
    state = _hash(_VERSION, options, _state(file), before, after)
    return f"{path_name(file.path)}-{state}"


def path_name(path: str) -> str:
    """A hash of a path as hexadecimal digits, for use in a file name."""
    return _hash(path)


def parquet_name(path: str, digest: str) -> str:
    """The name of the Parquet file of a capture file, without its ending.

    It is a hash of the capture file's name (without folders) and of `digest`, the hash of its
    bytes.
    """
    return _hash(path.rpartition("/")[2], digest)


def _runs(group: Sequence[InputFile], most: int) -> Iterator[FileRun]:
    around = [
        Around(
            tuple(reversed(_first_files(group[max(index - MAX_NEAR, 0) : index][::-1]))),
            _first_files(group[index + 1 : index + 1 + MAX_NEAR]),
        )
        for index in range(len(group))
    ]
    begun = size = 0
    for index, file in enumerate(group, 1):
        size += file.size
        if index == len(group) or index - begun == most or size >= MAX_RUN_BYTES:
            yield FileRun(tuple(group[begun:index]), tuple(around[begun:index]))
            begun, size = index, 0


def _first_files(files: Sequence[InputFile]) -> tuple[InputFile, ...]:
    """Return the first of `files`, as many as are needed for NEAR_BYTES bytes in all.

    Returns all of them if they have fewer bytes.
    """
    size = 0
    for count, file in enumerate(files, 1):
        size += file.size
        if size >= NEAR_BYTES:
            return tuple(files[:count])
    return tuple(files)


def _group(path: str) -> tuple[str, str]:
    """Return the folder of a path with # for each date, and the file name with # for each number.

    Both are the same for all files of one rotated capture.
    """
    folder, _, name = path.rpartition("/")
    return _DATE.sub("#", folder), _DIGITS.sub("#", name)


def _natural(path: str) -> list[str | int]:
    return [int(one) if one.isdigit() else one for one in _DIGITS.split(path)]


def _state(file: InputFile) -> str:
    return f"{file.path}\n{file.size}\n{file.changed_ns}"


def _hash(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode("utf-8", "surrogateescape")).hexdigest()[:32]
