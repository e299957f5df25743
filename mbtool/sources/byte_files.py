"""Reads the bytes of a serial line from files without times: raw, or hexadecimal text."""

# Hexadecimal text is pairs of digits, with or without 0x before each, separated by white space, by
# commas or not at all, in rows of any length. From a # on, a row is a comment.
#
# The bytes in such files have no times (Stamp.UNKNOWN). They get invented times: as if they had
# come without gaps at the line's speed, from 1970-01-01 on. These keep the bytes in order and show
# how far into the file a byte is. The file's date is not used, as it need not be the date of the
# recording.
#
# Memory: at most READ_BYTES of a file.

from __future__ import annotations

import re
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, cast

from mbtool.core import Chunk, CutError, InputError, Origin, Stamp, StreamPlace

if TYPE_CHECKING:
    import io
    from collections.abc import Iterable, Iterator

    from mbtool.core import LineSettings

READ_BYTES = 4096

_DIGITS = re.compile(rb"(?:0[xX])?((?:[0-9A-Fa-f]{2})+)")
_PARTED = re.compile(rb"[\s,]+")
_HALF = re.compile(rb"(?:0[xX])?[0-9A-Fa-f]*")
_SHOWN = 20


class SerialBytes(NamedTuple):
    """The bytes of a serial line in a file of any kind."""

    line: LineSettings
    """The line's settings: given by the user, else found in the file."""
    pieces: Iterator[Chunk]
    """The bytes, piece by piece.

    The iterator raises InputError for bad content, CutError for a file that was cut off, and
    OSError if reading fails.
    """


def read_raw(stream: BinaryIO, name: str, link: str, line: LineSettings) -> SerialBytes:
    """Read a file that contains only the bytes of the line."""
    return SerialBytes(line, _back_to_back(_blocks(stream), name, link, line))


def read_hex(stream: BinaryIO, name: str, link: str, line: LineSettings) -> SerialBytes:
    """Read a text that has the bytes in hexadecimal."""
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
    """The last word of a piece, or the end of a long word: the next piece may continue it."""
    while piece := stream.readline(READ_BYTES):
        is_whole = piece.endswith(b"\n")
        text, sharp, _ = (b"" if in_comment else rest + piece).partition(b"#")
        rest = b""
        in_comment = (in_comment or bool(sharp)) and not is_whole
        words = _PARTED.split(text)
        last = words.pop()
        if not is_whole and not in_comment:
            # The next piece may continue the last word, so it is kept for then. If it is long, its
            # complete pairs of digits are read now, so that only a short text is kept.
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
    except ValueError:  # One word has a 0x, or is wrong: read the words one by one.
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
