"""A simulated TCP connection with a tap on its path.

The tap sees each segment with the sequence and acknowledgement numbers that its sender had at that
moment. Both ends acknowledge, delay acknowledgements, put segments in order and retransmit.
"""

# Time is simulated, in ns. An end sends its segments to the tap, and the tap passes them on to
# the other end. A loss on the network happens on either side of the tap: before it the capture
# has only the retransmission, behind it the capture has both copies.

from __future__ import annotations

import heapq
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

US = 1_000
MS = 1_000_000
SECOND = 1_000_000_000

FIN, SYN, PUSH, ACK = 0x01, 0x02, 0x08, 0x10

DELAYED_ACK_NS = 40 * MS
"""Linux delays an acknowledgement that has no data to go with by 40 ms."""
QUICK_ACK_NS = 30 * US
RETRANSMISSION_NS = 250 * MS
"""Linux waits for 200 ms and the round-trip time before it retransmits."""


class Clock:
    """Calls functions at their simulated time, in order."""

    def __init__(self, start_ns: int) -> None:
        self.now_ns = start_ns
        self._queue: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0

    def after(self, delay_ns: int, call: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._queue, (self.now_ns + delay_ns, self._count, call))

    def run(self) -> None:
        while self._queue:
            self.now_ns, _, call = heapq.heappop(self._queue)
            call()


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """One TCP segment as its sender sends it."""

    connection: int
    """The number of the connection, from 0; a new one for each handshake."""
    from_master: bool
    ports: tuple[int, int]
    """The port of the sender and that of the receiver."""
    sequence: int
    acknowledgement: int
    flags: int
    payload: bytes
    offset: int
    """Where the payload stands in the stream of its direction, from 0."""
    acknowledged: int
    """How many bytes of the other direction the sender has received."""

    def frame(self) -> bytes:
        """The segment as an Ethernet frame. Checksums are 0, as with checksum offload."""
        master, slave = b"\x02\0\0\0\0\x01", b"\x02\0\0\0\0\x02"
        hosts = b"\x0a\0\0\x01", b"\x0a\0\0\x09"
        source, destination = hosts if self.from_master else hosts[::-1]
        options = bytes.fromhex("020405b4") if self.flags & SYN else b""
        tcp = struct.pack(
            ">HHIIBBHHH",
            *self.ports,
            self.sequence & 0xFFFFFFFF,
            self.acknowledgement & 0xFFFFFFFF,
            (20 + len(options)) << 2,
            self.flags,
            64240,
            0,
            0,
        )
        body = tcp + options + self.payload
        ip = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), 0, 0x4000, 64, 6, 0)
        macs = slave + master if self.from_master else master + slave
        return (macs + b"\x08\x00" + ip + source + destination + body).ljust(60, b"\0")


@dataclass(frozen=True, slots=True)
class Seen:
    """A segment in the capture."""

    ts_ns: int
    segment: Segment


class Fate(Enum):
    """What the network does with a segment."""

    ARRIVES = "arrives"
    LOST_BEFORE_TAP = "lost before the tap"
    LOST_BEHIND_TAP = "lost behind the tap"


@dataclass(slots=True)
class Path:
    """The network between two ends, and the tap on it."""

    clock: Clock
    fate: Callable[[Segment], Fate]
    to_tap_ns: int = 60 * US
    """From the master to the tap; from the tap to the master."""
    behind_tap_ns: int = 90 * US
    """From the tap to the slave; from the slave to the tap."""
    seen: list[Seen] = field(default_factory=list)

    def carry(self, segment: Segment, arrive: Callable[[Segment], None]) -> None:
        fate = self.fate(segment)
        first, second = self.to_tap_ns, self.behind_tap_ns
        if not segment.from_master:
            first, second = second, first

        def pass_tap() -> None:
            last = self.seen[-1].ts_ns if self.seen else 0
            self.seen.append(Seen(max(self.clock.now_ns, last + US), segment))
            if fate is Fate.ARRIVES:
                self.clock.after(second, lambda: arrive(segment))

        if fate is not Fate.LOST_BEFORE_TAP:
            self.clock.after(first, pass_tap)


class End:
    """One end of a connection. Give `peer` before anything is sent."""

    peer: End

    def __init__(
        self, path: Path, *, connection: int, is_master: bool, port: int, first: int, quick: bool
    ) -> None:
        self.connection = connection
        self.is_master = is_master
        self.port = port
        self.first = first
        """The initial sequence number."""
        self.quick = quick
        """True if this end acknowledges each segment at once."""
        self.on_bytes: Callable[[bytes], None] = lambda _: None
        self.sent = 0
        self.received = 0
        self._path = path
        self._control = 0
        """How many of SYN and FIN this end has sent."""
        self._peer_control = 0
        self._unacknowledged: list[Segment] = []
        self._early: dict[int, bytes] = {}
        self._ack_wanted = 0
        self._ack_timer = 0
        self._retry_timer = 0

    @property
    def is_idle(self) -> bool:
        """True if the peer has acknowledged everything."""
        return not self._unacknowledged

    def connect(self, then: Callable[[], None]) -> None:
        """Make the three packets of a handshake; the master calls this."""
        peer = self.peer

        def acknowledge(_: Segment) -> None:
            self._peer_control = 1
            self._send(ACK, b"", peer.receive)
            self._path.clock.after(200 * US, then)

        def answer(_: Segment) -> None:
            peer._peer_control = 1
            peer._send(SYN | ACK, b"", acknowledge)
            peer._control = 1

        self._send(SYN, b"", answer)
        self._control = 1

    def close(self) -> None:
        """Send FIN; the peer answers with its own."""
        peer = self.peer

        def last(_: Segment) -> None:
            self._peer_control = 2
            self._send(ACK, b"", lambda _: None)

        def answer(_: Segment) -> None:
            peer._peer_control = 2
            peer._send(FIN | ACK, b"", last)
            peer._control = 2

        self._send(FIN | ACK, b"", answer)
        self._control = 2

    def send(self, data: bytes, cut: int = 0) -> None:
        """Send data in one segment, or in two that are cut behind `cut` bytes."""
        for part in (data[:cut], data[cut:]):
            if part:
                self._ack_wanted = 0
                self._ack_timer += 1
                segment = self._send(PUSH | ACK, part, self.peer.receive)
                self._unacknowledged.append(segment)
                self.sent += len(part)
                if len(self._unacknowledged) == 1:
                    self._start_retry_timer(RETRANSMISSION_NS)

    def receive(self, segment: Segment) -> None:
        """Take a segment that arrives."""
        before = len(self._unacknowledged)
        self._unacknowledged = [
            one
            for one in self._unacknowledged
            if one.offset + len(one.payload) > segment.acknowledged
        ]
        if len(self._unacknowledged) != before:
            self._start_retry_timer(RETRANSMISSION_NS)
        if not segment.payload:
            return
        in_order = segment.offset == self.received
        if segment.offset >= self.received:
            self._early[segment.offset] = segment.payload
        fresh = b""
        while self.received in self._early:
            part = self._early.pop(self.received)
            fresh += part
            self.received += len(part)
        self._want_ack(at_once=not in_order)
        if fresh:
            self.on_bytes(fresh)

    def _want_ack(self, *, at_once: bool) -> None:
        self._ack_wanted += 1
        delay = QUICK_ACK_NS if self.quick or at_once else DELAYED_ACK_NS
        if self._ack_wanted >= 2:
            delay = QUICK_ACK_NS
        self._ack_timer += 1
        timer = self._ack_timer

        def acknowledge() -> None:
            if timer == self._ack_timer:
                self._ack_wanted = 0
                self._send(ACK, b"", self.peer.receive)

        self._path.clock.after(delay, acknowledge)

    def _start_retry_timer(self, delay_ns: int) -> None:
        self._retry_timer += 1
        timer = self._retry_timer

        def retransmit() -> None:
            if timer == self._retry_timer and self._unacknowledged:
                old = self._unacknowledged[0]
                self._send(PUSH | ACK, old.payload, self.peer.receive, offset=old.offset)
                self._start_retry_timer(2 * delay_ns)

        if self._unacknowledged:
            self._path.clock.after(delay_ns, retransmit)

    def _send(
        self,
        flags: int,
        payload: bytes,
        arrive: Callable[[Segment], None],
        *,
        offset: int | None = None,
    ) -> Segment:
        start = self.sent if offset is None else offset
        peer_next = self.peer.first + self._peer_control + self.received if flags & ACK else 0
        segment = Segment(
            connection=self.connection,
            from_master=self.is_master,
            ports=(self.port, self.peer.port),
            sequence=self.first + self._control + start,
            acknowledgement=peer_next,
            flags=flags,
            payload=payload,
            offset=start,
            acknowledged=self.received,
        )
        self._path.carry(segment, arrive)
        return segment
