"""Chooses how capture files are read: as numpy arrays (faster), or one packet after the other."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from mbtool.core import InputError
from mbtool.sources.files import PACKET_KINDS, CaptureKind, open_capture, place_of

if TYPE_CHECKING:
    from mbtool.workflows.shared.column_reading import ColumnReading
    from mbtool.workflows.shared.reading import ReadingOptions


WORTH_BYTES = 256 * 1024
"""If the files have fewer bytes than this together, they are not decoded as arrays: importing numpy
would take longer than arrays save."""


def column_reading(
    paths: Sequence[str], options: ReadingOptions, *, at_least: int | None = None
) -> ColumnReading | None:
    """Return an object that reads the files once with the array decoder; None if that is not
    possible, or if the files together have fewer than `at_least` bytes (default: WORTH_BYTES).

    The size of a compressed file counts ten times.
    """
    if unpacked_bytes(paths) < (WORTH_BYTES if at_least is None else at_least):
        return None
    with suppress(InputError):  # Reading the file will raise the error.
        if can_read_columns(paths, options):
            # Importing numpy takes 0.1 s, which other files need not wait for.
            from mbtool.workflows.shared.column_reading import ColumnReading

            return ColumnReading(paths, options)
    return None


def can_read_columns(paths: Sequence[str], options: ReadingOptions) -> bool:
    """True if a ColumnReading can read these files with these options.

    Raises InputError if a file cannot be read.
    """
    if options.line is not None or options.any_port:
        return False
    return all(not place_of(path)[1] and _has_plain_packets(path) for path in paths)


def _has_plain_packets(path: str) -> bool:
    """True for a file of packets. False if mbtool made it from a log, as it then describes its
    links and may have frames of serial lines.
    """
    with open_capture(path) as capture:
        if capture.kind is CaptureKind.PCAPNG:
            # `capture.head` (the description of links) is known once the first packet is read. A
            # file that has it may have packets with frames of a serial line, which the array
            # decoder cannot read.
            with suppress(InputError):
                next(capture.packets(), None)
        return capture.kind in PACKET_KINDS and capture.head is None


def unpacked_bytes(paths: Sequence[str]) -> int:
    """The approximate size of all files together, in bytes after decompression; a pipe
    counts as 0.
    """
    return sum(map(_size, paths))


def _size(path: str) -> int:
    """The approximate size of a file in bytes after decompression; 0 if it is unknown."""
    try:
        size = os.stat(path).st_size
    except (OSError, ValueError):
        return 0
    return size * 10 if path.endswith((".gz", ".zst")) else size
