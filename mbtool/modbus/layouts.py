"""Layouts of the bytes after a function code; the table in functions.py is made of them."""

# A Layout is a list of integers of fixed width, then at most one tail of variable length. The same
# object does three things, so that they always agree:
#
#     length(pdu)     finds the length of the whole PDU, from as few bytes as possible
#     parse(pdu)      returns the fields by name, and a text about the error if the form is wrong
#     encode(fields)  returns the bytes after the function code
#
# Parsing returns as many fields as possible. From a PDU that is too short it returns the complete
# fields; in a PDU that is too long it ignores the extra bytes. Encoding is strict: it raises
# ValueError if a field is missing, or if a value has a wrong type or does not fit.
#
# The tails that consist of groups (file records, identification objects) are at the end.

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import Protocol

# The functions below pack registers and bits into bytes, and unpack them.

_BITS = [tuple(byte >> bit & 1 for bit in range(8)) for byte in range(256)]


def words(data: bytes) -> tuple[int, ...]:
    """Unpack 16-bit registers, high byte first; an odd last byte is left out."""
    return _registers(len(data) // 2).unpack_from(data)


@lru_cache
def _registers(count: int) -> struct.Struct:
    return struct.Struct(f">{count}H")


def pack_words(values: Sequence[int]) -> bytes:
    """Pack registers, high byte first. Raises ValueError for values outside 0..65535."""
    try:
        return struct.pack(f">{len(values)}H", *values)
    except struct.error as error:
        raise ValueError(f"registers hold 0..65535, not {list(values)}") from error


def unpack_bits(data: bytes) -> tuple[int, ...]:
    """Unpack all bits; the first is bit 0 of the first byte (V1.1b3, 6.1)."""
    return tuple(chain.from_iterable([_BITS[byte] for byte in data]))


def pack_bits(values: Sequence[int]) -> bytes:
    """Pack bits, the first into bit 0 of the first byte; unused bits of the last byte are 0.

    Raises ValueError for values other than 0 and 1.
    """
    if any(value not in (0, 1) for value in values):
        raise ValueError(f"bits are 0 or 1, not {list(values)}")
    digits = "".join("1" if value else "0" for value in reversed(values))
    return int(digits or "0", 2).to_bytes(bit_bytes(len(values)), "little")


def bit_bytes(quantity: int) -> int:
    """The number of bytes that `quantity` bits fill."""
    return (quantity + 7) // 8


Value = int | bytes | tuple[int, ...] | tuple["Group", ...]
"""The value of a field: an integer, bytes without a known meaning, a tuple of registers or bits, or
the groups of a file record or a device identification."""
Group = tuple[int | bytes | tuple[int, ...], ...]
Fields = dict[str, Value]

NO_LENGTH = 0
"""The result of `length` if the bytes of a PDU or tail do not tell its length."""
USUAL_DIAGNOSTIC_BYTES = 2
"""The number of data bytes that a PDU of function 08 has. Only its sub-function 0 may have more,
and nothing in the PDU tells how many (V1.1b3, 6.8)."""

COIL_VALUES = {0x0000: 0, 0xFF00: 1}
"""The two values that function 05 may carry, each with the bit that it means (V1.1b3, 6.5)."""


class Tail(Protocol):
    """The part of variable length at the end of a layout; `at` is the tail's offset in `pdu`."""

    def length(self, pdu: bytes, at: int) -> int | None:
        """The tail's length in bytes.

        NO_LENGTH if the tail's bytes do not tell it, None if more bytes are needed to know.
        """

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        """Add the tail's fields to `fields`, by name.

        Returns a text that says what is wrong with the tail's form; None if nothing is wrong.
        """

    def encode(self, fields: Mapping[str, Value]) -> bytes: ...


class Layout:
    """The layout of one function's requests, or responses, behind the function code."""

    __slots__ = ("_fixed", "_names", "_size", "_tail")

    def __init__(self, *fixed: tuple[str, int], tail: Tail | None = None) -> None:
        """`fixed` gives, in order, the name of each integer and its width in bytes, 1 or 2.

        `tail` is the part of variable length behind the integers, if there is one.
        """
        self._names = tuple(name for name, _ in fixed)
        self._fixed = struct.Struct(">" + "".join("xBH"[width] for _, width in fixed))
        self._size = 1 + self._fixed.size
        self._tail = tail

    def length(self, pdu: bytes, at: int = 0) -> int | None:
        """The length in bytes of the whole PDU that begins at offset `at` of `pdu`.

        NO_LENGTH if the bytes of a PDU do not tell its length, None if more bytes are needed to
        know.
        """
        if self._tail is None:
            return self._size
        tail = self._tail.length(pdu, at + self._size)
        return self._size + tail if tail else tail

    @property
    def count_at(self) -> int:
        """The offset in the PDU of the byte count, if that has one byte and only its data follow.

        0 if the layout has no such byte count.
        """
        tail = self._tail
        if isinstance(tail, Bits) or (
            isinstance(tail, Registers | Bytes) and tail.count_width == 1
        ):
            return self._size
        return 0

    def parse(self, pdu: bytes) -> tuple[Fields, str | None]:
        """Return the fields of a PDU by name, and a text that says what is wrong with its form.

        The text is None if nothing is wrong.
        """
        if len(pdu) < self._size:
            return self._parse_short(pdu), self._wrong_size(pdu)
        fields: Fields = {}
        if self._names:
            fields.update(zip(self._names, self._fixed.unpack_from(pdu, 1), strict=True))
        if self._tail is not None:
            return fields, self._tail.parse(pdu, self._size, fields)
        return fields, self._wrong_size(pdu) if len(pdu) > self._size else None

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        """Make the bytes after the function code from the fields by name.

        Raises ValueError if a field is missing, has a wrong type or does not fit its width.
        """
        values = [_field(fields, name) for name in self._names]
        try:
            fixed = self._fixed.pack(*values)
        except struct.error as error:
            given = dict(zip(self._names, values, strict=True))
            raise ValueError(f"a field does not fit its width: {given}") from error
        return fixed + (self._tail.encode(fields) if self._tail is not None else b"")

    @property
    def heads(self) -> list[tuple[str, int]]:
        """The name and width in bytes of each integer of fixed width.

        The last one is `byte_count` if the tail begins with a byte count.
        """
        widths = [1 if code == "B" else 2 for code in self._fixed.format[1:]]
        heads = list(zip(self._names, widths, strict=True))
        count = 1 if isinstance(self._tail, Bits) else getattr(self._tail, "count_width", 0)
        return [*heads, ("byte_count", count)] if count else heads

    def _parse_short(self, pdu: bytes) -> Fields:
        fields: Fields = {}
        at = 1
        for name, code in zip(self._names, self._fixed.format[1:], strict=True):
            width = 1 if code == "B" else 2
            if at + width > len(pdu):
                break
            fields[name] = int.from_bytes(pdu[at : at + width])
            at += width
        return fields

    def _wrong_size(self, pdu: bytes) -> str:
        least = "" if self._tail is None else "at least "
        return f"{len(pdu)} bytes, where its function has {least}{self._size}"


@dataclass(frozen=True, slots=True)
class Registers:
    """A byte count, followed by that many bytes of 16-bit registers."""

    name: str = "values"
    count_width: int = 1
    """Width of the byte count in bytes, 1 or 2."""
    quantity: str | None = None
    """The name of the field, before the byte count, that holds the number of registers; None if the
    layout has no such field."""

    def length(self, pdu: bytes, at: int) -> int | None:
        return counted_length(pdu, at, self.count_width)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = counted_data(pdu, at, self.count_width)
        fields[self.name] = words(data)
        if problem is not None:
            return problem
        if len(data) % 2:
            return "an odd number of bytes for registers"
        if self.quantity is None:
            return None
        quantity = fields.get(self.quantity)
        if isinstance(quantity, int) and len(data) != 2 * quantity:
            return f"{len(data) // 2} registers for a quantity of {quantity}"
        return None

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        return with_byte_count(pack_words(_integers(fields, self.name)), self.count_width)


@dataclass(frozen=True, slots=True)
class Bits:
    """A byte count and bits, the lowest address in bit 0 of the first byte (V1.1b3, 6.1)."""

    name: str = "values"
    quantity: str | None = None
    """The name of the field that holds the number of bits; None if the layout has no such field.
    Without it, parsing returns all bits of the bytes, also those that only fill the last byte."""

    def length(self, pdu: bytes, at: int) -> int | None:
        return counted_length(pdu, at, 1)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = counted_data(pdu, at, 1)
        bits = unpack_bits(data)
        quantity = fields.get(self.quantity) if self.quantity else None
        fields[self.name] = bits if not isinstance(quantity, int) else bits[:quantity]
        if problem is None and isinstance(quantity, int) and len(data) != bit_bytes(quantity):
            return f"{len(data)} bytes of bits for a quantity of {quantity}"
        return problem

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        return with_byte_count(pack_bits(_integers(fields, self.name)), 1)


@dataclass(frozen=True, slots=True)
class Bytes:
    """A byte count, followed by that many bytes, which are not interpreted.

    If `count_width` is 0 there is no byte count, and all bytes up to the PDU's end are kept.
    """

    name: str = "data"
    count_width: int = 1

    def length(self, pdu: bytes, at: int) -> int | None:
        return counted_length(pdu, at, self.count_width) if self.count_width else NO_LENGTH

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        if not self.count_width:
            fields[self.name] = pdu[at:]
            return None
        fields[self.name], problem = counted_data(pdu, at, self.count_width)
        return problem

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        data = _field(fields, self.name)
        if not isinstance(data, bytes):
            raise ValueError(f"field {self.name!r} must be bytes")
        return with_byte_count(data, self.count_width) if self.count_width else data


@dataclass(frozen=True, slots=True)
class UncountedRegisters:
    """One or more registers without a byte count, up to the end of the PDU."""

    name: str = "values"
    usual: int = USUAL_DIAGNOSTIC_BYTES
    """The number of bytes of the registers that is assumed where a PDU's end is not known yet."""

    def length(self, pdu: bytes, at: int) -> int | None:
        return self.usual

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data = pdu[at:]
        fields[self.name] = words(data)
        if not data:
            return "its data is missing"
        return "an odd number of bytes for registers" if len(data) % 2 else None

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        return pack_words(_integers(fields, self.name))


@dataclass(frozen=True, slots=True)
class CoilValue:
    """The value of function 05, which must be 0000H or FF00H (V1.1b3, 6.5).

    Other 16-bit values can be encoded, but parsing reports them as wrong.
    """

    name: str = "value"

    def length(self, pdu: bytes, at: int) -> int | None:
        return 2

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        if len(pdu) < at + 2:
            return "its value is missing"
        fields[self.name] = value = int.from_bytes(pdu[at : at + 2])
        if len(pdu) > at + 2:
            return f"{len(pdu)} bytes, where its function has {at + 2}"
        return None if value in COIL_VALUES else f"value {value:04X}H for a coil"

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        value = _field(fields, self.name)
        if not isinstance(value, int):
            raise ValueError(f"field {self.name!r} must be an integer")
        return pack_words([value])


@dataclass(frozen=True, slots=True)
class Choice:
    """A byte that names a type, followed by the layout for this type.

    `layouts` gives the layout of each type; the data of a type without one is kept as bytes.
    """

    name: str
    layouts: Mapping[int, Layout]

    def length(self, pdu: bytes, at: int) -> int | None:
        if len(pdu) <= at:
            return None
        return self.layouts.get(pdu[at], _OPAQUE).length(pdu, at)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        if len(pdu) <= at:
            return f"{len(pdu)} bytes, where its function has more"
        fields[self.name] = pdu[at]
        inner, problem = self.layouts.get(pdu[at], _OPAQUE).parse(pdu[at:])
        fields.update(inner)
        return problem

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        kind = _field(fields, self.name)
        if not isinstance(kind, int):
            raise ValueError(f"field {self.name!r} must be an integer")
        return bytes([kind]) + self.layouts.get(kind, _OPAQUE).encode(fields)


_OPAQUE = Layout(tail=Bytes(count_width=0))


def counted_length(pdu: bytes, at: int, width: int) -> int | None:
    """The length, in bytes, of a byte count and its data; None if the byte count is incomplete.

    The byte count begins at offset `at` of `pdu` and has `width` bytes.
    """
    if len(pdu) < at + width:
        return None
    return width + (pdu[at] if width == 1 else int.from_bytes(pdu[at : at + width]))


def counted_data(pdu: bytes, at: int, width: int) -> tuple[bytes, str | None]:
    """Return the data after a byte count, and a text if the PDU has more or fewer bytes than that.

    The text is None if the byte count is right. The byte count begins at offset `at` of `pdu` and
    has `width` bytes.
    """
    if len(pdu) < at + width:
        return b"", "its byte count is missing"
    count = pdu[at] if width == 1 else int.from_bytes(pdu[at : at + width])
    data = pdu[at + width : at + width + count]
    held = len(pdu) - at - width
    return data, None if held == count else f"byte count {count}, but {held} bytes follow"


def with_byte_count(data: bytes, width: int) -> bytes:
    """The data, preceded by a byte count of `width` bytes.

    Raises ValueError if the data are too long for such a count.
    """
    if len(data) >= 1 << 8 * width:
        raise ValueError(f"{len(data)} bytes of data do not fit a byte count of {width} bytes")
    return len(data).to_bytes(width) + data


def _field(fields: Mapping[str, Value], name: str) -> Value:
    try:
        return fields[name]
    except KeyError:
        raise ValueError(f"field {name!r} is missing") from None


def _integers(fields: Mapping[str, Value], name: str) -> Sequence[int]:
    values = _field(fields, name)
    if isinstance(values, tuple | list):
        integers = [value for value in values if isinstance(value, int)]
        if len(integers) == len(values):
            return integers
    raise ValueError(f"field {name!r} must be a sequence of integers")


# The layouts below are for PDUs that consist of groups: file records, identification objects.

_FILE_REFERENCE = 6
_HALF_GROUP = "its byte count does not end with a group"


@dataclass(frozen=True, slots=True)
class FileGroups:
    """The sub-requests of the file record functions (V1.1b3, 6.14 and 6.15).

    Each sub-request is a group: the byte 06, file number, record number and length in registers. In
    a write request (`with_data` is True) the registers follow. A group of a read request is parsed
    as (file, record, length), a group of a write request as (file, record, registers).
    """

    with_data: bool

    def length(self, pdu: bytes, at: int) -> int | None:
        return counted_length(pdu, at, 1)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = counted_data(pdu, at, 1)
        groups: list[Group] = []
        place = 0
        while place + 7 <= len(data):
            reference, file, record, length = struct.unpack_from(">BHHH", data, place)
            place += 7
            problem = problem or _wrong_reference(reference)
            if self.with_data:
                groups.append((file, record, words(data[place : place + 2 * length])))
                place += 2 * length
            else:
                groups.append((file, record, length))
        fields["groups"] = tuple(groups)
        return problem or (None if place == len(data) else _HALF_GROUP)

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        data = b""
        for group in _groups(fields, "groups"):
            match group:
                case (int(file), int(record), int(length)) if not self.with_data:
                    numbers, body = (file, record, length), b""
                case (int(file), int(record), tuple(registers)) if self.with_data:
                    numbers, body = (file, record, len(registers)), pack_words(registers)
                case _:
                    last = "registers" if self.with_data else "length"
                    raise ValueError(f"a group is (file, record, {last}), not {group}")
            data += bytes([_FILE_REFERENCE]) + pack_words(numbers) + body
        return with_byte_count(data, 1)


@dataclass(frozen=True, slots=True)
class FileResponses:
    """The sub-responses of read file record (V1.1b3, 6.14).

    Each sub-response is a length in bytes, the byte 06 and the registers. It is parsed as a tuple
    with one element, the tuple of its registers.
    """

    def length(self, pdu: bytes, at: int) -> int | None:
        return counted_length(pdu, at, 1)

    def parse(self, pdu: bytes, at: int, fields: Fields) -> str | None:
        data, problem = counted_data(pdu, at, 1)
        groups: list[Group] = []
        place = 0
        while place + 2 <= len(data) and data[place]:
            end = place + 1 + data[place]
            problem = problem or _wrong_reference(data[place + 1])
            if data[place] % 2 == 0:
                problem = problem or "an odd number of bytes for registers"
            groups.append((words(data[place + 2 : end]),))
            place = end
        fields["groups"] = tuple(groups)
        return problem or (None if place == len(data) else _HALF_GROUP)

    def encode(self, fields: Mapping[str, Value]) -> bytes:
        data = b""
        for group in _groups(fields, "groups"):
            match group:
                case (tuple(registers),):
                    data += with_byte_count(bytes([_FILE_REFERENCE]) + pack_words(registers), 1)
                case _:
                    raise ValueError(f"a group is (registers,), not {group}")
        return with_byte_count(data, 1)


@dataclass(frozen=True, slots=True)
class Objects:
    """The objects of a device identification (V1.1b3, 6.21).

    The bytes are the number of objects, then the id, length and value of each object. An object is
    parsed as (id, value).
    """

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
        objects = _groups(fields, "objects")
        data = bytes([len(objects)])
        for one in objects:
            match one:
                case (int(number), bytes(value)):
                    data += bytes([number]) + with_byte_count(value, 1)
                case _:
                    raise ValueError(f"an object is (id, value as bytes), not {one}")
        return data


def _wrong_reference(reference: int) -> str | None:
    if reference == _FILE_REFERENCE:
        return None
    return f"reference type {reference}, where only {_FILE_REFERENCE} is defined"


def _groups(fields: Mapping[str, Value], name: str) -> tuple[Group, ...]:
    groups = fields.get(name)
    if not isinstance(groups, tuple):
        raise ValueError(f"field {name!r} must be a tuple of groups")
    return tuple(group for group in groups if isinstance(group, tuple))
