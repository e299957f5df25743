"""Writes a log over several files, each limited in size or time."""

# The files are FILE-0001.mcap, FILE-0002.mcap, ...: a shell lists them in their order. Each is a
# complete log, with the metadata, the links and the profiles. A file ends at the first tick or item
# after it has reached its limit, so it may exceed the limit by one flush, and it has at least one
# item. A number whose file exists already is skipped. A transaction may be in the file after the
# one with its captured bytes. The first file stays locked until the run ends or the file is
# removed; no other recorder begins a series while a file of it is locked. Once the first file is
# removed, there are some ms between two files in which none is.
#
# If the number of files is limited, the oldest one is removed before the next is begun, and also
# when the disk is full. Only finished files of this run are removed; if the run continues an
# existing series, those of the earlier runs, too: logs whose metadata name the same number.

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self

import msgspec

from mbtool.core import InputError, UsageError
from mbtool.core.closing import ClosesOnExit
from mbtool.core.moments import SECOND_NS
from mbtool.core.replacing import sync_folder
from mbtool.logs.creating import check_path, demand_unlocked
from mbtool.logs.messages import DecodingMark, LogItem
from mbtool.logs.status import read_status
from mbtool.logs.writer import LogWriter

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding

_KEPT = "-kept"
"""This text is put behind the number in the name of a file that `keep_around` keeps, so that the
file is not removed."""
_PATTERN = re.compile(r"(?P<number>\d{1,9})(?P<suffix>[A-Za-z]{1,2})", re.ASCII)
_SIZES = {"kb": 1_000, "mb": 1_000_000, "gb": 1_000_000_000}
MIN_KB = 20
"""The least limit in size, in kB. What each file begins and ends with takes 2 to 12 kB (measured),
so that files of less would hold hardly anything else."""
_TIMES = {"s": 1, "m": 60, "h": 3600, "d": 86400}


@dataclass(frozen=True, slots=True)
class Rotation:
    """The limit of each file of a log: a size or a time."""

    size: int | None = None
    """The size on disk, in bytes, at which a file ends; None for a limit in time."""
    time_ns: int | None = None
    """The time, in ns, that a file lasts, counted from the first call of `tick` for it; None for a
    limit in size."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `100MB` or `1h`. Raises UsageError for a text that is neither a size nor a time, and
        for a size below MIN_KB.
        """
        match = _PATTERN.fullmatch(text)
        if match is not None and int(match["number"]) > 0:
            number, suffix = int(match["number"]), match["suffix"].lower()
            if suffix in _SIZES:
                if number * _SIZES[suffix] < MIN_KB * _SIZES["kb"]:
                    raise UsageError(
                        f"rotation {text!r}: a file without any transaction may have 12 KB; "
                        f"write {MIN_KB}KB or more"
                    )
                return cls(size=number * _SIZES[suffix])
            if suffix in _TIMES:
                return cls(time_ns=number * _TIMES[suffix] * SECOND_NS)
        raise UsageError(
            f"rotation {text!r}: write a size in KB, MB or GB or a time in s, m, h or d, "
            "for example 100MB or 1h"
        )


class RotatingLog(ClosesOnExit):
    """A log in several files: writes as LogWriter does, and begins a new file at each limit.

    A Rotation gives the limit, a size or a time.
    """

    def __init__(
        self,
        path: str | Path,
        rotation: Rotation,
        *,
        capture: Mapping[str, str],
        replace: bool = False,
        continues: bool = False,
        keep: int | None = None,
        on_full: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Create the first file; with `continues`, the one after the existing files of the series.

        `capture` is metadata of the run, such as its host and command, for each file. With `keep`
        there are never more than `keep` files. `on_full` gets a line for the user for each file
        that is removed because the disk is full.

        Raises UsageError if the file cannot be created, and for a file that exists, unless
        `replace` or `continues` is True: the first one of the series, with `keep` any one. Raises
        OutputError if another recorder writes to a file of the series.
        """
        self._path = Path(path)
        self._keep = keep
        self._on_full = on_full
        self._finished: deque[Path] = deque()
        """The finished files of the series that may be removed, oldest first; empty without a limit
        of files."""
        self._kept = range(0)
        """The numbers of the files that `keep_around` keeps; those of its last call."""
        self._rotation = rotation
        self._capture = dict(capture)
        self._replace = replace
        self._number = 1
        self._continues = continues
        self._metadata: list[Callable[[LogWriter], None]] = []
        self._mark: DecodingMark | None = None
        """The last mark that says how far the decoder is behind the capture; None before the first.
        While the decoder is behind, each new file begins with it."""
        self._status: Mapping[str, str] = {}
        self._began_ns: int | None = None
        self._now_ns: int | None = None
        self._first: BinaryIO | None = None
        """A second handle of the first file of this run. It keeps that file locked after it is
        finished."""
        self._take_series()
        self._writer = self._open()
        self._first = self._writer.hold()

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._writer.path

    @property
    def number(self) -> int:
        """The number of the file that is being written, from 1."""
        return self._number

    @property
    def size(self) -> int:
        return self._writer.size

    def write(self, item: LogItem | DecodingMark) -> None:
        self._rotate_if_due()
        if isinstance(item, DecodingMark):
            self._mark = item
        self._writer.write(item)
        self._is_empty = False

    def add_finding(self, finding: Finding, known_ns: int) -> None:
        self._writer.add_finding(finding, known_ns)
        self._is_empty = False

    def add_link(self, name: str, settings: Mapping[str, str]) -> None:
        self._add_to_each(lambda writer: writer.add_link(name, settings))

    def add_device(self, who: str, profile: str) -> None:
        self._add_to_each(lambda writer: writer.add_device(who, profile))

    def add_profile(self, name: str, profile_json: bytes) -> None:
        self._add_to_each(lambda writer: writer.add_profile(name, profile_json))

    def give_points_topics(self) -> None:
        """Have each point (a named value of a device) written to a topic of its own, too.

        From now on, a point is written there whenever it has changed.
        """
        self._add_to_each(lambda writer: writer.give_points_topics())

    def add_status(self, values: Mapping[str, str]) -> None:
        """Add a heartbeat: `values` describe the state of the recording.

        Each new file of the series begins with a copy of the last heartbeat.
        """
        self._status = values
        self._writer.add_status(values)

    def tick(self, now_ns: int) -> None:
        if self._began_ns is None:
            self._began_ns = now_ns
        self._now_ns = now_ns
        self._writer.tick(now_ns)
        self._rotate_if_due()

    def keep_around(self) -> None:
        """Keep for good the file before the present one, the present one and the next one.

        Each is renamed when it is finished, x-0012.mcap to x-0012-kept.mcap, and no later run
        removes it. If the recorder is killed before that, it keeps its name and may be removed. May
        be called from any thread.
        """
        self._kept = range(self._number - 1, self._number + 2)

    def close(self, final: Mapping[str, str] | None = None) -> None:
        try:
            self._writer.close(final)
        finally:
            self._close_first()
            self._keep_finished(self._writer.path)

    def _take_series(self) -> None:
        """Check that no file of the series is being written; find the number of the next file."""
        parts = parts_of(self._path)
        for part in parts:
            if self._keep is not None and not self._continues:
                check_path(part, replace=self._replace)
            demand_unlocked(part)
        if self._continues and parts:
            self._number = part_number(parts[-1]) + 1
            for part in parts:
                if not part.stem.endswith(_KEPT) and _is_of_a_series(part):
                    self._finish(part)

    def _add_to_each(self, add: Callable[[LogWriter], None]) -> None:
        """Add metadata to the present file and to each later one."""
        self._metadata.append(add)
        add(self._writer)

    def _rotate_if_due(self) -> None:
        if self._is_due():
            self._writer.close()
            self._finish(self._writer.path)
            self._number += 1
            self._began_ns = self._now_ns
            self._writer = self._open()
            for add in self._metadata:
                add(self._writer)
            if self._status:
                self._writer.add_status(self._status)
            if self._mark is not None and self._mark.waiting:
                self._writer.write(msgspec.structs.replace(self._mark, dropped=0))

    def _is_due(self) -> bool:
        if self._is_empty:
            return False
        size, time_ns = self._rotation.size, self._rotation.time_ns
        if size is not None and self._writer.size >= size:
            return True
        if time_ns is None or self._now_ns is None or self._began_ns is None:
            return False
        return self._now_ns - self._began_ns >= time_ns

    def _open(self) -> LogWriter:
        path = self._part()
        while self._number > 1 and not self._replace and path.exists():
            self._number += 1
            path = self._part()
        capture = {**self._capture, "part": str(self._number)}
        writer = LogWriter(path, capture=capture, replace=self._replace, make_room=self._make_room)
        self._is_empty = True
        return writer

    def _finish(self, path: Path) -> None:
        """Note a finished file, and remove the oldest ones of the series if `keep` demands it.

        At most `keep` - 1 finished files are left, so that the next file can be begun.
        """
        if self._keep is None or self._keep_finished(path):
            return
        self._finished.append(path)
        while len(self._finished) >= self._keep:
            self._remove_oldest()

    def _keep_finished(self, path: Path) -> bool:
        """Rename a finished file that is to be kept, and the one before it; False if it is not."""
        if part_number(path) not in self._kept:
            return False
        self._close_first()
        before = self._finished and part_number(self._finished[-1]) in self._kept
        with suppress(OSError):  # Its name stays; this run does not remove it.
            for one in ([self._finished.pop()] if before else []) + [path]:
                one.rename(one.with_name(f"{one.stem}{_KEPT}{one.suffix}"))
            sync_folder(path.parent)
        return True

    def _make_room(self) -> bool:
        """Remove the oldest finished file that can be removed; return False if there is none."""
        while self._finished:
            oldest = self._finished[0]
            if self._remove_oldest():
                self._on_full(
                    f"the disk is full; {oldest}, the oldest file of this log, was removed"
                )
                return True
        return False

    def _remove_oldest(self) -> bool:
        self._close_first()  # An open handle would keep the file's disk space in use.
        try:
            self._finished.popleft().unlink()
        except OSError:
            return False
        return True

    def _close_first(self) -> None:
        if self._first is not None:
            self._first.close()

    def _part(self) -> Path:
        return part_path(self._path, self._number)


def part_path(path: Path, number: int) -> Path:
    """The path of file `number`, counted from 1, of a log whose path the user gave as `path`."""
    return path.with_name(f"{path.stem}-{number:04}{path.suffix}")


def parts_of(path: Path) -> list[Path]:
    """The existing files of a log whose path the user gave as `path`, in the order of numbers.

    Those that are kept around a trouble are among them.
    """
    stem, suffix = re.escape(path.stem), re.escape(path.suffix)
    numbered = re.compile(rf"{stem}-\d{{4,9}}({_KEPT})?{suffix}", re.ASCII)
    try:
        names = os.listdir(path.parent)
    except OSError:
        return []
    found = [path.with_name(name) for name in names if numbered.fullmatch(name)]
    ours = [one for one in found if one.name.startswith(part_path(path, part_number(one)).stem)]
    return sorted(ours, key=part_number)


def _is_of_a_series(part: Path) -> bool:
    """True if a file is a log that was written as this part of a series, and not only named so."""
    try:
        return read_status(part).capture.get("part") == str(part_number(part))
    except InputError:
        return False


def with_parts(paths: Iterable[str]) -> list[str]:
    """Return the paths; in place of one where no file is, the parts of the log of that name."""
    found: list[str] = []
    for path in paths:
        parts = [] if os.path.exists(path) else parts_of(Path(path))
        found += [str(part) for part in parts] or [path]
    return found


def part_number(part: Path) -> int:
    """The number in the name of one file of a rotated log."""
    return int(part.stem.removesuffix(_KEPT).rpartition("-")[2])
