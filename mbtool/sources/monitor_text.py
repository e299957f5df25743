"""Reads the text that PassiveModbusMonitor prints of an RTU line."""

#     2023-02-28 17:14:21.619992 Read holding register for device ID 1 , Start address = 258 ...
#     2023-02-28 17:14:21.671974  * Response 1 from device ID 1 , data = 2376
#     2023-02-28 17:14:21.671974  * Illegal Data Address exception
#
# The program (github.com/mr-entropia/PassiveModbusMonitor) prints a request or a response when its
# last byte is there, without the bytes. Since a line says all that was in the frame, the frame is
# made again, with the check that it must have had, and goes the way of any other. The lengths of
# the functions 0FH and 10H are not in the text: such lines, and what else is not understood, come
# out as events. Device IDs, exception codes and the bytes of coils are hexadecimal, all else is
# decimal. Times are the local ones of that machine, and taken for UTC.
#
# Holds one response: at most MAX_VALUES values. A row is read to MAX_ROW bytes.

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from struct import pack
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from mbtool.core import (
    Chunk,
    CutError,
    Direction,
    EventKind,
    InputError,
    LineSettings,
    SerialFormat,
    WireEvent,
)
from mbtool.modbus import ascii_adu, exception_pdu, rtu_adu
from mbtool.sources.byte_files import SerialBytes

if TYPE_CHECKING:
    from collections.abc import Iterator

MAX_VALUES = 250
MAX_ROW = 1024

_TIME = r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d(?:\.\d{6})?) "
_BEGINS = re.compile((_TIME + r"(?:Read|Write| \*) ").encode())
_LINE = re.compile(_TIME + r"(.*)", re.ASCII)
_REQUEST = re.compile(
    r"([\w ]+) for device ID +([\da-f]{1,2}) , Start address = (\d{1,5}) Quantity = (\d{1,5})",
    re.ASCII,
)
_VALUE = re.compile(
    r" \* Response (\d{1,3}) from device ID ([\da-f]{1,2}) , data = ([\da-f]{1,5})", re.ASCII
)
_ECHO = re.compile(
    r" \* Response from device ID ([\da-f]{1,2})  Address (\d{1,5}) is now (\d{1,5})", re.ASCII
)
_EXCEPTION = re.compile(
    r" \* (?:Illegal Data Address exception|Exception! Code: ([\da-f]{1,2}))", re.ASCII
)
_OF_VALUES = re.compile(r" +\* Float: ", re.ASCII)
"""A second reading of values that stand before it."""

_FUNCTIONS = {
    "Read coils": 0x01,
    "Read discrete inputs": 0x02,
    "Read holding register": 0x03,
    "Read input register": 0x04,
    "Write single coil": 0x05,
    "Write single register": 0x06,
}
_BITS = (0x01, 0x02)
_ILLEGAL_DATA_ADDRESS = 2
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class _Request(NamedTuple):
    function: int
    unit: int
    quantity: int


def read_monitor_text(
    stream: BinaryIO, name: str, link: str, line: LineSettings | None
) -> SerialBytes:
    """`line` is what the user says of the line."""
    line = line or LineSettings(SerialFormat())
    return SerialBytes(line, _TextReader(name, link, line).pieces(stream))


def is_monitor_text(head: bytes) -> bool:
    """Whether a file that begins like this is of this kind."""
    return _BEGINS.match(head) is not None


class _TextReader:
    def __init__(self, name: str, link: str, line: LineSettings) -> None:
        self._name = name
        self._link = link
        self._adu = ascii_adu if line.ascii else rtu_adu
        self._ts_ns = 0
        self._request: _Request | None = None
        self._values: list[bytes] = []
        self._values_unit = 0
        self._values_ns = 0

    def pieces(self, stream: BinaryIO) -> Iterator[Chunk | WireEvent]:
        row = 0
        while line := stream.readline(MAX_ROW):
            row += 1
            if len(line) == MAX_ROW and not line.endswith(b"\n"):
                raise InputError(f"{self._name}: row {row}: more than {MAX_ROW} characters")
            text = line.decode("utf-8", "replace").rstrip("\r\n")
            match = _LINE.fullmatch(text)
            ts_ns = _ns(match[1]) if match is not None else None
            if match is None or ts_ns is None:
                if not line.endswith(b"\n"):
                    raise self._cut(row)
                yield from self._other(text)
                continue
            self._ts_ns = ts_ns
            yield from self._take(match[2])
        if self._is_short():
            raise self._cut(row)
        yield from self._response()

    def _take(self, text: str) -> Iterator[Chunk | WireEvent]:
        if value := _VALUE.fullmatch(text):
            yield from self._value(text, int(value[1]), int(value[2], 16), value[3])
            return
        if _OF_VALUES.match(text):
            return
        yield from self._response()
        request = self._request
        if match := _REQUEST.fullmatch(text):
            yield from self._asked(text, match)
        elif (match := _ECHO.fullmatch(text)) and request is not None:
            numbers = int(match[2]), int(match[3])
            if max(numbers) > 0xFFFF:
                yield from self._other(text)
                return
            pdu = pack(">BHH", request.function, *numbers)
            yield self._chunk(int(match[1], 16), pdu, Direction.RESPONSE)
        elif (match := _EXCEPTION.fullmatch(text)) and request is not None:
            code = int(match[1], 16) if match[1] else _ILLEGAL_DATA_ADDRESS
            pdu = exception_pdu(request.function, code)
            yield self._chunk(request.unit, pdu, Direction.RESPONSE)
        else:
            yield from self._other(text)

    def _asked(self, text: str, match: re.Match[str]) -> Iterator[Chunk | WireEvent]:
        function = _FUNCTIONS.get(match[1])
        unit, address, quantity = int(match[2], 16), int(match[3]), int(match[4])
        if function is None or max(address, quantity) > 0xFFFF:
            self._request = None
            yield from self._other(text)
            return
        self._request = _Request(function, unit, quantity)
        yield self._chunk(unit, pack(">BHH", function, address, quantity), Direction.REQUEST)

    def _value(self, text: str, number: int, unit: int, data: str) -> Iterator[Chunk | WireEvent]:
        """Gather a value of a response."""
        if number != len(self._values) + 1:
            yield from self._response()
        request = self._request
        value = None
        if request is not None and number == len(self._values) + 1 <= MAX_VALUES:
            value = _value_bytes(request.function, data)
        if value is None:
            yield from self._other(text)
            return
        self._values.append(value)
        self._values_unit, self._values_ns = unit, self._ts_ns

    def _response(self) -> Iterator[Chunk]:
        """The response that was gathered, if any."""
        data = b"".join(self._values)
        self._values.clear()
        if data and self._request is not None:
            pdu = bytes((self._request.function, len(data) & 0xFF)) + data
            yield self._chunk(self._values_unit, pdu, Direction.RESPONSE, self._values_ns)

    def _is_short(self) -> bool:
        """Whether what is gathered is less than was asked for."""
        if self._request is None or not self._values:
            return False
        quantity = self._request.quantity
        is_bits = self._request.function in _BITS
        return len(self._values) < ((quantity + 7) // 8 if is_bits else quantity)

    def _chunk(
        self, unit: int, pdu: bytes, direction: Direction, ts_ns: int | None = None
    ) -> Chunk:
        return Chunk(
            ts_ns=self._ts_ns if ts_ns is None else ts_ns,
            link=self._link,
            data=self._adu(unit, pdu),
            direction=direction,
        )

    def _other(self, text: str) -> Iterator[WireEvent]:
        if text:
            yield WireEvent(
                ts_ns=self._ts_ns,
                link=self._link,
                kind=EventKind.UNREADABLE,
                message=f"a line that is not understood: {text.strip()}",
            )

    def _cut(self, row: int) -> CutError:
        return CutError(f"{self._name}: ends in the middle of a response, in row {row}")


def _value_bytes(function: int, data: str) -> bytes | None:
    """A register as decimal, eight bits as hexadecimal."""
    try:
        if function in _BITS:
            return bytes((int(data, 16),))
        return int(data).to_bytes(2, "big")
    except (ValueError, OverflowError):
        return None


def _ns(text: str) -> int | None:
    try:
        moment = datetime.fromisoformat(text).replace(tzinfo=UTC)
    except ValueError:
        return None
    return max((moment - _EPOCH) // timedelta(microseconds=1), 0) * 1000
