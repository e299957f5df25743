"""Packs many reads of a serial line into one message of a log, and unpacks them again."""

# Layout: a protobuf message (protobuf.dev/programming-guides/encoding), which Foxglove and the mcap
# tool read by the descriptor in the log. Its fields in the order in which they are written:
#
#     09  8 bytes             fixed64 ts_ns         time of the first read, UTC ns, little-endian
#     12  length, UTF-8       string link           name of the serial line
#     1a  length, bytes       bytes data            bytes of all reads, one after the other
#     20  varint              uint32 unit_ns        unit of `waits` in ns: 10,000, 100 or 1
#     2a  length, varints     int64 waits           time since the previous read, in units; first 0
#     32  length, varints     uint32 sizes          bytes of each read; absent if each has one
#     3a  length, varints     Direction directions  who sent each read: 0 unknown, 1 request,
#                                                   2 response; absent if all are unknown
#
# A varint has 7 bits in each byte, the lowest first; bit 7 is set in all but its last byte. A
# negative wait has the 64 bits of its two's complement. Lengths are varints, too. At 9600 baud or
# faster, the wait between two consecutive bytes fits in a varint of one byte.
#
# Limit: MAX_READS reads in a message.

from __future__ import annotations

import struct
from itertools import pairwise

from mbtool.core import Chunk, Direction, Stamp

MAX_READS = 4096
UNITS_NS = (10_000, 100, 1)
"""The units in ns for the times between reads. A message uses the first unit in which all these
times are whole numbers, so that no time is rounded."""
MAX_TIME_NS = 1 << 62

_TIME = struct.Struct("<Q")
_FIXED64, _TEXT, _VARINT = 1, 2, 0
_DIRECTIONS = (Direction.UNKNOWN, Direction.REQUEST, Direction.RESPONSE)
_NUMBERS = {direction: number for number, direction in enumerate(_DIRECTIONS)}
_TS_NS, _LINK, _DATA, _UNIT_NS, _WAITS, _SIZES, _SENDERS = range(1, 8)
_FIELDS = {
    _TS_NS: ("ts_ns", 6),
    _LINK: ("link", 9),
    _DATA: ("data", 12),
    _UNIT_NS: ("unit_ns", 13),
    _WAITS: ("waits", 3),
    _SIZES: ("sizes", 13),
    _SENDERS: ("directions", 14),
}
"""The name and the type (FieldDescriptorProto.Type) of each field, by its number."""


def is_joinable(chunk: Chunk) -> bool:
    """True if a chunk is a read of a serial port and its time is from 0 to MAX_TIME_NS.

    Only such chunks are joined into one message.
    """
    is_read = chunk.connection is None and chunk.stamp is Stamp.LAST_BYTE
    return is_read and 0 <= chunk.ts_ns < MAX_TIME_NS


def pack_reads(reads: list[Chunk]) -> bytes:
    """Pack 1 to MAX_READS reads of one line into a message; each must satisfy `is_joinable`."""
    times = [read.ts_ns for read in reads]
    waits = [0, *(after - before for before, after in pairwise(times))]
    unit_ns = next(unit for unit in UNITS_NS if not any(wait % unit for wait in waits))
    sizes = [len(read.data) for read in reads]
    directions = [_NUMBERS[read.direction] for read in reads]
    message = b"\x09" + _TIME.pack(times[0])
    message += b"\x12" + _block(reads[0].link.encode())
    message += b"\x1a" + _block(b"".join(read.data for read in reads))
    message += b"\x20" + _varint(unit_ns)
    message += b"\x2a" + _block(_varints([wait // unit_ns for wait in waits]))
    if any(size != 1 for size in sizes):
        message += b"\x32" + _block(_varints(sizes))
    if any(directions):
        message += b"\x3a" + _block(_varints(directions))
    return message


def unpack_reads(message: bytes) -> list[Chunk]:
    """Unpack the reads of a message, at least one.

    Raises ValueError if `joined` did not make the message.
    """
    numbers, texts = _fields_of(message)
    if not (numbers.keys() == {_TS_NS, _UNIT_NS} and {_LINK, _DATA, _WAITS} <= texts.keys()):
        raise ValueError("a field of joined reads is missing")
    ts_ns, unit_ns = numbers[_TS_NS], numbers[_UNIT_NS]
    link, data = texts[_LINK].decode(), texts[_DATA]
    waits = _unpack_varints(texts[_WAITS])
    if not waits:
        raise ValueError("joined reads without a read")
    sizes = _unpack_varints(texts[_SIZES]) if _SIZES in texts else [1] * len(waits)
    directions = _unpack_varints(texts[_SENDERS]) if _SENDERS in texts else [0] * len(waits)
    if sum(sizes) != len(data) or max(directions, default=0) >= len(_DIRECTIONS):
        raise ValueError(f"reads of {sum(sizes)} bytes in all, and {len(data)} bytes")
    at = 0
    reads = []
    for wait, size, sender in zip(waits, sizes, directions, strict=True):
        ts_ns += (wait if wait < 1 << 63 else wait - (1 << 64)) * unit_ns
        piece = data[at : at + size]
        reads.append(Chunk(ts_ns=ts_ns, link=link, data=piece, direction=_DIRECTIONS[sender]))
        at += size
    return reads


def descriptor() -> bytes:
    """The message's protobuf descriptor, a FileDescriptorSet, which MCAP stores as schema."""
    values = b"".join(
        _field(2, _field(1, direction.name) + _number(2, number))
        for direction, number in _NUMBERS.items()
    )
    fields = b"".join(_field(2, _field_description(number)) for number in _FIELDS)
    enumeration = _field(4, _field(1, "Direction") + values)
    message = _field(4, _field(1, "Evidence") + fields + enumeration)
    file = _field(1, "mbtool/evidence.proto") + _field(2, "mbtool") + message
    return _field(1, file + _field(12, "proto3"))


def _field_description(number: int) -> bytes:
    """The FieldDescriptorProto (protobuf's description) of the field with this number."""
    name, kind = _FIELDS[number]
    label = 3 if number in (_WAITS, _SIZES, _SENDERS) else 1  # 1 optional, 3 repeated
    field = _field(1, name) + _number(3, number) + _number(4, label) + _number(5, kind)
    return field + (_field(6, ".mbtool.Evidence.Direction") if number == _SENDERS else b"")


def _fields_of(message: bytes) -> tuple[dict[int, int], dict[int, bytes]]:
    """Return the values of a message's integer fields and of its other fields, by field number.

    The others are length-delimited: their values are bytes.

    Raises ValueError if the bytes are no message of joined reads.
    """
    numbers: dict[int, int] = {}
    texts: dict[int, bytes] = {}
    at = 0
    while at < len(message):
        number, kind = message[at] >> 3, message[at] & 7
        at += 1
        if (number, kind) == (_TS_NS, _FIXED64) and at + _TIME.size <= len(message):
            (numbers[number],) = _TIME.unpack_from(message, at)
            at += _TIME.size
        elif (number, kind) == (_UNIT_NS, _VARINT):
            numbers[number], at = _number_at(message, at)
        elif kind == _TEXT and number in _FIELDS and number not in (_TS_NS, _UNIT_NS):
            length, at = _number_at(message, at)
            texts[number] = message[at : at + length]
            at += length
        else:
            raise ValueError(f"no field of joined reads: {number}, of wire type {kind}")
    if at != len(message):
        raise ValueError("joined reads that end too early")
    return numbers, texts


def _unpack_varints(packed: bytes) -> list[int]:
    """Decode the varints of a packed field.

    Raises ValueError if there are more than MAX_READS, or if one is cut off.
    """
    if packed.isascii() and len(packed) <= MAX_READS:
        return [*packed]
    numbers = []
    at = 0
    while at < len(packed):
        number, at = _number_at(packed, at)
        numbers.append(number)
        if len(numbers) > MAX_READS:
            raise ValueError(f"more than {MAX_READS} reads in a message")
    return numbers


def _number_at(data: bytes, at: int) -> tuple[int, int]:
    """Return the value of the varint at offset `at`, and the offset of the byte after it."""
    number = 0
    for place, byte in enumerate(data[at : at + 10]):
        number |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return number, at + place + 1
    raise ValueError("a number that does not end")


def _varints(numbers: list[int]) -> bytes:
    if min(numbers) >= 0 and max(numbers) < 0x80:
        return bytes(numbers)
    return b"".join(map(_varint, numbers))


def _varint(number: int) -> bytes:
    number &= (1 << 64) - 1
    found = bytearray()
    while number > 0x7F:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)


def _block(data: bytes) -> bytes:
    return _varint(len(data)) + data


def _field(number: int, value: str | bytes) -> bytes:
    return bytes([number << 3 | _TEXT]) + _block(
        value.encode() if isinstance(value, str) else value
    )


def _number(number: int, value: int) -> bytes:
    return bytes([number << 3 | _VARINT]) + _varint(value)
