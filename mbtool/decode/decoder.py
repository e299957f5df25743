"""Turns evidence of any kind into named transactions and events, one item at a time."""

# The one place where packets, serial reads and relayed bytes meet. What comes out for a link does
# not depend on how its bytes were cut, nor on whether they came live or from a file.
#
# Holds one Bus for each serial link, or one TwoTaps where its bytes say who speaks, and one
# Recognition for each open connection, at most MAX_CONVERSATIONS; beyond, the one that was silent
# longest is closed.
#
# With `any_port` every TCP connection is followed, and those that are not Modbus stay out of sight:
# their opening and end are not told, nor what their segments and fragments lack, and that they are
# foreign once for each slave's endpoint (or each end, where none is known to be the slave), of the
# first MAX_TOLD. A port that is named, and 502, is Modbus's all the same.
#
# A connection that two interfaces saw is two, unless flows are followed `across` interfaces.

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from mbtool.core import (
    CONNECTION_JOINED,
    CONNECTION_OPENED,
    Chunk,
    Connection,
    Direction,
    EventKind,
    LineSettings,
    Packet,
    Quiet,
    SerialFormat,
    SerialLink,
    Stamp,
    WireEvent,
)
from mbtool.core.link_spec import MODBUS_PORT
from mbtool.decode.connections import Bus, Decoded
from mbtool.decode.line_timing import LineTiming
from mbtool.decode.protocol_detection import ProtocolDetector, ProtocolState
from mbtool.decode.tap_pair import TapPair
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Adu, Transaction
from mbtool.packets import (
    SERIAL_LINK_TYPES,
    USER_LINK_TYPES,
    CloseReason,
    StreamClosed,
    StreamEvent,
    StreamGap,
    StreamItem,
    StreamOpened,
    TcpReassembler,
    serial_pieces,
)
from mbtool.packets.reassembler import MAX_CONNECTIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

MAX_CONVERSATIONS = 4096
MAX_TOLD = 4096

EVERY_PORT = range(1 << 16)

_GIVEN_UP = (
    f"connection no longer followed: it was silent longest of more than {MAX_CONNECTIONS} at once"
)
_LOST = frozenset((EventKind.DISCARDED, EventKind.GAP, EventKind.CUT))
"""Events behind which bytes of a serial line are missing."""

Evidence = (
    Chunk | Packet | Quiet | StreamOpened | StreamGap | StreamClosed | StreamEvent | WireEvent
)
Record = NamedTransaction | WireEvent


class Decoder:
    """`Evidence` in, `Record` out, each transaction as soon as it is complete."""

    def __init__(
        self,
        namer: Namer,
        *,
        lines: Mapping[str, SerialLink] | None = None,
        line: LineSettings | None = None,
        timing: LineTiming | None = None,
        ports: Iterable[int] = (),
        rtu_ports: Iterable[int] = (),
        any_port: bool = False,
        across: bool = False,
    ) -> None:
        """`lines` are the serial links by name, `ports` and `rtu_ports` those of packets.

        With `any_port` the connections of all other ports are looked into, too; with `across` what
        several interfaces saw is one network's.
        `line` is what every other serial link is like, `timing` which silences hold on them.
        """
        self._namer = namer
        self._lines = dict(lines or {})
        self._line = line or LineSettings(SerialFormat())
        self._timing = timing or LineTiming()
        self._serial_types = SERIAL_LINK_TYPES | (USER_LINK_TYPES if line is not None else set())
        self._rtu_ports = frozenset(rtu_ports)
        self._any_port = any_port
        self._ports = frozenset((*ports, *self._rtu_ports, *((MODBUS_PORT,) if any_port else ())))
        followed = frozenset(EVERY_PORT) if any_port else self._ports
        self._reassembler = TcpReassembler(followed, across=across)
        self._buses: dict[str, Bus | TapPair] = {}
        self._untimed: set[str] = set()
        self._conversations: OrderedDict[Connection, ProtocolDetector] = OrderedDict()
        self._interfaces: set[str] = set()
        """Links that have brought packets."""
        self._told_foreign: set[str] = set()
        """Slaves' endpoints, with `any_port`, that were said not to speak Modbus; both ends' of
        connections joined in the middle."""
        self._last_ns = 0

    def feed(self, item: Evidence) -> list[Record]:
        """Take the next piece of evidence."""
        self._last_ns = max(self._last_ns, item.ts_ns)
        if not isinstance(item, Packet):
            return self._piece(item)
        pieces: Sequence[StreamItem]
        if item.link_type in self._serial_types:
            pieces = serial_pieces(item)
        else:
            self._interfaces.add(item.link)
            pieces = self._reassembler.feed(item)
        records: list[Record] = []
        for piece in pieces:
            records += self._piece(piece)
        return records

    def format_of(self, link: str) -> SerialFormat | None:
        """A serial link's settings and silences; None where the times of its bytes are unknown."""
        if link in self._untimed:
            return None
        return self._timing.format_of(self._lines.get(link) or self._line.on(link))

    def begin_line(self, line: SerialLink) -> None:
        """Learn what a serial link is like whose bytes come next."""
        self._lines[line.name] = line

    def end_line(self, link: str) -> list[Record]:
        """A serial link's bytes end here; what comes under its name later is another's."""
        bus = self._buses.pop(link, None)
        return [] if bus is None else self._named(bus.close())

    def break_lines(self) -> list[Record]:
        """Bytes of serial lines may be missing here; of connections, sequence numbers tell."""
        return [record for link in [*self._buses] for record in self.end_line(link)]

    def close(self) -> list[Record]:
        """The evidence ends: what was held comes out."""
        records: list[Record] = []
        for piece in self._reassembler.close(self._last_ns):
            records += self._piece(piece)
        for conversation in self._conversations.values():
            records += self._recognised(conversation, conversation.close())
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
            conversation = known or self._new_conversation(item.connection, joined=True)
            gap = conversation.gap(item.direction, item.missing, item.ts_ns, item.kind)
            return self._recognised(conversation, gap)
        if isinstance(item, StreamOpened):
            text = CONNECTION_JOINED if item.joined else CONNECTION_OPENED
            text = f"{text}: {item.note}" if item.note else text
            told = _told(item, EventKind.OPENED, text)
            conversation = self._conversation(item.connection, joined=item.joined)
            if self._is_expected(item.connection):
                return [conversation.seen_from_here(told)]
            conversation.hold(told)
            return []
        if isinstance(item, StreamClosed):
            ended = self._conversations.pop(item.connection, None)
            records = [] if ended is None else self._recognised(ended, ended.close())
            is_modbus = ended is not None and ended.state is ProtocolState.MODBUS
            if not is_modbus and not self._is_expected(item.connection):
                return records
            discarded = item.reason is CloseReason.DISCARDED
            # Of a stranger nothing more was wanted, so nothing is lost with it.
            is_loss = discarded and (ended is None or ended.state is not ProtocolState.FOREIGN)
            kind = EventKind.DISCARDED if is_loss else EventKind.CLOSED
            probes = f", {item.keep_alives} keep-alive probes" if item.keep_alives else ""
            text = _GIVEN_UP if discarded else f"connection closed: {item.reason}"
            told = _told(item, kind, text + probes)
            return [*records, told if ended is None else ended.seen_from_here(told)]
        if isinstance(item, StreamEvent):
            return self._stream_event(item)
        return [*self._broken_off(item), item]

    def _stream_event(self, item: StreamEvent) -> list[Record]:
        conversation = self._conversations.get(item.connection)
        state = None if conversation is None else conversation.state
        if conversation is not None and state is ProtocolState.MODBUS:
            return [conversation.seen_from_here(item.event)]
        if self._is_expected(item.connection):
            return [item.event]
        if conversation is not None and state is ProtocolState.UNDECIDED:
            conversation.hold(item.event)
            return []
        # Of a connection that nothing is known of, only what a bound cost is told.
        is_told = state is None and item.event.kind is EventKind.DISCARDED
        return [item.event] if is_told else []

    def _broken_off(self, event: WireEvent) -> list[Record]:
        """What was held when bytes behind it were lost: it cannot be completed."""
        if event.kind is EventKind.GAP and not event.link:  # A hole in a log, in any link's bytes.
            conversations = [*self._conversations.values()]
            buses = [*self._buses.values()]
            self._conversations.clear()
            self._buses.clear()
            records: list[Record] = []
            for conversation in conversations:
                records += self._recognised(conversation, conversation.close())
            for bus in buses:
                records += self._named(bus.close())
            return records
        return self.end_line(event.link) if event.kind in _LOST else []

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
            bus = self._bus(chunk)
            if isinstance(bus, TapPair):
                return self._named(bus.feed(chunk.direction, chunk.data, chunk.ts_ns))
            return self._named(bus.feed(chunk.data, chunk.ts_ns))
        # Where the evidence does not tell of a beginning, it may be one of a log's next file.
        conversation = self._conversation(chunk.connection, joined=True)
        decoded = conversation.feed(chunk.direction, chunk.data, chunk.ts_ns)
        records = self._recognised(conversation, decoded)
        if len(self._conversations) > MAX_CONVERSATIONS:
            _, oldest = self._conversations.popitem(last=False)
            records += self._recognised(oldest, oldest.close())
        return records

    def _bus(self, chunk: Chunk) -> Bus | TapPair:
        link = chunk.link
        bus = self._buses.get(link)
        if bus is None:
            line = self._lines.get(link) or self._line.on(link)
            format_, is_ascii = self._timing.format_of(line), line.ascii
            if chunk.direction is Direction.UNKNOWN:
                timed = chunk.stamp is not Stamp.UNKNOWN
                if not timed:
                    self._untimed.add(link)
                bus = Bus(link, format_, ascii=is_ascii, timed=timed)
            else:
                bus = TapPair(link, format_, ascii=is_ascii)
            self._buses[link] = bus
        return bus

    def _conversation(self, connection: Connection, *, joined: bool) -> ProtocolDetector:
        conversation = self._conversations.get(connection)
        if conversation is None:
            conversation = self._new_conversation(connection, joined=joined)
            self._conversations[connection] = conversation
        else:
            self._conversations.move_to_end(connection)
        return conversation

    def _new_conversation(self, connection: Connection, *, joined: bool) -> ProtocolDetector:
        # Who began the connection tells master from slave, but for the ports that are named.
        ends = [connection.slave.port, connection.master.port]
        turned = self._any_port and ends[1] in self._ports and ends[0] not in self._ports
        is_rtu = ends[turned] in self._rtu_ports
        return ProtocolDetector(
            connection,
            joined=joined,
            expected=self._is_expected(connection),
            tcp=not is_rtu,
            rtu=is_rtu or self._any_port,
            turned=turned,
        )

    def _is_expected(self, connection: Connection) -> bool:
        """Whether Modbus is; without `any_port` only ports and taps are here that a user named."""
        ports = self._ports
        named = connection.slave.port in ports or connection.master.port in ports
        return named or not self._any_port

    def _recognised(self, conversation: ProtocolDetector, decoded: list[Decoded]) -> list[Record]:
        """The same, but foreign connections that nobody named once for each endpoint."""
        if not decoded or not self._any_port or conversation.state is not ProtocolState.FOREIGN:
            return self._named(decoded)
        if self._is_expected(conversation.connection):
            return self._named(decoded)
        ends = conversation.connection
        # Without its beginning nobody knows which end of a stranger's connection is the slave.
        slaves = {str(ends.slave), str(ends.master)} if conversation.joined else {str(ends.slave)}
        if slaves & self._told_foreign or len(self._told_foreign) >= MAX_TOLD:
            return []
        self._told_foreign |= slaves
        return self._named(decoded)

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
