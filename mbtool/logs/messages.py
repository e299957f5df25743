"""Defines the JSON messages of the log, and converts items to messages and back."""

# NamedTransaction is a msgspec.Struct and is a message itself. The core's values are dataclasses
# that know nothing about JSON, so each has a Struct here. A field that does not apply is absent.
# Bytes are base64, times are UTC nanoseconds as integers.

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

import msgspec

from mbtool.core import Chunk, Connection, Direction, EventKind, Packet, Stamp, WireEvent
from mbtool.devices import NamedTransaction
from mbtool.modbus.transaction import Word

LogItem = Chunk | Packet | NamedTransaction | WireEvent
"""The values that are written to a log and read back from it."""


class ChunkMessage(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A Chunk or a Packet, as it is written to a log; only a Packet has a link type."""

    ts_ns: int
    link: str
    data: bytes
    direction: Direction | None = None
    stamp: Stamp | None = None
    connection: Connection | None = None
    link_type: Word | None = None
    original_length: Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)] | None = None

    @classmethod
    def of(cls, item: Chunk | Packet) -> ChunkMessage:
        if isinstance(item, Packet):
            return cls(
                ts_ns=item.ts_ns,
                link=item.link,
                data=item.data,
                link_type=item.link_type,
                original_length=item.original_length,
            )
        return cls(
            ts_ns=item.ts_ns,
            link=item.link,
            data=item.data,
            direction=item.direction,
            stamp=item.stamp,
            connection=item.connection,
        )

    def item(self) -> Chunk | Packet:
        if self.link_type is not None:
            length = self.original_length
            return Packet(
                ts_ns=self.ts_ns,
                link=self.link,
                link_type=self.link_type,
                data=self.data,
                original_length=len(self.data) if length is None else length,
            )
        return Chunk(
            ts_ns=self.ts_ns,
            link=self.link,
            data=self.data,
            direction=self.direction or Direction.UNKNOWN,
            stamp=self.stamp or Stamp.LAST_BYTE,
            connection=self.connection,
        )


class EventMessage(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A WireEvent, in the form in which it is written to a log."""

    ts_ns: int
    link: str
    kind: EventKind
    message: str
    source: str = ""
    destination: str = ""
    raw: bytes = b""
    missing: int = 0
    packets: int = 0

    @classmethod
    def of(cls, event: WireEvent) -> EventMessage:
        return msgspec.convert(event, cls, from_attributes=True)

    def item(self) -> WireEvent:
        return msgspec.convert(self, WireEvent, from_attributes=True)


class PointMessage(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A point (a named value of a device) that has changed, as it is written to a log."""

    ts_ns: int
    link: str
    unit_id: int
    device: str | None = None
    name: str
    reference: str
    value: int | float | None = None
    text: str
    unit: str | None = None


class DecodingMark(msgspec.Struct, frozen=True, kw_only=True):
    """Says how far the decoder is behind the capture. Its fields are those of the message in the
    log.
    """

    ts_ns: int
    waiting: int
    """Number of chunks and packets before this mark that the decoder still has to decode; 0 if it
    has caught up."""
    dropped: int
    """Number of chunks and packets, since the previous mark, that the decoder will never decode."""


class Level(IntEnum):
    """The level of a message in Foxglove's Log schema."""

    UNKNOWN = 0
    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4
    FATAL = 5


class LogTime(msgspec.Struct, frozen=True, kw_only=True):
    """A time in Foxglove's form: UTC seconds since 1970, and nanoseconds of the second."""

    sec: int
    nsec: int


class LogMessage(msgspec.Struct, frozen=True, kw_only=True):
    """A finding (a broken rule), in the form of Foxglove's Log panel (schema foxglove.Log)."""

    timestamp: LogTime
    level: Level
    message: str
    name: str
    file: str
    line: int
