"""Reads byte times as CSV, as the UART decoder of a logic analyser writes them."""

#     t_start_s,t_end_s,line,byte_hex
#     0.0311790,0.0315970,tx,01
#
# The header names the columns, in any order. Only the times and the byte are used, not `line` or
# any other column: all rows are of one serial line, in the order of time. Times are in seconds,
# since the start of the recording or since 1970; a recording that starts at 0 is shown as starting
# in 1970. An analyser that counts from its trigger gives negative times to the bytes before the
# trigger: then all times are shifted so that the first row is at 0.
#
# The time of a byte is the arrival of its stop bit. sigrok's decoder gives the end of the data bits
# as t_end_s. So if t_end_s is less than one character time after t_start_s, the time of the byte is
# t_start_s plus one character time.
#
# The line's settings are found from the first rows: the duration of a byte gives the baud rate, and
# the shortest time between the starts of two bytes gives the number of bits of a character. 10 bits
# are taken as 8N1 and 11 as 8E1; all formats with 11 bits have the same times. If no usual baud
# rate fits, the default settings are used.
#
# Memory: LOOKED_AT rows, each of at most MAX_ROW bytes.

from __future__ import annotations

import re
from decimal import Decimal, DecimalException
from itertools import chain, islice, pairwise
from statistics import median_low
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from mbtool.core import (
    Chunk,
    CutError,
    InputError,
    LineSettings,
    Origin,
    SerialFormat,
    StreamPlace,
)
from mbtool.sources.byte_files import SerialBytes

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

START, END, BYTE = "t_start_s", "t_end_s", "byte_hex"
LOOKED_AT = 1000
"""The line's settings are found from the first rows of the CSV file, at most this many."""
MAX_ROW = 4096
"""The most bytes that a row (a line of the CSV file) may have. A longer one raises InputError."""

_BYTE = re.compile(r"(?:0[xX])?[0-9A-Fa-f]{2}", re.ASCII)
_MAX_NS = 2**63 - 1
_BAUDS = (
    300, 600, 1200, 2400, 4800, 9600, 14400, 19200, 28800, 38400, 57600, 76800, 115200, 230400,
    250000, 460800, 500000, 921600, 1000000,
)  # fmt: skip
_TOLERANCE = 0.02
"""A measured baud rate is taken as a usual baud rate if they differ by at most 2 %."""
_LENGTHS = (8, 11, 10)
"""The possible numbers of bit times between t_start_s and t_end_s of a row: 8 data bits only, or a
whole character of 10 or 11 bits."""
_SHOWN = 40


class _Row(NamedTuple):
    start_ns: int
    end_ns: int
    byte: int


def read_byte_times(
    stream: BinaryIO, name: str, link: str, line: LineSettings | None
) -> SerialBytes:
    """Read the header and the first rows of a CSV file; return the line's settings and bytes.

    `name` is the file's name, `link` the name of the line. `line` has the settings that the user
    gave; if it is None, they are found from the times of the first rows. If the header or a row is
    wrong, the iterator over the bytes raises InputError after the bytes of all rows before it.
    """
    rows = _rows(stream, name)
    first: list[_Row] = []
    problem: InputError | None = None
    try:
        first.extend(islice(rows, LOOKED_AT))
    except InputError as error:
        problem = error  # Raised after the bytes of the rows before it.
    line = line or LineSettings(_format(first))
    return SerialBytes(line, _chunks(chain(first, rows), name, link, line, problem))


def is_byte_times(head: bytes) -> bool:
    """True if a file that begins with these bytes is a CSV of byte times."""
    columns = head.partition(b"\n")[0].split(b",")
    return START.encode() in (column.strip() for column in columns)


def _chunks(
    rows: Iterator[_Row], name: str, link: str, line: LineSettings, problem: InputError | None
) -> Iterator[Chunk]:
    character_ns = line.format.character_ns
    origin = Origin(name, 0)
    for offset, row in enumerate(rows):
        ts_ns = max(row.end_ns, row.start_ns + character_ns)
        place = StreamPlace(offset, None, origin)
        yield Chunk(ts_ns=ts_ns, link=link, data=bytes((row.byte,)), place=place)
    if problem is not None:
        raise problem


def _format(rows: Sequence[_Row]) -> SerialFormat:
    """Return the line settings that fit the times of the rows; if none fit, the default ones."""
    width_ns = median_low([row.end_ns - row.start_ns for row in rows]) if rows else 0
    if not width_ns:
        return SerialFormat()
    for bits in _LENGTHS:
        rate = bits * 1e9 / width_ns
        baud = min(_BAUDS, key=lambda each: abs(each - rate))
        if abs(baud - rate) <= _TOLERANCE * baud:
            break
    else:
        return SerialFormat()
    steps = (after.start_ns - before.start_ns for before, after in pairwise(rows))
    shortest_ns = min((step for step in steps if step >= width_ns), default=0)
    # If two characters start less than 10.5 bit times apart, a character has 10 bits, otherwise 11.
    # No UART's clock is off by half a bit time within one character.
    is_short = bits == 10 or 0 < shortest_ns * baud < 10.5e9
    return SerialFormat(baud, 8, "N" if is_short else "E", 1)


def _rows(stream: BinaryIO, name: str) -> Iterator[_Row]:
    header, _ = _cells(stream, name, 1)
    missing = [column for column in (START, END, BYTE) if column not in header]
    if missing:
        raise InputError(
            f"{name}: row 1: there is no column {missing[0]}; byte times need {START}, {END} "
            f"and {BYTE}"
        )
    start_at, end_at, byte_at = (header.index(column) for column in (START, END, BYTE))
    shift_ns: int | None = None
    number = 1
    while True:
        number += 1
        cells, is_whole = _cells(stream, name, number)
        if not cells:
            return
        if cells == [""]:
            continue
        try:
            if len(cells) != len(header):
                raise _wrong(name, number, f"{len(cells)} columns, where row 1 has {len(header)}")
            start_ns = _ns(cells[start_at], START, name, number)
            end_ns = _ns(cells[end_at], END, name, number)
            if end_ns < start_ns:
                raise _wrong(name, number, f"{END} is before {START}")
            if shift_ns is None:
                shift_ns = max(0, -start_ns)
            if start_ns + shift_ns < 0:
                shown = _short(cells[start_at])
                raise _wrong(name, number, f"{START} is {shown}, before that of the first row")
            byte = _byte(cells[byte_at], name, number)
        except InputError as error:
            if is_whole:
                raise
            raise CutError(f"{name}: ends in the middle of row {number}") from error
        yield _Row(start_ns + shift_ns, end_ns + shift_ns, byte)


def _cells(stream: BinaryIO, name: str, number: int) -> tuple[list[str], bool]:
    """Read a row (line) of the CSV file; return its cells, and True if it ends with a line feed.

    `number` is the row's number, from 1, and `name` the file's name, both for error messages. At
    the end of the file the list of cells is empty. Raises InputError for more than MAX_ROW bytes.
    """
    line = stream.readline(MAX_ROW)
    if not line:
        return [], True
    is_whole = line.endswith(b"\n")
    if not is_whole and len(line) == MAX_ROW:
        raise _wrong(name, number, f"more than {MAX_ROW} characters")
    return [cell.strip() for cell in line.decode("utf-8", "replace").split(",")], is_whole


def _ns(text: str, column: str, name: str, number: int) -> int:
    try:
        value = Decimal(text) * 1_000_000_000
        if -_MAX_NS <= value <= _MAX_NS:
            return round(value)
    except DecimalException:
        pass
    raise _wrong(name, number, f"{column} is {_short(text)}; a number of seconds would be right")


def _byte(text: str, name: str, number: int) -> int:
    if _BYTE.fullmatch(text) is None:
        raise _wrong(name, number, f"{BYTE} is {_short(text)}; 00 to ff would be right")
    return int(text, 16)


def _short(text: str) -> str:
    return ascii(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")


def _wrong(name: str, number: int, problem: str) -> InputError:
    return InputError(f"{name}: row {number}: {problem}")
