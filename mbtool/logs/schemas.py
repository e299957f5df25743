"""Makes the MCAP schema of each topic from the type of its messages."""

# All messages are JSON except EVIDENCE, which is protobuf (evidence_blocks.py).
#
# The JSON schemas use only what Foxglove reads (its parseJsonSchema): objects with properties,
# arrays, boolean, string, number, integer; no null, no union, no $ref; bytes are strings with
# contentEncoding base64; an enumeration of numbers is a oneOf of title and const. Foxglove has no
# enumeration of strings, so that is a string whose description lists the values. A field that does
# not apply is absent, so `X | None` becomes X, not required.

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect

from mbtool.core import Connection, Endpoint
from mbtool.devices import NamedTransaction, PointValue
from mbtool.devices.transaction_fields import transaction_fields
from mbtool.logs.evidence_blocks import descriptor
from mbtool.logs.messages import (
    ChunkMessage,
    DecodingMark,
    EventMessage,
    LogMessage,
    LogTime,
    PointMessage,
)

EVIDENCE = "mbtool.Evidence"
CHUNK = "mbtool.Chunk"
TRANSACTION = "mbtool.Transaction"
WIRE_EVENT = "mbtool.WireEvent"
POINT_VALUE = "mbtool.PointValue"
LOG = "foxglove.Log"
DECODING = "mbtool.Decoding"

MESSAGE_TYPES: dict[str, type] = {
    CHUNK: ChunkMessage,
    TRANSACTION: NamedTransaction,
    WIRE_EVENT: EventMessage,
    POINT_VALUE: PointMessage,
    LOG: LogMessage,
    DECODING: DecodingMark,
}

_TITLES = {
    CHUNK: "Bytes as captured: one read of a port, the payload of a TCP segment, or a whole packet",
    TRANSACTION: "A Modbus request and its response, in the words of the device",
    WIRE_EVENT: "Something on a link that is no transaction",
    POINT_VALUE: "A named value that has changed",
    LOG: "A broken rule",
    DECODING: "How far the decoder is behind the captured bytes",
}

_POINT = {
    "name": "The point's name in its manual",
    "reference": "Its address in the vendor's notation",
    "value": "The value as a number; absent if it is infinite or not a number",
    "text": "The value as the manual writes it",
    "unit": "The unit of measure",
}
"""Descriptions of the fields of a point (a named value of a device). They are the same in a
transaction and in a message of its own."""

_DESCRIPTIONS: dict[type, dict[str, str]] = {
    ChunkMessage: {
        "ts_ns": "When it was captured, UTC nanoseconds",
        "link": "The bus, the slave's address, or the interface",
        "data": "The bytes",
        "direction": "Who sent the bytes, if the source knows it",
        "stamp": "Which bytes have this time: all (a segment) or only the last (a serial read)",
        "connection": "The TCP connection; absent on a serial line",
        "link_type": "A packet's LINKTYPE_ of the pcap registry; absent if data is no packet",
        "original_length": "A packet's length on the wire, in bytes; data is shorter if it was cut",
    },
    Connection: {
        "master": "The end that sends requests",
        "slave": "The end that responds",
        "number": "A number that differs between connections of the same ends",
        "is_udp": "True for datagrams of UDP",
    },
    Endpoint: {"host": "The address", "port": "The TCP port"},
    PointValue: {
        **_POINT,
        "written": "True for what function 17H writes, beside what it reads; absent otherwise",
    },
    EventMessage: {
        "ts_ns": "When it happened, UTC nanoseconds",
        "link": "The bus or the slave's address",
        "kind": "What happened",
        "message": "One sentence for a reader",
        "source": "The sender's endpoint, on a network",
        "destination": "The receiver's endpoint, on a network",
        "raw": "The bytes concerned",
        "missing": "How many bytes are lost, as far as that is known",
        "packets": "How many packets of an interface are lost",
    },
    PointMessage: {
        "ts_ns": "When the transaction that shows it was complete, UTC nanoseconds",
        "link": "The bus or the slave's address",
        "unit_id": "The slave's number",
        "device": "The name of the device's profile",
        **_POINT,
    },
    LogMessage: {
        "timestamp": "When the rule was broken, for the first time if it was several times",
        "level": "How grave it is",
        "message": "The code, the rule, and what broke it",
        "name": "The rule's code",
        "file": "The link",
        "line": "The unit id; 0 if the finding concerns no unit",
    },
    DecodingMark: {
        "ts_ns": "When this was so, UTC nanoseconds",
        "waiting": "How many chunks before this message are not yet decoded; 0: none",
        "dropped": "How many chunks since the mark before this one will not be decoded",
    },
    LogTime: {"sec": "Seconds since 1970, UTC", "nsec": "Nanoseconds of the second"},
}


class TopicSchema(NamedTuple):
    """The schema of a topic's messages, in the parts in which MCAP stores it."""

    name: str
    encoding: str
    message_encoding: str
    data: bytes


@cache
def schema_of(name: str) -> TopicSchema:
    """Return the schema with this name, such as "mbtool.Transaction"."""
    if name == EVIDENCE:
        return TopicSchema(name, "protobuf", "protobuf", descriptor())
    return TopicSchema(name, "jsonschema", "json", json_schema(name))


@cache
def json_schema(name: str) -> bytes:
    """Return the JSON schema with this name, encoded as JSON."""
    schema = _object(MESSAGE_TYPES[name])
    return msgspec.json.encode({"title": name, "description": _TITLES[name], **schema})


def _object(cls: type) -> dict[str, Any]:
    info = inspect.type_info(cls)
    if not isinstance(info, inspect.StructType | inspect.DataclassType):
        raise TypeError(f"{cls} has no fields")
    if issubclass(cls, NamedTransaction):
        descriptions = {one.name: one.text for one in transaction_fields(cls)}
    else:
        descriptions = _DESCRIPTIONS[cls]
    properties = {}
    for field in info.fields:
        schema, values = _schema(field.type)
        description = descriptions[field.name]
        if values:
            description += ": " + ", ".join(values)
        properties[field.name] = {**schema, "description": description}
    required = [field.name for field in info.fields if field.required]
    return {"type": "object", "properties": properties, "required": required}


def _schema(type_: inspect.Type) -> tuple[dict[str, Any], Iterable[str]]:
    """Return the JSON schema of a field's type, and the type's values.

    The values are empty unless the type is an enumeration of strings.
    """
    match type_:
        case inspect.Metadata(type=inner):
            return _schema(inner)
        case inspect.UnionType(types=(inspect.IntType(), inspect.FloatType(), *_)):
            return {"type": "number"}, ()
        case inspect.UnionType(types=types):
            (only,) = (one for one in types if not isinstance(one, inspect.NoneType))
            return _schema(only)
        case inspect.StructType(cls=cls) | inspect.DataclassType(cls=cls):
            return _object(cls), ()
        case inspect.ListType(item_type=item_type):
            items, values = _schema(item_type)
            return {"type": "array", "items": items}, values
        case inspect.EnumType(cls=enum) if issubclass(enum, int):
            choices = [{"title": member.name, "const": member.value} for member in enum]
            return {"type": "integer", "oneOf": choices}, ()
        case inspect.EnumType(cls=enum):
            return {"type": "string"}, [member.value for member in enum]
        case inspect.BytesType():
            return {"type": "string", "contentEncoding": "base64"}, ()
        case inspect.IntType():
            return {"type": "integer"}, ()
        case inspect.FloatType():
            return {"type": "number"}, ()
        case inspect.StrType():
            return {"type": "string"}, ()
        case inspect.BoolType():
            return {"type": "boolean"}, ()
        case _:
            raise TypeError(f"{type_} has no place in a schema")
