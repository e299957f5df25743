"""Layouts of the parts of PDUs that consist of groups: file records, identification objects."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.modbus.layouts import (
    Fields,
    Group,
    Value,
    counted_data,
    counted_length,
    with_byte_count,
)
from mbtool.modbus.packing import pack_words, words

if TYPE_CHECKING:
    from collections.abc import Mapping

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
