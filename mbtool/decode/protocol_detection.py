"""Decides whether a TCP connection carries Modbus, and of which kind, and decodes it then."""

# A connection is read in every way that is possible (a `ConnectionDecoder` each), and what comes
# of that is held until one of them is believed. Then all that it gave comes out, from the
# connection's first byte, and the others are dropped.
#
# Where Modbus is expected, at a port that the user named and at its own, 502, it is believed
#   with the first ADU that has the structure of its function, or a function that no table knows;
#   after CONTRADICTING ADUs without that structure, or fewer, when the connection ends;
#   when bytes are missing before that, and at its end, unless what came first of each side begins
#   no ADU (of Modbus/TCP: has another protocol id).
# At any other port, and to be RTU where Modbus/TCP is expected, a connection must show
#   a request and the response that answers it, each with the structure of a function that the
#   table knows, on Modbus/TCP with equal transaction id and unit, in RTU with correct CRCs; or
#   ENOUGH ADUs in a row with the structure of such a function. By chance that is 1 in 2^96 for
#   headers; for frames 1 in 2^48, and their structure beside it.
# A frame of RTU may be an ADU of Modbus/TCP, too: then what comes next decides.
#
# A connection is foreign
#   where its beginning was captured and begins no ADU (where Modbus is expected: neither side's;
#   and a stream of RTU that is expected may begin with noise);
#   after CONTRADICTING ADUs without the structure of their function; where Modbus is expected,
#   after one that begins like a message of another protocol: the lengths of LDAP, in BER's long
#   form, look like headers;
#   where what was seen first of both directions is a record of TLS, also when joined in the middle
#   (but where it may be RTU: a request for register 0100H of unit 17H looks like one);
#   after ENOUGH_BYTES that did not suffice, and as RTU that must be shown, after NOISE bytes of a
#   direction without a frame: to look for one at each byte costs more than all else.
# It is one FOREIGN event, which names the other protocol where it is known by how it begins; its
# further bytes are not looked at.
#
# Who is the master follows from the SYN. Where that is not in the capture, and Modbus is not
# expected, it is tried both ways.
#
# Holds, while undecided, what ENOUGH_BYTES gave at most, in up to four readings. A gap counts for
# GAP_COUNTS bytes. Of what is told of the connection meanwhile, the first MAX_TOLD events, each
# with ENOUGH_BYTES at most.

from __future__ import annotations

import re
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.decode.connections import ConnectionDecoder, Decoded
from mbtool.framing.rtu_lengths import frame_size
from mbtool.modbus.adu import MAX_RTU_ADU, Adu, Verdict
from mbtool.modbus.adu_bytes import crc
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.pdu import pdu_length
from mbtool.modbus.transaction import Outcome, Transaction

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mbtool.core import Connection

ENOUGH = 3
CONTRADICTING = 3
ENOUGH_BYTES = 2048
GAP_COUNTS = 64
NOISE = MAX_RTU_ADU
MAX_TOLD = 8

_MBAP = re.compile(rb"(?s)..\x00\x00\x00[\x02-\xFE]")
_MBAP_SEEN = 6
_MBAP_BEGUN = re.compile(rb"(?s).{0,2}\x00{0,3}\Z")
_PROTOCOL_ID = re.compile(rb"(?s)..\x00\x00|.{0,2}\x00?\Z")

TLS = "TLS"
_TLS_RECORD = re.compile(rb"(?s)[\x14-\x17]\x03[\x01-\x04](?:[\x00-\x3F].|[\x40-\x48].)")
"""RFC 8446, 5.1, and RFC 5246, 6.2.3: content type, version, at most 2^14 + 2048 bytes."""

_OTHERS = {
    # The same.
    TLS: re.compile(rb"[\x14-\x17]\x03[\x01-\x04]"),
    "HTTP": re.compile(rb"(?:GET|HEAD|POST|PUT|OPTIONS|CONNECT|DELETE|TRACE) |HTTP/"),
    "SSH": re.compile(rb"SSH-"),
    # RFC 4511, 4.1.1: a SEQUENCE that begins with an INTEGER of 1 to 4 bytes.
    "LDAP": re.compile(rb"(?s)\x30(?:\x84....|[\x05-\x7F])\x02[\x01-\x04]"),
    # RFC 1006, 6: version 3, a zero, the length, and the length and kind of a COTP header.
    "TPKT, as of S7 or RDP": re.compile(rb"(?s)\x03\x00...[\xE0\xD0\xF0]"),
    # [C706], 12.6.3: version 5.0 or 5.1, a packet type.
    "DCE/RPC": re.compile(rb"\x05[\x00\x01][\x00-\x13]"),
}
"""What the messages of other protocols begin with."""


class ProtocolState(Enum):
    """What is known of a connection."""

    UNDECIDED = 0
    MODBUS = 1
    FOREIGN = 2


class ProtocolDetector:
    """A connection's bytes in; its transactions out, or one event that it is not Modbus."""

    def __init__(
        self,
        connection: Connection,
        *,
        joined: bool = False,
        expected: bool = True,
        tcp: bool = True,
        rtu: bool = False,
        turned: bool = False,
    ) -> None:
        """`tcp` and `rtu` are what it may carry, `expected` whether its port is one of Modbus.

        `joined` is whether its beginning is missing, `turned` whether its master is the slave.
        """
        self.state = ProtocolState.UNDECIDED
        self.connection = connection
        self.joined = joined
        """Its beginning is missing."""
        self._demands_beginning = tcp or not expected
        self._may_be_rtu = rtu
        self._heads: dict[Direction, bytes | None] = dict.fromkeys(
            (Direction.REQUEST, Direction.RESPONSE), None if joined else b""
        )
        """The first bytes of each direction; None where they were not captured."""
        self._first = b""
        self._seen_first = dict.fromkeys((Direction.REQUEST, Direction.RESPONSE), b"")
        """What came first of each direction, captured from its beginning or not."""
        self._first_ns = 0
        self._seen = 0
        self._held: list[WireEvent] = []
        turns = (False, True) if joined and not expected else (turned,)
        self._readings = [
            _ProtocolReading(
                connection, rtu=framing, turned=turned, expected=expected and not (framing and tcp)
            )
            # RTU first: 01 03 00 00 00 02 C4 0B is a frame, and an ADU of Modbus/TCP.
            for turned in turns
            for framing, is_possible in ((True, rtu), (False, tcp))
            if is_possible
        ]

    def hold(self, event: WireEvent) -> None:
        """Keep an event that comes out before all else, should this be Modbus."""
        if len(self._held) < MAX_TOLD:
            self._held.append(replace(event, raw=event.raw[:ENOUGH_BYTES]))

    def feed(self, direction: Direction, data: bytes, ts_ns: int) -> list[Decoded]:
        """Take the payload of one segment."""
        if self.state is ProtocolState.MODBUS:
            return self._readings[0].feed(direction, data, ts_ns)
        if self.state is ProtocolState.FOREIGN:
            return []
        # Where a segment ends must not matter: the bound is a byte's place in the connection.
        room = ENOUGH_BYTES - self._seen
        now, later = data[:room], data[room:]
        if not self._seen:
            self._first_ns = ts_ns
        self._seen += len(now)
        self._first = (self._first + now)[: MAX_RTU_ADU + 1]
        self._look_at_beginning(direction, now)
        if not self._readings or self._is_tls():
            return self._refuse()
        for reading in self._readings:
            reading.feed_held(direction, now, ts_ns)
        is_last = self._seen >= ENOUGH_BYTES
        decoded = self._decide(is_last=is_last)
        if not decoded and is_last and self.state is ProtocolState.UNDECIDED:
            return self._refuse()
        return [*decoded, *self.feed(direction, later, ts_ns)] if later else decoded

    def gap(
        self, direction: Direction, missing: int, ts_ns: int, kind: EventKind = EventKind.GAP
    ) -> list[Decoded]:
        """Learn that bytes of one direction are missing here; 0 where nobody knows how many."""
        if self.state is ProtocolState.MODBUS:
            return self._readings[0].gap(direction, missing, ts_ns, kind)
        if self.state is ProtocolState.FOREIGN:
            return []
        if not self._seen:
            self._first_ns = ts_ns
        self._heads[direction] = None
        self._seen += GAP_COUNTS
        for reading in self._readings:
            reading.take(reading.gap(direction, missing, ts_ns, kind))
        is_tls = not self._may_be_rtu and _name_of(self._first) == TLS
        trusted = self._trusted
        if trusted is not None and not is_tls and trusted.may_be_begun(self._seen_first):
            return self._believe(trusted)
        return self._decide() if self._seen < ENOUGH_BYTES else self._refuse()

    def advance(self, now_ns: int) -> list[Decoded]:
        """Learn that nothing came until now."""
        if self.state is ProtocolState.MODBUS:
            return self._readings[0].conversation.advance(now_ns)
        for reading in self._readings:
            reading.take(reading.conversation.advance(now_ns))
        return []

    def close(self) -> list[Decoded]:
        """The connection or the capture ends."""
        if self.state is ProtocolState.MODBUS:
            return self._readings[0].conversation.close()
        if self.state is ProtocolState.FOREIGN or not self._seen:
            return []
        for reading in self._readings:
            reading.take(reading.conversation.close())
        decoded = self._decide(is_last=True)
        if decoded or self.state is not ProtocolState.UNDECIDED:
            return decoded
        trusted = self._trusted
        if trusted is not None and (
            trusted.contradicting
            or (self._name() is None and trusted.may_be_begun(self._seen_first))
        ):
            return self._believe(trusted)
        return self._refuse()

    def seen_from_here(self, event: WireEvent) -> WireEvent:
        """An event of the connection with its ends in the roles that they were found to have."""
        return self._readings[0].seen_from_here(event) if self._readings else event

    @property
    def _trusted(self) -> _ProtocolReading | None:
        """The reading that the port's name speaks for."""
        return next((one for one in self._readings if one.is_expected), None)

    def _look_at_beginning(self, direction: Direction, data: bytes) -> None:
        """Drop the readings in which a direction's first bytes cannot be."""
        seen = self._seen_first
        if len(seen[direction]) <= MAX_RTU_ADU:
            seen[direction] = (seen[direction] + data)[: MAX_RTU_ADU + 1]
        head = self._heads[direction]
        if head is None or not self._demands_beginning:
            return
        head = self._heads[direction] = (head + data)[: MAX_RTU_ADU + 1]
        for reading in self._readings:
            reading.look_at_beginning(head, direction)
        self._readings = [one for one in self._readings if not one.is_dead]

    def _is_tls(self) -> bool:
        """Whether what came first of both directions begins a record of TLS."""
        if self._may_be_rtu:
            return False
        return all(_TLS_RECORD.match(first) for first in self._seen_first.values())

    def _decide(self, *, is_last: bool = False) -> list[Decoded]:
        """Believe a reading, or refuse all, if what they gave so far suffices for that.

        `is_last` is whether no more will be known.
        """
        for reading in self._readings:
            if reading.convinces:
                if reading.is_expected and not is_last and self._is_rivalled:
                    return []
                return self._believe(reading)
        self._readings = [one for one in self._readings if not one.is_dead]
        return [] if self._readings else self._refuse()

    @property
    def _is_rivalled(self) -> bool:
        """Whether frames were read where Modbus/TCP is expected: they have right CRCs."""
        return any(one.in_a_row for one in self._readings if not one.is_expected)

    def _believe(self, reading: _ProtocolReading) -> list[Decoded]:
        self.state = ProtocolState.MODBUS
        self._readings = [reading]
        told = [reading.seen_from_here(event) for event in self._held]
        decoded = [*told, *reading.given]
        self._held.clear()
        reading.given.clear()
        return decoded

    def _refuse(self) -> list[Decoded]:
        self.state = ProtocolState.FOREIGN
        self._readings.clear()
        self._held.clear()
        name = self._name()
        what = f"{name}, not Modbus" if name is not None else "not Modbus"
        message = f"the connection is {what}; its bytes are not looked at"
        if name == TLS:
            message = (
                "the connection is TLS: only its ends can read it; "
                "a tap with --tls-cert and --tls-target-ca records it in clear"
            )
        return [
            WireEvent(
                ts_ns=self._first_ns,
                link=self.connection.link,
                kind=EventKind.FOREIGN,
                message=message,
                source=str(self.connection.master),
                destination=str(self.connection.slave),
                raw=self._first,
            )
        ]

    def _name(self) -> str | None:
        """What other protocol the first bytes are of."""
        head = self._heads[Direction.REQUEST] or self._first
        if any(_is_frame(head, direction) for direction in self._heads):
            return "RTU over TCP (--rtu-port)"
        return _name_of(head)


class _ProtocolReading:
    """One way to read a connection, and what speaks for it."""

    def __init__(self, connection: Connection, *, rtu: bool, turned: bool, expected: bool) -> None:
        if turned:
            connection = replace(connection, master=connection.slave, slave=connection.master)
        self.conversation = ConnectionDecoder(connection, rtu=rtu)
        self.given: list[Decoded] = []
        self.convinces = False
        """What was read suffices. It is the first word that counts: this or `is_dead`."""
        self.is_dead = False
        self.contradicting = 0
        """How many ADUs did not have the structure of their function."""
        self._connection = connection
        self._is_rtu = rtu
        self._is_turned = turned
        self.is_expected = expected
        """Whether the port's name speaks for it."""
        self.in_a_row = 0
        """How many ADUs with the structure of their function came one after the other."""
        self._wrong_beginnings: set[Direction] = set()
        is_shown = not rtu or expected
        self._noise = {} if is_shown else {Direction.REQUEST: 0, Direction.RESPONSE: 0}
        """How many bytes came of a direction that has yet to show a frame."""

    def feed(self, direction: Direction, data: bytes, ts_ns: int) -> list[Decoded]:
        return self.conversation.feed(self._role(direction), data, ts_ns)

    def feed_held(self, direction: Direction, data: bytes, ts_ns: int) -> None:
        """The same, where what was read is held."""
        noise = self._noise.get(direction)
        room = len(data) if noise is None else NOISE - noise
        decoded = self.feed(direction, data[:room], ts_ns)
        self.take(decoded)
        if noise is None:
            return
        if any(isinstance(one, Adu) for one in decoded):
            del self._noise[direction]
            self.take(self.feed(direction, data[room:], ts_ns))
            return
        self._noise[direction] += len(data[:room])
        if self._noise[direction] >= NOISE:
            self.is_dead = not self.convinces

    def gap(self, direction: Direction, missing: int, ts_ns: int, kind: EventKind) -> list[Decoded]:
        return self.conversation.gap(self._role(direction), missing, ts_ns, kind)

    def look_at_beginning(self, head: bytes, direction: Direction) -> None:
        """Learn the first bytes of a direction. Where Modbus is expected, one may begin wrong."""
        if not self._may_begin(head, direction):
            self._wrong_beginnings.add(direction)
            if len(self._wrong_beginnings) == (2 if self.is_expected else 1):
                self.is_dead = True

    def may_be_begun(self, heads: Mapping[Direction, bytes]) -> bool:
        """Whether nothing came, or what may be an ADU: a wrong CRC or length, or not yet whole."""
        if any(_is_wrong_frame(one) for one in self.given) or not any(heads.values()):
            return True
        if not self._is_rtu:
            return any(head and _PROTOCOL_ID.match(head) for head in heads.values())
        return any(head and self._may_begin(head, way) for way, head in heads.items())

    def _may_begin(self, head: bytes, direction: Direction) -> bool:
        if self._is_rtu:
            return _is_frame(head, self._role(direction)) is not False
        return (_MBAP if len(head) >= _MBAP_SEEN else _MBAP_BEGUN).match(head) is not None

    def take(self, decoded: list[Decoded]) -> None:
        """Hold what was read, and weigh it."""
        self.given += decoded
        for one in decoded:
            if isinstance(one, Adu):
                self._weigh(one)
            elif isinstance(one, Transaction):
                if _is_beyond_doubt(one) and not self.is_dead:
                    self.convinces = True
            elif one.kind not in (EventKind.GAP, EventKind.CUT):
                self.in_a_row = 0

    def seen_from_here(self, event: WireEvent) -> WireEvent:
        """An event of the connection with the ends in the roles that they have here.

        One about bytes names who sent them, whatever the roles.
        """
        if not self._is_turned:
            return event
        ends = event.source, event.destination
        ends = ends if event.raw else ends[::-1]
        return replace(event, link=self._connection.link, source=ends[0], destination=ends[1])

    def _weigh(self, adu: Adu) -> None:
        size = pdu_length(adu.pdu, adu.direction)
        fits = size == len(adu.pdu)
        if fits:
            self.in_a_row += 1
        elif size != 0:
            self.in_a_row = 0
            self.contradicting += 1
        if self.is_expected:
            is_over = not fits and size != 0 and _name_of(adu.raw) is not None
            is_enough = fits or size == 0 or self.contradicting >= CONTRADICTING
        else:
            is_over = self.contradicting >= CONTRADICTING
            is_enough = self.in_a_row >= ENOUGH
        if not (self.convinces or self.is_dead):
            self.is_dead, self.convinces = is_over, is_enough and not is_over

    def _role(self, direction: Direction) -> Direction:
        if not self._is_turned:
            return direction
        return Direction.RESPONSE if direction is Direction.REQUEST else Direction.REQUEST


def _name_of(head: bytes) -> str | None:
    return next((name for name, begins in _OTHERS.items() if begins.match(head)), None)


def _is_wrong_frame(one: Decoded) -> bool:
    return isinstance(one, WireEvent) and one.kind is EventKind.BAD_CHECK


def _is_beyond_doubt(one: Transaction) -> bool:
    """Whether a transaction has the structure of its function on both sides."""
    return (
        one.outcome in (Outcome.OK, Outcome.EXCEPTION)
        and one.function in FUNCTIONS
        and Verdict.MALFORMED_REQUEST not in one.verdicts
        and Verdict.MALFORMED_RESPONSE not in one.verdicts
    )


def _is_frame(head: bytes, direction: Direction) -> bool | None:
    """Whether bytes begin with an RTU frame; None where more are needed to know."""
    size = frame_size(head, direction)
    if size is None or size > len(head):
        return None if (size or 0) <= MAX_RTU_ADU and len(head) <= MAX_RTU_ADU else False
    return size > 0 and crc(head[:size]) == 0
