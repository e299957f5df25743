"""Reads the bytes of a serial line from files without times: raw, or hexadecimal text."""

# Hexadecimal text is pairs of digits, with or without 0x before each, separated by white space, by
# commas or not at all, in rows of any length. A # begins a comment that lasts to the end of the
# row.
#
# The bytes in such files have no times (Stamp.UNKNOWN). They get invented times: as if they had
# come without gaps at the line's baud rate, from 1970-01-01 on. These times keep the bytes in order
# and show how far into the file a byte is. The file's date is not used, as it need not be the date
# of the recording.
#
# Memory: at most READ_BYTES of a file at a time.

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, cast

from mbtool.core import (
    Chunk,
    CutError,
    InputError,
    LineSettings,
    Origin,
    Stamp,
    StreamPlace,
    WireEvent,
)
from mbtool.packets.stream_events import StreamGap

if TYPE_CHECKING:
    import io

SerialPiece = Chunk | WireEvent | StreamGap
"""Bytes of a serial line, or a loss that a text log shows."""

READ_BYTES = 4096

_DIGITS = re.compile(rb"(?:0[xX])?((?:[0-9A-Fa-f]{2})+)")
_PARTED = re.compile(rb"[\s,]+")
_HALF = re.compile(rb"(?:0[xX])?[0-9A-Fa-f]*")
_SHOWN = 20


class SerialBytes(NamedTuple):
    """The bytes of a serial line that a file of any kind contains."""

    line: LineSettings
    """The line's settings: those that the user gave, else those found from the times of the bytes
    or from the signal."""
    pieces: Iterator[Chunk]
    """The bytes in the order of the file, as consecutive chunks.

    The iterator raises InputError for bad content, CutError for a file that was cut off, and
    OSError if reading fails."""


def read_raw(stream: BinaryIO, name: str, link: str, line: LineSettings) -> SerialBytes:
    """Read a file that contains nothing but the bytes of the line, without times.

    `name` is the file's name, `link` the name of the line. `line` has the settings that the user
    gave; its baud rate gives the invented times.
    """
    return SerialBytes(line, _back_to_back(_blocks(stream), name, link, line))


def read_hex(stream: BinaryIO, name: str, link: str, line: LineSettings) -> SerialBytes:
    """Read a text file that contains the bytes of the line in hexadecimal, without times.

    `name` is the file's name, `link` the name of the line. `line` has the settings that the user
    gave; its baud rate gives the invented times.
    """
    return SerialBytes(line, _back_to_back(_from_hex(stream, name), name, link, line))


def _blocks(stream: BinaryIO) -> Iterator[bytes]:
    # read1 returns the bytes that a pipe has, without waiting for a full block.
    read = cast("io.BufferedIOBase", stream).read1
    while data := read(READ_BYTES):
        yield data


def _back_to_back(
    parts: Iterable[bytes], name: str, link: str, line: LineSettings
) -> Iterator[Chunk]:
    character_ns = line.format.character_ns
    origin = Origin(name, 0)
    count = 0
    for data in parts:
        place = StreamPlace(count, None, origin)
        count += len(data)
        ts_ns = count * character_ns
        yield Chunk(ts_ns=ts_ns, link=link, data=data, stamp=Stamp.UNKNOWN, place=place)


def _from_hex(stream: BinaryIO, name: str) -> Iterator[bytes]:
    row = 1
    in_comment = False
    rest = b""
    """The last digits of the previous read if no white space or comma follows them: the next read
    may continue them."""
    while piece := stream.readline(READ_BYTES):
        is_whole = piece.endswith(b"\n")
        text, sharp, _ = (b"" if in_comment else rest + piece).partition(b"#")
        rest = b""
        in_comment = (in_comment or bool(sharp)) and not is_whole
        words = _PARTED.split(text)
        last = words.pop()
        if not is_whole and not in_comment:
            # The next read may continue the last digits, so they are kept for it. If they are
            # many, the complete pairs are decoded now, so that only a short text is kept.
            even = len(last) // 2 * 2 if len(last) > _SHOWN else 0
            words.append(last[:even])
            rest = last[even:]
        else:
            words.append(last)
        data = _all_pairs(words, name, row)
        if data:
            yield data
        row += is_whole
    if rest:
        if _DIGITS.fullmatch(rest) is None and _HALF.fullmatch(rest):
            raise CutError(f"{name}: ends in the middle of a byte, in row {row}")
        yield _pairs(rest, name, row)


def _all_pairs(words: list[bytes], name: str, row: int) -> bytes:
    try:
        return bytes.fromhex(b" ".join(words).decode("ascii"))
    except ValueError:  # A word begins with 0x or is wrong: decode each by itself.
        return b"".join(_pairs(word, name, row) for word in words if word)


def _pairs(word: bytes, name: str, row: int) -> bytes:
    match = _DIGITS.fullmatch(word)
    if match is None:
        shown = ascii(word[:_SHOWN].decode("utf-8", "replace"))
        raise InputError(
            f"{name}: row {row}: {shown} is not made of pairs of hexadecimal digits, "
            "as in 01 03 00 6B or 0103006B"
        )
    return bytes.fromhex(match[1].decode("ascii"))
