"""Reads and writes lists of registers whose values may differ: --ignore-from and --learn."""

# A list is a text file with a range in each line, such as `holding 9..19`; # begins a comment.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mbtool.cli.output import as_output_error
from mbtool.cli.talk import say
from mbtool.core import InputError, UsageError
from mbtool.core.errors import reason_of
from mbtool.core.moments import counted

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.workflows.replay_master import MasterRun

_MAX_RANGES_BYTES = 1 << 20


def ranges_of(files: Sequence[Path]) -> list[str]:
    """Return the register ranges in files: one in each line; # begins a comment.

    Raises InputError if a file cannot be read, and UsageError if it is no text.
    """
    ranges = []
    for file in files:
        try:
            with file.open("rb") as stream:
                lines = stream.read(_MAX_RANGES_BYTES).decode("utf-8-sig").splitlines()
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {reason_of(error)}") from error
        except UnicodeDecodeError as error:
            raise UsageError(f"{file}: is no list of ranges, as it is no text") from error
        ranges += [text for line in lines if (text := line.partition("#")[0].strip())]
    return ranges


def demand_list(file: Path, run: MasterRun) -> None:
    """Raise UsageError if `file`, to which ranges are to be added, holds anything else."""
    ranges = ranges_of([file])
    try:
        run.spans_of(ranges)
    except UsageError as error:
        raise UsageError(f"{file}: is no list of ranges: {error}") from error


def add_ranges(file: Path, learned: Sequence[str]) -> None:
    """Append those of the ranges `learned` that the file lacks; leave what it has as it is."""
    is_list = file.is_file()
    known = ranges_of([file]) if is_list else []
    fresh = [one for one in learned if one not in known]
    ends_within_line = is_list and file.read_bytes()[-1:] not in (b"", b"\n")
    lines = "".join(f"{one}\n" for one in fresh)
    with as_output_error(str(file)), file.open("a", encoding="utf-8") as stream:
        stream.write(f"\n{lines}" if lines and ends_within_line else lines)
    learned_now = counted(len(fresh), "range", ",")
    say(f"{learned_now} of registers learned; give --ignore-from {file} to leave them out")
