"""Turns evidence of any kind into named transactions and events, one item at a time."""

# The one place where packets, serial reads and relayed bytes meet. What comes out for a link does
# not depend on how its bytes were cut, nor on whether they came live or from a file.
#
# Holds one Bus for each serial link and one Conversation for each open connection, at most
# MAX_CONVERSATIONS; beyond, the one that was silent longest is closed.

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from mbtool.core import (
    Chunk,
    Connection,
    EventKind,
    Packet,
    Quiet,
    SerialFormat,
    SerialLink,
    WireEvent,
)
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Adu, Bus, Conversation, Decoded, Transaction
from mbtool.packets import (
    CloseReason,
    StreamClosed,
    StreamGap,
    StreamItem,
    StreamOpened,
    TcpReassembler,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

MAX_CONVERSATIONS = 4096

Evidence = Chunk | Packet | Quiet | StreamOpened | StreamGap | StreamClosed | WireEvent
Record = NamedTransaction | WireEvent


class Decoder:
    """`Evidence` in, `Record` out, each transaction as soon as it is complete."""

    def __init__(
        self,
        namer: Namer,
        *,
        lines: Mapping[str, SerialLink] | None = None,
        ports: Iterable[int] = (),
        rtu_ports: Iterable[int] = (),
    ) -> None:
        """`lines` are the serial links by name, `ports` and `rtu_ports` those of packets."""
        self._namer = namer
        self._lines = dict(lines or {})
        self._rtu_ports = frozenset(rtu_ports)
        self._reassembler = TcpReassembler(frozenset(ports) | self._rtu_ports)
        self._buses: dict[str, Bus] = {}
        self._conversations: OrderedDict[Connection, Conversation] = OrderedDict()
        self._interfaces: set[str] = set()
        """Links that have brought packets."""
        self._last_ns = 0

    def feed(self, item: Evidence) -> list[Record]:
        """Take the next piece of evidence."""
        self._last_ns = max(self._last_ns, item.ts_ns)
        if not isinstance(item, Packet):
            return self._piece(item)
        self._interfaces.add(item.link)
        records: list[Record] = []
        for piece in self._reassembler.feed(item):
            records += self._piece(piece)
        return records

    def close(self) -> list[Record]:
        """The evidence ends: what was held comes out."""
        records: list[Record] = []
        for piece in self._reassembler.close(self._last_ns):
            records += self._piece(piece)
        for conversation in self._conversations.values():
            records += self._named(conversation.close())
        for bus in self._buses.values():
            records += self._named(bus.close())
        self._conversations.clear()
        self._buses.clear()
        return records

    def _piece(self, item: StreamItem | Quiet) -> list[Record]:
        if isinstance(item, Chunk):
            return self._chunk(item)
        if isinstance(item, Quiet):
            return self._quiet(item)
        if isinstance(item, StreamGap):
            # A gap that is told behind the connection's end must not open it anew.
            known = self._conversations.get(item.connection)
            conversation = known or self._new_conversation(item.connection)
            gap = conversation.gap(item.direction, item.missing, item.ts_ns, item.kind)
            return self._named(gap)
        if isinstance(item, StreamOpened):
            self._conversation(item.connection)
            text = "connection joined" if item.joined else "connection opened"
            return [_told(item, EventKind.OPENED, text)]
        if isinstance(item, StreamClosed):
            ended = self._conversations.pop(item.connection, None)
            discarded = item.reason is CloseReason.DISCARDED
            kind = EventKind.DISCARDED if discarded else EventKind.CLOSED
            told = _told(item, kind, f"connection closed: {item.reason}")
            return [*(self._named(ended.close()) if ended is not None else []), told]
        return [*self._broken_off(item), item]

    def _broken_off(self, event: WireEvent) -> list[Record]:
        """What a serial line held when bytes behind it were lost: it cannot be completed."""
        if event.kind is not EventKind.DISCARDED or event.link not in self._buses:
            return []
        return self._named(self._buses.pop(event.link).close())

    def _quiet(self, quiet: Quiet) -> list[Record]:
        bus = self._buses.get(quiet.link)
        if bus is not None:
            return self._named(bus.advance(quiet.ts_ns))
        records: list[Record] = []
        if quiet.link in self._interfaces:
            for piece in self._reassembler.advance(quiet.ts_ns):
                records += self._piece(piece)
        for connection, conversation in self._conversations.items():
            # A tap's quiet is about the connections of its link, an interface's about all others.
            if (connection.link == quiet.link) is not (quiet.link in self._interfaces):
                records += self._named(conversation.advance(quiet.ts_ns))
        return records

    def _chunk(self, chunk: Chunk) -> list[Record]:
        if chunk.connection is None:
            return self._named(self._bus(chunk.link).feed(chunk.data, chunk.ts_ns))
        conversation = self._conversation(chunk.connection)
        records = self._named(conversation.feed(chunk.direction, chunk.data, chunk.ts_ns))
        if len(self._conversations) > MAX_CONVERSATIONS:
            _, oldest = self._conversations.popitem(last=False)
            records += self._named(oldest.close())
        return records

    def _bus(self, link: str) -> Bus:
        bus = self._buses.get(link)
        if bus is None:
            line = self._lines.get(link) or SerialLink(link, SerialFormat())
            bus = self._buses[link] = Bus(link, line.format, ascii=line.ascii)
        return bus

    def _conversation(self, connection: Connection) -> Conversation:
        conversation = self._conversations.get(connection)
        if conversation is None:
            conversation = self._conversations[connection] = self._new_conversation(connection)
        else:
            self._conversations.move_to_end(connection)
        return conversation

    def _new_conversation(self, connection: Connection) -> Conversation:
        return Conversation(connection, rtu=connection.slave.port in self._rtu_ports)

    def _named(self, decoded: list[Decoded]) -> list[Record]:
        records: list[Record] = []
        for one in decoded:
            if isinstance(one, Transaction):
                records.append(self._namer.name(one))
            elif not isinstance(one, Adu):
                records.append(one)
        return records


def _told(item: StreamOpened | StreamClosed, kind: EventKind, message: str) -> WireEvent:
    return WireEvent(
        ts_ns=item.ts_ns,
        link=item.connection.link,
        kind=kind,
        message=message,
        source=str(item.connection.master),
        destination=str(item.connection.slave),
    )
