"""Reads byte times as CSV, as the UART decoder of a logic analyser writes them."""

#     t_start_s,t_end_s,line,byte_hex                        mbtool's own, and scripts around sigrok
#     0.0311790,0.0315970,tx,01
#
#     name,type,start_time,duration,data                     Saleae Logic 2
#     "Async Serial","data",0.0311790,0.000572916,0x01
#
#     Time [s],Value,Parity Error,Framing Error              Saleae Logic 1
#     0.031179000000000,0x01,,
#
# The header names the columns, in any order; COLUMNS has the names that are known. A file needs a
# column of start times and one of bytes; a column of end times or durations may be missing. Other
# columns are not used: all rows are of one serial line, in the order of time. Rows whose column
# `type` is not `data` are passed over. Times are in seconds, since the start of the recording or
# since 1970, or are ISO 8601; a recording that starts at 0 is shown as starting in 1970. An
# analyser that counts from its trigger gives negative times to the bytes before the trigger: then
# all times are shifted so that the first row is at 0.
#
# An analyser writes a byte as it displays it: as 0x01, as 0b0000 0001, as a decimal number, as a
# character with or without quotes (\r, COMMA), or as a character with its number behind it. The
# first rows tell which; a column whose name has "hex" needs no 0x.
#
# The time of a byte is the arrival of its stop bit. sigrok's decoder gives the end of the data bits
# as t_end_s. So if a byte ends less than one character time after its start, its time is its start
# plus one character time.
#
# The line's settings are found from the first rows: the duration of a byte gives the baud rate, and
# the shortest time between the starts of two bytes gives the number of bits of a character. Without
# durations, that shortest time must be 10 or 11 bits of a usual baud rate. 10 bits are taken as 8N1
# and 11 as 8E1; all formats with 11 bits have the same times. If no usual baud rate fits, the
# default settings are used.
#
# Memory: LOOKED_AT rows, each of at most MAX_ROW bytes.

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from decimal import Decimal, DecimalException
from itertools import chain, islice, pairwise
from statistics import median_low
from typing import BinaryIO, NamedTuple

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
from mbtool.sources.text_marks import iso_ns
from mbtool.sources.uart import BAUDS

START, END, DURATION, BYTE, TYPE = "t_start_s", "t_end_s", "duration", "byte_hex", "type"
COLUMNS = {
    START: (START, "start_time", "time [s]", "time[s]", "start [s]", "start", "time"),
    END: (END, "end_time", "end [s]", "end"),
    DURATION: (DURATION, "duration [s]"),
    BYTE: (BYTE, "data", "value", "hex", "byte"),
    TYPE: (TYPE,),
}
"""By its name here, the names that a column may have, the likeliest first. Case does not matter."""
_OF_ANALYSERS = COLUMNS[START][1:4]
"""Names of a column of start times that only analysers use. In a CSV with another name, the first
byte must be written as 0x01, as a table of measured values has times and values, too."""
LOOKED_AT = 1000
"""The line's settings are found from the first rows of the CSV file, at most this many."""
MAX_ROW = 4096
"""The most bytes that a row (a line of the CSV file) may have. A longer one raises InputError."""

_FRAME = re.compile(r"(?:0[xX])?[0-9A-Fa-f]{2}(?:[ :-]?[0-9A-Fa-f]{2}){3}", re.ASCII)
_BYTE = re.compile(r"(?:0[xX])?[0-9A-Fa-f]{2}", re.ASCII)
_PREFIXED = re.compile(r"(?:.*\()?(0[xX][0-9A-Fa-f]{1,2})\)?", re.ASCII | re.DOTALL)
_BINARY = re.compile(r"0b([01 ]{8,9})", re.ASCII)
_DECIMAL = re.compile(r"\d{1,3}", re.ASCII)
_WORDS = {"\\r": 13, "\\n": 10, "\\t": 9, "\\0": 0, "COMMA": 44, "": 32}
_ISO = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:.*", re.ASCII)
_MAX_NS = 2**63 - 1
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
    """True if a file that begins with these bytes is a CSV of byte times.

    If the header is not of the names that this program writes, the first row must have a byte.
    """
    lines = head.decode("utf-8", "replace").splitlines()
    places = _places(_split(lines[0])) if lines else {}
    if START not in places or BYTE not in places:
        return bool(lines) and START in _split(lines[0])
    cells = _split(lines[1]) if len(lines) > 1 else []
    if _split(lines[0])[places[START]] == START:
        # A column of whole frames makes the file a text log.
        return len(cells) <= places[BYTE] or not _FRAME.match(cells[places[BYTE]])
    if len(cells) <= max(places.values()):
        return False
    try:
        _parse_time_ns(cells[places[START]], START, "", 2)
    except InputError:
        return False
    cell = cells[places[BYTE]]
    is_analyser = _split(lines[0])[places[START]].lower() in _OF_ANALYSERS
    return _PREFIXED.fullmatch(cell) is not None or (is_analyser and _is_byte(cell))


def _places(header: Sequence[str]) -> dict[str, int]:
    """Return the index of each known column in a header, by its name in COLUMNS."""
    names = [name.lower() for name in header]
    return {
        column: names.index(known)
        for column, possible in COLUMNS.items()
        if (known := next((one for one in possible if one in names), None)) is not None
    }


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
        return _format_of_starts(rows)
    for bits in _LENGTHS:
        rate = bits * 1e9 / width_ns
        baud = min(BAUDS, key=lambda each: abs(each - rate))
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


def _format_of_starts(rows: Sequence[_Row]) -> SerialFormat:
    """Return the line settings that fit the shortest time between the starts of two bytes."""
    steps = (after.start_ns - before.start_ns for before, after in pairwise(rows))
    shortest_ns = min((step for step in steps if step > 0), default=0)
    for bits, parity in ((10, "N"), (11, "E")):
        for baud in BAUDS:
            if abs(shortest_ns * baud / 1e9 - bits) <= _TOLERANCE * bits:
                return SerialFormat(baud, 8, parity, 1)
    return SerialFormat()


def _rows(stream: BinaryIO, name: str) -> Iterator[_Row]:
    header, _ = _cells(stream, name, 1)
    places = _places(header)
    missing = [column for column in (START, BYTE) if column not in places]
    if missing:
        raise InputError(
            f"{name}: row 1: there is no column {missing[0]}; byte times need {START}, {BYTE} "
            f"and, if it is known, {END} or {DURATION}"
        )
    start_at, byte_at = places[START], places[BYTE]
    end_at, duration_at, type_at = (places.get(one) for one in (END, DURATION, TYPE))
    read_byte = _ByteReader(is_hex="hex" in header[byte_at].lower())
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
                raise _row_error(
                    name, number, f"{len(cells)} columns, where row 1 has {len(header)}"
                )
            if type_at is not None and cells[type_at] != "data":
                continue
            start_ns = end_ns = _parse_time_ns(cells[start_at], header[start_at], name, number)
            if end_at is not None:
                end_ns = _parse_time_ns(cells[end_at], header[end_at], name, number)
            elif duration_at is not None:
                end_ns += _parse_time_ns(cells[duration_at], header[duration_at], name, number)
            if end_ns < start_ns:
                raise _row_error(name, number, f"{END} is before {START}")
            if shift_ns is None:
                shift_ns = max(0, -start_ns)
            if start_ns + shift_ns < 0:
                shown = _cut_text(cells[start_at])
                what = f"{header[start_at]} is {shown}, before that of the first row"
                raise _row_error(name, number, what)
            byte = read_byte.read(cells[byte_at], header[byte_at], name, number)
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
        raise _row_error(name, number, f"more than {MAX_ROW} characters")
    return _split(line.decode("utf-8", "replace")), is_whole


def _split(line: str) -> list[str]:
    """Return the cells of a row, without quotes and spaces around them."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(",")]
    try:
        return [cell.strip() for cell in next(csv.reader([line.rstrip("\r\n")]))]
    except (csv.Error, StopIteration):
        return [cell.strip().strip('"') for cell in line.split(",")]


def _parse_time_ns(text: str, column: str, name: str, number: int) -> int:
    try:
        if _ISO.fullmatch(text):
            return iso_ns(text.encode())
        value = Decimal(text) * 1_000_000_000
        if -_MAX_NS <= value <= _MAX_NS:
            return round(value)
    except (DecimalException, ValueError):
        pass
    raise _row_error(
        name, number, f"{column} is {_cut_text(text)}; a number of seconds would be right"
    )


def _is_byte(text: str) -> bool:
    return bool(_PREFIXED.fullmatch(text) or _BINARY.fullmatch(text) or len(text) <= 3)


class _ByteReader:
    """Reads the bytes of a column, in the way in which its first bytes are written."""

    def __init__(self, *, is_hex: bool) -> None:
        self._is_hex = is_hex
        self._is_decimal: bool | None = None

    def read(self, text: str, column: str, name: str, number: int) -> int:
        """Read a byte. Raises InputError, which names `column`, the file and the row `number`."""
        if self._is_hex:
            if _BYTE.fullmatch(text) is None:
                raise _row_error(
                    name, number, f"{column} is {_cut_text(text)}; 00 to ff would be right"
                )
            return int(text, 16)
        prefixed = _PREFIXED.fullmatch(text)
        if prefixed is not None:
            return int(prefixed[1], 16)
        binary = _BINARY.fullmatch(text)
        if binary is not None:
            return int(binary[1].replace(" ", ""), 2)
        if self._is_decimal is None:
            # A single digit may be a character or a number; a unit is seldom above 9 in decimal.
            self._is_decimal = _DECIMAL.fullmatch(text) is not None
        if self._is_decimal and _DECIMAL.fullmatch(text) and int(text) <= 0xFF:
            return int(text)
        character = text[1:-1] if len(text) > 2 and text[0] == text[-1] == "'" else text
        byte = _WORDS.get(character, ord(character) if len(character) == 1 else None)
        if self._is_decimal or byte is None or byte > 0xFF:
            raise _row_error(
                name, number, f"{column} is {_cut_text(text)}; 0x00 to 0xff would be right"
            )
        return byte


def _cut_text(text: str) -> str:
    return ascii(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")


def _row_error(name: str, number: int, problem: str) -> InputError:
    return InputError(f"{name}: row {number}: {problem}")
