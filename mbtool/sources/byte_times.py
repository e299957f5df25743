"""Reads the byte times that a logic analyser's UART decoder gives, as CSV."""

#     t_start_s,t_end_s,line,byte_hex
#     0.0311790,0.0315970,tx,01
#
# The header names the columns, in any order; others are left alone, `line` among them, since all
# rows are of one bus in the order of time. Times are seconds, from the start of the recording or
# since 1970, which is also what the start of a recording is shown as. An analyser that counts from
# its trigger gives what came before it times below 0: then the first row is shown as the start.
#
# A byte's time is when its last bit arrived. Where t_end_s tells the end of the data bits, as
# sigrok's decoder does, or whatever comes before the end of the character, that is one character
# time after t_start_s.
#
# What the line was like shows in its first bytes: how long one takes says the baud rate, how
# closely they follow how many bits a character has (10 are read as 8N1, 11 as 8E1: which of the
# formats with 11 bits it was makes no difference to the times). Where no usual baud rate fits it
# is the default.
#
# Holds LOOKED_AT rows, and MAX_ROW bytes of a row.

from __future__ import annotations

import re
from decimal import Decimal, DecimalException
from itertools import chain, islice, pairwise
from statistics import median_low
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from mbtool.core import Chunk, CutError, InputError, LineSettings, SerialFormat
from mbtool.sources.byte_files import SerialBytes

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

START, END, BYTE = "t_start_s", "t_end_s", "byte_hex"
LOOKED_AT = 1000
MAX_ROW = 4096

_BYTE = re.compile(r"(?:0[xX])?[0-9A-Fa-f]{2}", re.ASCII)
_MAX_NS = 2**63 - 1
_BAUDS = (
    300, 600, 1200, 2400, 4800, 9600, 14400, 19200, 28800, 38400, 57600, 76800, 115200, 230400,
    250000, 460800, 500000, 921600, 1000000,
)  # fmt: skip
_TOLERANCE = 0.02
_LENGTHS = (8, 11, 10)
"""What a byte's times may span: its data bits, or all bits of a character."""
_SHOWN = 40


class _Row(NamedTuple):
    start_ns: int
    end_ns: int
    byte: int


def read_byte_times(
    stream: BinaryIO, name: str, link: str, line: LineSettings | None
) -> SerialBytes:
    """Read the header and the first rows; `line` is what the user says of the line."""
    rows = _rows(stream, name)
    first: list[_Row] = []
    problem: InputError | None = None
    try:
        first.extend(islice(rows, LOOKED_AT))
    except InputError as error:
        problem = error  # It is raised behind what came before.
    line = line or LineSettings(_format(first))
    return SerialBytes(line, _chunks(chain(first, rows), link, line, problem))


def is_byte_times(head: bytes) -> bool:
    """Whether a file that begins like this is meant to be of this kind."""
    columns = head.partition(b"\n")[0].split(b",")
    return START.encode() in (column.strip() for column in columns)


def _chunks(
    rows: Iterator[_Row], link: str, line: LineSettings, problem: InputError | None
) -> Iterator[Chunk]:
    character_ns = line.format.character_ns
    for row in rows:
        ts_ns = max(row.end_ns, row.start_ns + character_ns)
        yield Chunk(ts_ns=ts_ns, link=link, data=bytes((row.byte,)))
    if problem is not None:
        raise problem


def _format(rows: Sequence[_Row]) -> SerialFormat:
    """What the line's settings must have been."""
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
    # Half a bit is more than any clock is off by, and less than what tells 10 bits from 11.
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
    """The cells of the next row, none at the end, and whether it ends as a row does."""
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
