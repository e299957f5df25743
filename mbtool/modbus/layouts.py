"""The building blocks of the function table: how the bytes after a function code are laid out."""

# A Layout is a row of fixed-width integers and then at most one tail of variable length. The same
# object answers three questions, so that they cannot disagree:
#
#     length(pdu)     how long the whole PDU is by its structure, from as little of it as possible
#     parse(pdu)      its fields by name, and what is wrong with its form, if anything
#     encode(fields)  the bytes after the function code
#
# Parsing keeps what it can: of a PDU that is too short come the fields that are whole, of one that
# is too long those that belong there. Encoding is strict and raises ValueError.

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

Value = int | bytes | tuple[int, ...] | tuple["Group", ...]
"""An integer, opaque bytes, registers or bits, or the groups of a file or identification record."""
Group = tuple[int | bytes | tuple[int, ...], ...]
Fields = dict[str, Value]

USUAL_DIAGNOSTIC_BYTES = 2


class Tail(Protocol):
    """The variable part of a layout. `at` is where it begins in the PDU."""

    def length(self, pdu: bytes, at: int) -> int | None:
        """Its length in bytes, or None where more bytes are needed to know."""

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        """Add its fields; the answer says what is wrong, or is None."""

    def encode(self, fields: Mapping[str, Value]) -> bytes: ...


class Layout:
    """The form of one direction of one function."""

    __slots__ = ("_head", "_names", "_size", "_tail")

    def __init__(self, *fixed: tuple[str, int], tail: Tail | None = None) -> None:
        """`fixed` are names with their width in bytes, 1 or 2."""
        self._names = tuple(name for name, _ in fixed)
        self._head = struct.Struct(">" + "".join("xBH"[width] for _, width in fixed))
        self._size = 1 + self._head.size
        self._tail = tail

    def length(self, pdu: bytes) -> int | None:
        """The whole PDU's length by its structure, or None where more bytes are needed to know."""
        if self._tail is None:
            return self._size
        tail = self._tail.length(pdu, self._size)
        return None if tail is None else self._size + tail

    def parse(self, pdu: bytes) -> tuple[Fields, str | None]:
        """Its fields, and what is wrong with its form, if anything."""
        if len(pdu) < self._size:
            return self._parse_short(pdu), f"{len(pdu)} bytes, where its function has {self._size}"
        fields: Fields = dict(zip(self._names, self._head.unpack_from(pdu, 1), strict=True))
        if self._tail is not None:
            return fields, self._tail.parse(pdu, self._size, fields)
        if len(pdu) > self._size:
            return fields, f"{len(pdu)} bytes, where its function has {self._size}"
        return fields, None

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        """The bytes after the function code. Raises ValueError for what cannot be sent."""
        try:
            head = self._head.pack(*(fields[name] for name in self._names))
        except KeyError as error:
            raise ValueError(f"field {error.args[0]!r} is missing") from error
        except struct.error as error:
            values = {name: fields[name] for name in self._names}
            raise ValueError(f"a field does not fit its width: {values}") from error
        return head + (self._tail.encode(fields) if self._tail is not None else b"")

    def _parse_short(self, pdu: bytes) -> Fields:
        fields: Fields = {}
        at = 1
        for name, code in zip(self._names, self._head.format[1:], strict=True):
            width = 1 if code == "B" else 2
            if at + width > len(pdu):
                break
            fields[name] = int.from_bytes(pdu[at : at + width])
            at += width
        return fields


@dataclass(frozen=True, slots=True)
class Registers:
    """A byte count and that many bytes of 16-bit registers."""

    name: str = "values"
    count_width: int = 1
    """Width of the byte count."""

    def length(self, pdu: bytes, at: int) -> int | None:
        return _counted_length(pdu, at, self.count_width)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = _counted_data(pdu, at, self.count_width)
        fields[self.name] = words(data)
        return problem or ("an odd number of bytes for registers" if len(data) % 2 else None)

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        return _counted(pack_words(_sequence(fields, self.name)), self.count_width)


@dataclass(frozen=True, slots=True)
class Bits:
    """A byte count and bits, the lowest address in bit 0 of the first byte (V1.1b3, 6.1)."""

    name: str = "values"
    quantity: str | None = None
    """The field that says how many of the bits count; without it all are kept."""

    def length(self, pdu: bytes, at: int) -> int | None:
        return _counted_length(pdu, at, 1)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = _counted_data(pdu, at, 1)
        bits = unpack_bits(data)
        quantity = fields.get(self.quantity) if self.quantity else None
        fields[self.name] = bits if not isinstance(quantity, int) else bits[:quantity]
        return problem

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        return _counted(pack_bits(_sequence(fields, self.name)), 1)


@dataclass(frozen=True, slots=True)
class Bytes:
    """A byte count and opaque bytes, or (count_width 0) all that is left."""

    name: str = "data"
    count_width: int = 1
    usual: int = 0
    """The length to expect where no byte count tells it."""

    def length(self, pdu: bytes, at: int) -> int | None:
        return _counted_length(pdu, at, self.count_width) if self.count_width else self.usual

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        if not self.count_width:
            fields[self.name] = pdu[at:]
            return None
        fields[self.name], problem = _counted_data(pdu, at, self.count_width)
        return problem

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        data = fields.get(self.name, b"")
        if not isinstance(data, bytes):
            raise ValueError(f"field {self.name!r} must be bytes")
        return _counted(data, self.count_width) if self.count_width else data


@dataclass(frozen=True, slots=True)
class Words:
    """Registers to the end of the PDU, without a count."""

    name: str = "values"
    usual: int = USUAL_DIAGNOSTIC_BYTES

    def length(self, pdu: bytes, at: int) -> int | None:
        return self.usual

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data = pdu[at:]
        fields[self.name] = words(data)
        return "an odd number of bytes for registers" if len(data) % 2 else None

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        return pack_words(_sequence(fields, self.name))


@dataclass(frozen=True, slots=True)
class FileGroups:
    """The sub-requests of the file record functions (V1.1b3, 6.14 and 6.15).

    Each is `06 file record length`, and with `with_data` that many registers.
    A group is parsed as (file, record, length) or (file, record, registers).
    """

    with_data: bool

    def length(self, pdu: bytes, at: int) -> int | None:
        return _counted_length(pdu, at, 1)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = _counted_data(pdu, at, 1)
        groups: list[Group] = []
        place = 0
        while place + 7 <= len(data):
            reference, file, record, length = struct.unpack_from(">BHHH", data, place)
            place += 7
            if reference != _FILE_REFERENCE:
                problem = problem or f"reference type {reference}, where only 6 is defined"
            if self.with_data:
                groups.append((file, record, words(data[place : place + 2 * length])))
                place += 2 * length
            else:
                groups.append((file, record, length))
        fields["groups"] = tuple(groups)
        return problem or (None if place == len(data) else _HALF_GROUP)

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        data = b""
        for group in _groups(fields):
            file, record, last = group
            registers = last if isinstance(last, tuple) else ()
            length = len(registers) if self.with_data else last
            data += struct.pack(">BHHH", _FILE_REFERENCE, file, record, length)
            data += pack_words(registers)
        return _counted(data, 1)


@dataclass(frozen=True, slots=True)
class FileAnswers:
    """The sub-responses of read file record: `length 06 registers`; a group is the registers."""

    def length(self, pdu: bytes, at: int) -> int | None:
        return _counted_length(pdu, at, 1)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = _counted_data(pdu, at, 1)
        groups: list[Group] = []
        place = 0
        while place + 2 <= len(data):
            length = data[place]
            if length == 0:
                break
            groups.append((words(data[place + 2 : place + 1 + length]),))
            place += 1 + length
        fields["groups"] = tuple(groups)
        return problem or (None if place == len(data) else _HALF_GROUP)

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        data = b""
        for (registers,) in _groups(fields):
            body = pack_words(registers if isinstance(registers, tuple) else ())
            data += bytes([1 + len(body), _FILE_REFERENCE]) + body
        return _counted(data, 1)


@dataclass(frozen=True, slots=True)
class Objects:
    """The objects of a device identification: a number, then `id length value` (V1.1b3, 6.21)."""

    def length(self, pdu: bytes, at: int) -> int | None:
        if len(pdu) <= at:
            return None
        place = at + 1
        for _ in range(pdu[at]):
            if len(pdu) <= place + 1:
                return None
            place += 2 + pdu[place + 1]
        return place - at

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        objects: list[Group] = []
        place = at + 1
        count = pdu[at] if at < len(pdu) else 0
        while len(objects) < count and place + 2 <= len(pdu):
            end = place + 2 + pdu[place + 1]
            if end > len(pdu):
                break
            objects.append((pdu[place], pdu[place + 2 : end]))
            place = end
        fields["objects"] = tuple(objects)
        return None if len(objects) == count and place == len(pdu) else "its objects do not fill it"

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        objects = fields.get("objects", ())
        if not isinstance(objects, tuple):
            raise ValueError("field 'objects' must be a tuple of (id, value)")
        data = bytes([len(objects)])
        for one in objects:
            match one:
                case (int(number), bytes(value)):
                    data += bytes([number, len(value)]) + value
                case _:
                    raise ValueError("an object is (id, value as bytes)")
        return data


@dataclass(frozen=True, slots=True)
class Choice:
    """A one-byte type and the layout that goes with it; other types are kept as bytes."""

    name: str
    layouts: Mapping[int, Layout]

    def length(self, pdu: bytes, at: int) -> int | None:
        if len(pdu) <= at:
            return None
        layout = self.layouts.get(pdu[at], _OPAQUE)
        rest = layout.length(pdu[at:])
        return rest

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        if len(pdu) <= at:
            return f"{len(pdu)} bytes, where its function has more"
        fields[self.name] = pdu[at]
        inner, problem = self.layouts.get(pdu[at], _OPAQUE).parse(pdu[at:])
        fields.update(inner)
        return problem

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        kind = fields.get(self.name)
        if not isinstance(kind, int):
            raise ValueError(f"field {self.name!r} is missing")
        return bytes([kind]) + self.layouts.get(kind, _OPAQUE).encode(fields)


_FILE_REFERENCE = 6
_HALF_GROUP = "its byte count does not end with a group"
_OPAQUE = Layout(tail=Bytes("data", count_width=0))


def words(data: bytes) -> tuple[int, ...]:
    """Big-endian 16-bit registers; an odd last byte is left out."""
    count = len(data) // 2
    return struct.unpack_from(f">{count}H", data)


def pack_words(values: Sequence[int]) -> bytes:
    """Registers as bytes. Raises ValueError outside 0..65535."""
    try:
        return struct.pack(f">{len(values)}H", *values)
    except struct.error as error:
        raise ValueError(f"registers hold 0..65535, not {list(values)}") from error


def unpack_bits(data: bytes) -> tuple[int, ...]:
    """Every bit, the lowest of the first byte first."""
    return tuple(byte >> bit & 1 for byte in data for bit in range(8))


def pack_bits(values: Sequence[int]) -> bytes:
    """Bits as bytes, the first in bit 0 of the first byte, the rest of the last byte 0."""
    number = sum(1 << place for place, value in enumerate(values) if value)
    return number.to_bytes((len(values) + 7) // 8, "little")


def _counted_length(pdu: bytes, at: int, width: int) -> int | None:
    if len(pdu) < at + width:
        return None
    return width + int.from_bytes(pdu[at : at + width])


def _counted_data(pdu: bytes, at: int, width: int) -> tuple[bytes, str | None]:
    if len(pdu) < at + width:
        return b"", "its byte count is missing"
    count = int.from_bytes(pdu[at : at + width])
    data = pdu[at + width : at + width + count]
    held = len(pdu) - at - width
    return data, None if held == count else f"byte count {count}, but {held} bytes follow"


def _counted(data: bytes, width: int) -> bytes:
    if len(data) >= 1 << 8 * width:
        raise ValueError(f"{len(data)} bytes of data do not fit a byte count of {width} bytes")
    return len(data).to_bytes(width) + data


def _sequence(fields: Mapping[str, Value], name: str) -> Sequence[int]:
    values = fields.get(name, ())
    if not isinstance(values, tuple | list):
        raise ValueError(f"field {name!r} must be a sequence of integers")
    return [int(value) for value in values if isinstance(value, int)]


def _groups(fields: Mapping[str, Value]) -> Sequence[Group]:
    groups = fields.get("groups", ())
    if not isinstance(groups, tuple) or not all(isinstance(group, tuple) for group in groups):
        raise ValueError("field 'groups' must be a tuple of tuples")
    return [group for group in groups if isinstance(group, tuple)]
