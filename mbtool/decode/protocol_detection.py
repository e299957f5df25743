"""Detects whether a TCP connection carries Modbus/TCP, RTU over TCP or another protocol."""

# A connection is decoded as every possible protocol at once, by one candidate each; a candidate has
# a `ConnectionDecoder` of its own. The results are held until one candidate is accepted. Then its
# results are returned, from the connection's first byte on, and the other candidates are dropped.
#
# Modbus is expected at port 502 and at ports that the user named. There a candidate is accepted
#   - with the first ADU that is well formed or whose function code is unknown;
#   - after MAX_MALFORMED malformed ADUs, or fewer if the connection ends;
#   - at the first gap and at the connection's end, unless the first bytes of each direction cannot
#     begin an ADU (for Modbus/TCP: have another protocol id).
# Where Modbus/TCP is expected, there is also a candidate for RTU over TCP, unless the first segment
# cannot begin with an RTU frame with a correct CRC. This candidate, and every candidate at a port
# where Modbus is not expected, is accepted
#   - with a request and its response, both of a known function and well formed, with equal
#     transaction id and unit (Modbus/TCP) or correct CRCs (RTU); or
#   - after ENOUGH_ADUS well-formed ADUs in a row. Random bytes look like that with a probability of
#     2^-96 (MBAP headers), or of 2^-48 and less (CRCs); or
#   - at the connection's end with a well-formed ADU of Modbus/TCP, if another connection to the
#     same slave (IP address and port) has carried Modbus.
# An RTU frame can look like a Modbus/TCP ADU. If both candidates are left, the next ADU decides.
#
# A connection is foreign (carries another protocol)
#   - if its beginning was captured and cannot begin an ADU. If Modbus is expected this must be true
#     of both directions, and expected RTU may begin with noise. A first message that is an ADU but
#     for a wrong protocol id counts as a beginning of Modbus there, as a master that sends one
#     wrong protocol id sends correct ones, too;
#   - after MAX_MALFORMED malformed ADUs. If Modbus is expected, one is enough if it begins like
#     another protocol's message: LDAP with a long BER length can look like an MBAP header;
#   - if the first captured bytes of both directions are TLS records, also without the connection's
#     beginning. This is not tested if RTU is possible: a request to unit 17H for register 0100H
#     looks like a TLS record;
#   - after MAX_UNDECIDED_BYTES without a decision.
# Where RTU is not expected, its candidate is dropped after MAX_NOISE bytes of one direction without
# a frame, because the search for a frame at every byte is slow. Where Modbus/TCP is not expected,
# its candidate is dropped after MAX_MBAP_NOISE bytes of one direction without an ADU. A foreign
# connection is reported by one FOREIGN event, which names the protocol if its first bytes are
# recognised. Later bytes are not examined.
#
# The end that sent the SYN is the master. If the capture lacks the SYN, and Modbus is not expected,
# there are candidates for both roles.
#
# Limits, while undecided: the results of MAX_UNDECIDED_BYTES bytes in up to four candidates, where
# a gap counts as GAP_BYTES bytes; and the first MAX_HELD_EVENTS events of the connection, each with
# at most MAX_UNDECIDED_BYTES of raw data.

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import Enum, auto
from functools import cached_property, partial
from typing import TYPE_CHECKING

from mbtool.core import Connection, Direction, Endpoint, EventKind, StreamPlace, WireEvent
from mbtool.decode.connections import ConnectionDecoder, Decoded, stream_splitter
from mbtool.decode.stream_progress import OTHER
from mbtool.framing.mbap import LONG_HEADER, MAX_LENGTH, MIN_LENGTH, MbapSplitter
from mbtool.framing.rtu_lengths import begins_with_frame
from mbtool.modbus.adu import MAX_RTU_ADU, Adu, Skipped, Verdict
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.pdu import pdu_length
from mbtool.modbus.transaction import Outcome, Transaction

if TYPE_CHECKING:
    from mbtool.framing.rtu_over_tcp import RtuStreamSplitter

    _Splitters = dict[Direction, MbapSplitter | RtuStreamSplitter]

# Recognises other protocols by the first bytes of their messages.

TLS = "TLS"

_PATTERNS = {
    # The first bytes of a TLS record (RFC 8446, 5.1): content type and version.
    TLS: re.compile(rb"[\x14-\x17]\x03[\x01-\x04]"),
    "HTTP": re.compile(rb"(?:GET|HEAD|POST|PUT|OPTIONS|CONNECT|DELETE|TRACE) |HTTP/"),
    "SSH": re.compile(rb"SSH-"),
    # The first bytes of an LDAP message (RFC 4511, 4.1.1): a SEQUENCE that begins with an INTEGER
    # of 1 to 4 bytes.
    "LDAP": re.compile(rb"(?s)\x30(?:\x84....|[\x05-\x7F])\x02[\x01-\x04]"),
    # The first bytes of a TPKT packet (RFC 1006, 6): version 3, a zero, the length, and the length
    # and kind of a COTP header.
    "TPKT, as of S7 or RDP": re.compile(rb"(?s)\x03\x00...[\xE0\xD0\xF0]"),
    # The first bytes of a DCE/RPC message (The Open Group's C706, 12.6.3): version 5.0 or 5.1, then
    # a packet type of 00 to 13H.
    "DCE/RPC": re.compile(rb"\x05[\x00\x01][\x00-\x13]"),
}
_TLS_RECORD = re.compile(rb"(?s)[\x14-\x17]\x03[\x01-\x04](?:[\x00-\x3F].|[\x40-\x48].)")
"""The head of a TLS record: content type, version, and a length of at most 2^14 + 2048 bytes (RFC
8446, 5.1, and RFC 5246, 6.2.3)."""


def foreign_protocol(head: bytes) -> str | None:
    """Return the name of the protocol whose messages begin like these bytes; None if unknown."""
    return next((name for name, pattern in _PATTERNS.items() if pattern.match(head)), None)


def begins_tls_record(head: bytes) -> bool:
    """True if bytes begin with the whole head of a TLS record, with a length that TLS allows."""
    return _TLS_RECORD.match(head) is not None


ENOUGH_ADUS = 3
"""A connection is taken for Modbus after this many well-formed ADUs in a row."""
MAX_MALFORMED = 3
"""A connection is taken for another protocol after this many malformed ADUs."""
MAX_UNDECIDED_BYTES = 2048
"""A connection is taken for another protocol after this many bytes without a decision."""
GAP_BYTES = 64
"""A gap in a stream counts as this many bytes towards MAX_UNDECIDED_BYTES."""
MAX_NOISE = MAX_RTU_ADU
"""The bytes of one direction without a frame after which RTU over TCP is excluded, where it is not
expected."""
MAX_MBAP_NOISE = 520
"""The bytes of one direction without an ADU after which Modbus/TCP is excluded, where it is not
expected. That is room for the rests of two ADUs whose beginnings the capture lacks."""
MAX_HELD_EVENTS = 8
"""At most this many events of an undecided connection are kept."""
MAX_SLAVES = 65536
"""The endpoints of at most this many slaves are remembered; a further one makes the oldest be
forgotten."""

_HEAD_SIZE = MAX_RTU_ADU + 1  # Bytes kept per direction: the longest RTU frame and one more.

_MBAP_SIZE = 6  # Bytes of an MBAP header without the unit.
_MBAP_PREFIX = re.compile(rb"(?s).{0,2}\x00{0,2}\Z|..\x00\x00[\x00-\x05]\Z")
_PROTOCOL_ID = re.compile(rb"(?s)..\x00\x00|.{0,2}\x00?\Z")
"""Matches any transaction id and protocol id 0, or bytes that may become these."""


class ProtocolState(Enum):
    """The result of the detection so far: none yet, Modbus, or another protocol."""

    UNDECIDED = auto()
    MODBUS = auto()
    FOREIGN = auto()


class ProvenSlaves:
    """The slaves (IP address and port) that have carried Modbus on a connection."""

    def __init__(self) -> None:
        self._slaves: dict[Endpoint, None] = {}

    def __contains__(self, slave: Endpoint) -> bool:
        return slave in self._slaves

    def add(self, slave: Endpoint) -> None:
        if len(self._slaves) >= MAX_SLAVES:
            del self._slaves[next(iter(self._slaves))]
        self._slaves[slave] = None


class ProtocolDetector:
    """Decodes a connection into transactions, or reports once that it does not carry Modbus."""

    def __init__(
        self,
        connection: Connection,
        *,
        joined: bool = False,
        expected: bool = True,
        tcp: bool = True,
        rtu: bool = False,
        swapped: bool = False,
        timed: bool = True,
        slaves: ProvenSlaves | None = None,
    ) -> None:
        """Prepare a candidate for each possible protocol and assignment of roles.

        `tcp` is True if the connection may carry Modbus/TCP, `rtu` if RTU over TCP, `expected` if
        its port is 502 or one that the user named. `joined` is True if the capture lacks its
        beginning, `swapped` if the end that `connection` calls the slave is the master. `timed` is
        False if its bytes have no known times. `slaves` are those of all connections to which
        requests were answered.
        """
        self._slaves = ProvenSlaves() if slaves is None else slaves
        self.state = ProtocolState.UNDECIDED
        self.connection = connection
        self.joined = joined
        self._checks_beginning = tcp or not expected
        self._may_be_rtu = rtu
        self._beginnings: dict[Direction, bytes | None] = dict.fromkeys(
            (Direction.REQUEST, Direction.RESPONSE), None if joined else b""
        )
        """The first bytes that each direction sent; None if the capture may lack them."""
        self._first_bytes = b""
        """The first captured bytes of the connection, in either direction."""
        self._heads = dict.fromkeys((Direction.REQUEST, Direction.RESPONSE), b"")
        """The first captured bytes of each direction, even if earlier ones are missing."""
        self._first_ns: int  # Set with the first bytes or the first gap.
        self._seen = 0
        """The number of bytes examined; a gap counts as GAP_BYTES."""
        self._held: list[WireEvent] = []
        roles = (False, True) if joined and not expected else (swapped,)
        self._new_candidate = partial(_ProtocolCandidate, connection, joined=joined, timed=timed)
        self._candidates = [
            self._new_candidate(
                rtu=framing, swapped=swap, expected=expected and not (framing and tcp)
            )
            # RTU comes first: an RTU frame like 01 03 00 00 00 02 C4 0B is a Modbus/TCP ADU, too.
            for swap in roles
            for framing, is_possible in ((True, rtu), (False, tcp))
            if is_possible
        ]

    def hold(self, event: WireEvent) -> None:
        """Keep an event, to be returned first if the connection turns out to be Modbus."""
        if len(self._held) < MAX_HELD_EVENTS:
            self._held.append(replace(event, raw=event.raw[:MAX_UNDECIDED_BYTES]))

    def feed(
        self, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None = None
    ) -> list[Decoded]:
        """Take the payload of one segment; return no result until the protocol is decided."""
        if self.state is ProtocolState.MODBUS:
            (accepted,) = self._candidates
            return accepted.decoder.feed(accepted.roles[direction], data, ts_ns, place)
        if self.state is ProtocolState.FOREIGN:
            return []
        # The limit counts the connection's bytes, so that the result does not depend on where
        # segments end.
        room = MAX_UNDECIDED_BYTES - self._seen
        now, later = data[:room], data[room:]
        if not self._seen:
            self._first_ns = ts_ns
            if not self._may_be_rtu and begins_with_frame(now, direction) is not False:
                self._add_rtu()
        self._seen += len(now)
        self._first_bytes = _head(self._first_bytes, now)
        self._check_beginning(direction, now)
        if not self._candidates or self._is_tls():
            return self._reject()
        for candidate in self._candidates:
            candidate.feed_undecided(direction, now, ts_ns, place)
        is_last = self._seen >= MAX_UNDECIDED_BYTES
        decoded = self._decide(is_last=is_last)
        if not decoded and is_last and self.state is ProtocolState.UNDECIDED:
            return self._reject()
        after = place and place.after(len(now))
        return [*decoded, *self.feed(direction, later, ts_ns, after)] if later else decoded

    def gap(
        self,
        direction: Direction,
        missing: int,
        ts_ns: int,
        kind: EventKind = EventKind.GAP,
        acknowledged_ns: int | None = None,
    ) -> list[Decoded]:
        """Note that the capture lacks `missing` bytes (0: number unknown) of one direction."""
        if self.state is ProtocolState.MODBUS:
            (one,) = self._candidates
            return one.decoder.gap(one.roles[direction], missing, ts_ns, kind, acknowledged_ns)
        if self.state is ProtocolState.FOREIGN:
            return []
        if not self._seen:
            self._first_ns = ts_ns
        self._beginnings[direction] = None
        self._seen += GAP_BYTES
        for candidate in self._candidates:
            candidate.gap_undecided(direction, missing, ts_ns, kind, acknowledged_ns)
        is_tls = not self._may_be_rtu and foreign_protocol(self._first_bytes) == TLS
        expected = self._expected
        if expected is not None and not is_tls and expected.may_begin_with(self._heads):
            return self._accept(expected)
        return self._decide() if self._seen < MAX_UNDECIDED_BYTES else self._reject()

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note that no segment came until `now_ns`; return the transactions that time out."""
        if self.state is ProtocolState.MODBUS:
            return self._candidates[0].decoder.advance(now_ns)
        for candidate in self._candidates:
            candidate.advance_undecided(now_ns)
        return []

    def close(self, end_ns: int | None = None) -> list[Decoded]:
        """End the connection: decide its protocol if undecided, and return the remaining results.

        `end_ns` is the end of its capture (a response may have come later), None if it closed.
        """
        if self.state is ProtocolState.MODBUS:
            return self._candidates[0].decoder.close(end_ns)
        if self.state is ProtocolState.FOREIGN or not self._seen:
            return []
        for candidate in self._candidates:
            candidate.close_undecided(end_ns)
        decoded = self._decide(is_last=True)
        if decoded or self.state is not ProtocolState.UNDECIDED:
            return decoded
        expected = self._expected
        if expected is not None and (
            expected.malformed
            or (self._foreign_name() is None and expected.may_begin_with(self._heads))
        ):
            return self._accept(expected)
        for one in self._candidates:
            if one.well_formed and not one.is_rtu and one.slave in self._slaves:
                return self._accept(one)
        return self._reject()

    def plain_decoder(self) -> ConnectionDecoder | None:
        """The decoder if Modbus/TCP was detected, with `connection.master` as master; else None."""
        return self._candidates[0].plain_decoder if self.state is ProtocolState.MODBUS else None

    def with_detected_roles(self, event: WireEvent) -> WireEvent:
        """Return an event of the connection with its master and slave as they were detected."""
        return self._candidates[0].with_assigned_roles(event) if self._candidates else event

    @property
    def _expected(self) -> _ProtocolCandidate | None:
        """The candidate for the protocol that is expected at the port; None if there is none."""
        return next((one for one in self._candidates if one.is_expected), None)

    def _add_rtu(self) -> None:
        """Add a candidate for RTU over TCP, which some gateways speak at the port of Modbus/TCP."""
        is_swapped = self._candidates[0].is_swapped
        rtu = self._new_candidate(rtu=True, swapped=is_swapped, expected=False)
        self._candidates.insert(0, rtu)

    def _check_beginning(self, direction: Direction, data: bytes) -> None:
        """Add `data` to a direction's first bytes; drop candidates that cannot begin with them."""
        self._heads[direction] = _head(self._heads[direction], data)
        beginning = self._beginnings[direction]
        if beginning is None or not self._checks_beginning:
            return
        beginning = self._beginnings[direction] = _head(beginning, data)
        for candidate in self._candidates:
            candidate.check_beginning(beginning, direction)
        self._drop_ruled_out()

    def _is_tls(self) -> bool:
        """True if the first captured bytes of both directions are TLS records."""
        heads = self._heads.items()
        if self._may_be_rtu or any(begins_with_frame(head, one) for one, head in heads):
            return False
        return all(begins_tls_record(head) for head in self._heads.values())

    def _decide(self, *, is_last: bool = False) -> list[Decoded]:
        """Accept a confirmed candidate, or call the connection foreign if all are ruled out.

        `is_last` is True if no more bytes will be examined.
        """
        for candidate in self._candidates:
            if candidate.is_confirmed:
                if candidate.is_expected and not is_last and self._has_rtu_frames:
                    return []
                return self._accept(candidate)
        self._drop_ruled_out()
        return [] if self._candidates else self._reject()

    def _drop_ruled_out(self) -> None:
        self._candidates = [one for one in self._candidates if not one.is_ruled_out]

    @property
    def _has_rtu_frames(self) -> bool:
        """True if a candidate for a protocol not expected at the port has well-formed ADUs."""
        return any(one.well_formed for one in self._candidates if not one.is_expected)

    def _accept(self, candidate: _ProtocolCandidate) -> list[Decoded]:
        self.state = ProtocolState.MODBUS
        if candidate.is_confirmed and not candidate.is_rtu:
            self._slaves.add(candidate.slave)
        self._candidates = [candidate]
        events = [candidate.with_assigned_roles(event) for event in self._held]
        decoded = [*events, *candidate.decoded]
        self._held.clear()
        candidate.decoded.clear()
        return decoded

    def _reject(self) -> list[Decoded]:
        self.state = ProtocolState.FOREIGN
        self._candidates.clear()
        self._held.clear()
        name = self._foreign_name()
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
                raw=self._first_bytes,
            )
        ]

    def _foreign_name(self) -> str | None:
        """Return the name of the protocol that the first bytes belong to; None if unknown."""
        head = self._beginnings[Direction.REQUEST] or self._first_bytes
        if any(begins_with_frame(head, direction) for direction in self._beginnings):
            return "RTU over TCP (--rtu-port)"
        return foreign_protocol(head)


class _ProtocolCandidate:
    """A candidate: one possible protocol, one of the two ends as master, and the evidence."""

    def __init__(
        self,
        connection: Connection,
        *,
        rtu: bool,
        swapped: bool,
        expected: bool,
        joined: bool,
        timed: bool,
    ) -> None:
        if swapped:
            connection = replace(connection, master=connection.slave, slave=connection.master)
        self._make_decoder = partial(
            ConnectionDecoder, connection, rtu=rtu, joined=joined, timed=timed
        )
        self._splitters: _Splitters | None = None
        """The splitters of both directions that look for the first ADU. None once an ADU was found,
        and if the protocol is expected: then all bytes go to the decoder."""
        if not (expected or connection.is_udp):
            self._splitters = {each: stream_splitter(each, rtu=rtu) for each in OTHER}
        self._postponed: list[Callable[[], list[Decoded]]] = []
        """Calls of the decoder with the bytes before the first ADU, of at most MAX_UNDECIDED_BYTES
        in all. They are made once an ADU was found: for another protocol, they would take time in
        vain."""
        self.decoded: list[Decoded] = []
        """The decoded results, kept until this candidate is accepted."""
        self.is_confirmed = False
        """True once the evidence is enough to accept this candidate; then it is never ruled out."""
        self.is_ruled_out = False
        """True once the evidence speaks against this candidate; then it is never confirmed."""
        self.malformed = 0
        """The number of ADUs that did not have the structure of their function."""
        self._connection = connection
        self.is_rtu = rtu
        self.slave = connection.slave
        self.is_swapped = swapped
        self.roles = OTHER if swapped else {direction: direction for direction in OTHER}
        """For each direction in the capture, the direction in this candidate: master and slave may
        be exchanged."""
        self.is_expected = expected
        """True if this is the protocol expected at the port."""
        self.well_formed = 0
        """The number of ADUs in a row that had the structure of their function."""
        self._wrong_beginnings: set[Direction] = set()
        """The directions whose first bytes cannot begin an ADU of this candidate's protocol."""
        self._noise = {} if expected else {Direction.REQUEST: 0, Direction.RESPONSE: 0}
        """By direction, the number of bytes without an ADU; no entry once one was found."""

    @property
    def plain_decoder(self) -> ConnectionDecoder | None:
        """The decoder if it reads Modbus/TCP and master and slave are not exchanged; else None."""
        return None if self.is_rtu or self.is_swapped else self.decoder

    @cached_property
    def decoder(self) -> ConnectionDecoder:
        return self._make_decoder()

    def feed_undecided(
        self, direction: Direction, data: bytes, ts_ns: int, place: StreamPlace | None
    ) -> None:
        """Decode bytes and keep the results; rule out what had too many without an ADU."""
        noise = self._noise.get(direction)
        # The splitter of Modbus/TCP needs whole segments.
        room = MAX_NOISE - noise if self.is_rtu and noise is not None else len(data)
        role = self.roles[direction]
        decoded = self._take(
            lambda: self.decoder.feed(role, data[:room], ts_ns, place),
            lambda splitters: splitters[role].feed(data[:room], ts_ns),
        )
        if noise is None:
            return
        if any(isinstance(one, Adu) for one in decoded):
            del self._noise[direction]
            if rest := data[room:]:
                after = place and place.after(room)
                self.add(self.decoder.feed(role, rest, ts_ns, after))
            return
        self._noise[direction] += len(data[:room])
        if self._noise[direction] >= (MAX_NOISE if self.is_rtu else MAX_MBAP_NOISE):
            self.is_ruled_out = not self.is_confirmed

    def gap_undecided(
        self,
        direction: Direction,
        missing: int,
        ts_ns: int,
        kind: EventKind,
        acknowledged_ns: int | None,
    ) -> None:
        """Note that the capture lacks `missing` bytes (0: number unknown) of one direction."""
        role = self.roles[direction]
        self._take(
            lambda: self.decoder.gap(role, missing, ts_ns, kind, acknowledged_ns),
            lambda splitters: splitters[role].gap(missing),
        )

    def advance_undecided(self, now_ns: int) -> None:
        """Note that no segment came until `now_ns`."""
        if self._splitters is None:
            self.add(self.decoder.advance(now_ns))

    def close_undecided(self, end_ns: int | None) -> None:
        """End the connection; `end_ns` is the end of its capture, None if it closed."""
        self._take(
            lambda: self.decoder.close(end_ns),
            lambda splitters: [one for each in splitters.values() for one in each.close()],
        )

    def _take(
        self,
        decode: Callable[[], list[Decoded]],
        split: Callable[[_Splitters], list[Adu | Skipped]],
    ) -> list[Decoded]:
        """Decode what comes next, and all that came before, once it has an ADU; return the results.

        `decode` gives it to the decoder, `split` to the splitters that look for the first ADU.
        """
        calls = [decode]
        if self._splitters is not None:
            self._postponed.append(decode)
            if not any(isinstance(one, Adu) for one in split(self._splitters)):
                return []
            calls, self._postponed, self._splitters = self._postponed, [], None
        decoded = [one for call in calls for one in call()]
        self.add(decoded)
        return decoded

    def check_beginning(self, head: bytes, direction: Direction) -> None:
        """Rule out the candidate if `head`, a direction's first bytes, cannot begin an ADU.

        An expected candidate is ruled out only if that is true of both directions.
        """
        if not self._may_begin_adu(head, direction):
            self._wrong_beginnings.add(direction)
            if len(self._wrong_beginnings) == (2 if self.is_expected else 1):
                self.is_ruled_out = True

    def may_begin_with(self, heads: Mapping[Direction, bytes]) -> bool:
        """True if no bytes came, one of `heads` may begin an ADU, or a decoded CRC was wrong."""
        if any(_has_bad_check(one) for one in self.decoded) or not any(heads.values()):
            return True
        if not self.is_rtu:
            return any(head and _PROTOCOL_ID.match(head) for head in heads.values())
        return any(head and self._may_begin_adu(head, way) for way, head in heads.items())

    def _may_begin_adu(self, head: bytes, direction: Direction) -> bool:
        if self.is_rtu:  # A direction may carry a whole line: requests and responses.
            return any(begins_with_frame(head, each) is not False for each in OTHER)
        if (LONG_HEADER if len(head) >= _MBAP_SIZE else _MBAP_PREFIX).match(head) is not None:
            return True
        return self.is_expected and _is_adu_but_for_its_protocol_id(head, direction)

    def add(self, decoded: list[Decoded]) -> None:
        """Append to `self.decoded`, and count the evidence for or against this candidate."""
        self.decoded += decoded
        for one in decoded:
            if isinstance(one, Adu):
                self._count(one)
            elif isinstance(one, Transaction):
                if _is_well_formed(one) and not self.is_ruled_out:
                    self.is_confirmed = True
            elif one.kind not in (EventKind.GAP, EventKind.CUT):
                self.well_formed = 0

    def with_assigned_roles(self, event: WireEvent) -> WireEvent:
        """Return an event with master and slave as this candidate assigns them.

        An event with raw bytes keeps its source and destination: they name who sent the bytes.
        """
        if not self.is_swapped:
            return event
        ends = event.source, event.destination
        ends = ends if event.raw else ends[::-1]
        return replace(event, link=self._connection.link, source=ends[0], destination=ends[1])

    def _count(self, adu: Adu) -> None:
        size = pdu_length(adu.pdu, adu.direction) or 0  # 0 if the PDU does not tell its length.
        fits = size == len(adu.pdu) + adu.missing
        if fits:
            self.well_formed += 1
        elif size != 0:
            self.well_formed = 0
            self.malformed += 1
        if self.is_expected:
            speaks_against = not fits and size != 0 and foreign_protocol(adu.raw) is not None
            is_enough = fits or size == 0 or self.malformed >= MAX_MALFORMED
        else:
            speaks_against = self.malformed >= MAX_MALFORMED
            is_enough = self.well_formed >= ENOUGH_ADUS
        if not (self.is_confirmed or self.is_ruled_out):
            self.is_ruled_out = speaks_against
            self.is_confirmed = is_enough and not speaks_against


def _is_adu_but_for_its_protocol_id(head: bytes, direction: Direction) -> bool:
    """True if the first message in `head` has the length and form of an ADU; also if its header has
    come and not yet all of it.
    """
    length = int.from_bytes(head[4:_MBAP_SIZE])
    if len(head) < _MBAP_SIZE or not MIN_LENGTH <= length <= MAX_LENGTH:
        return False
    if len(head) < _MBAP_SIZE + length:
        return True
    pdu = head[_MBAP_SIZE + 1 : _MBAP_SIZE + length]
    return pdu_length(pdu, direction) == len(pdu)


def _head(head: bytes, data: bytes) -> bytes:
    return head if len(head) >= _HEAD_SIZE else (head + data)[:_HEAD_SIZE]


def _has_bad_check(one: Decoded) -> bool:
    return isinstance(one, WireEvent) and one.kind is EventKind.BAD_CHECK


def _is_well_formed(one: Transaction) -> bool:
    """True if request and response were captured and have the structure of a known function."""
    return (
        one.outcome in (Outcome.OK, Outcome.EXCEPTION, Outcome.LATE)
        and one.function in FUNCTIONS
        and Verdict.MALFORMED_REQUEST not in one.verdicts
        and Verdict.MALFORMED_RESPONSE not in one.verdicts
    )
