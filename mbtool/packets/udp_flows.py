"""Follows Modbus over UDP in packets: the datagrams between a master and a slave."""

# A flow is all datagrams between two ends (address and port). The slave is the end with a wanted
# port. If both ends have one, the slave is the end with the lower port; with equal ports it is the
# destination of the first datagram.
#
# A network may deliver a datagram twice. The second copy becomes an event, and its bytes are not
# decoded, since only one message was sent. A datagram is a copy if an earlier datagram of its
# direction has the same bytes and the same identification in the IPv4 header; a retry has another
# identification. IPv6, and senders that write 0, have no identification. Then a request is a copy
# if it comes at most COPY_NS after the first one, since no master repeats a request so soon. A
# response is a copy if no request came since the first one. If flows are followed across interfaces
# (`across`), a copy that another interface captured is dropped without an event.
#
# Limits: MAX_FLOWS flows are kept; above that, the least recently used one is forgotten. For each
# direction, the digests of the last KEPT_DATAGRAMS datagrams are kept for COPY_WITH_NUMBER_NS.

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Container
from hashlib import blake2b
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Chunk, Connection, Direction, EventKind, Stamp, StreamPlace, WireEvent
from mbtool.packets.segment import UdpDatagram, endpoint
from mbtool.packets.stream_events import StreamEvent, StreamGap, StreamItem

if TYPE_CHECKING:
    from mbtool.core import Origin

MAX_FLOWS = 4096
KEPT_DATAGRAMS = 8
COPY_NS = 2_000_000
COPY_WITH_NUMBER_NS = 1_000_000_000
DOUBLED = "a datagram came twice; its second copy is left out"


class _Seen(NamedTuple):
    """A datagram that came before."""

    digest: bytes
    """The digest of the datagram's payload."""
    number: int
    ts_ns: int
    interface: str


class _Flow:
    """The datagrams between a master and a slave."""

    def __init__(self, identity: Connection) -> None:
        self.identity = identity
        self.seen = {each: deque[_Seen](maxlen=KEPT_DATAGRAMS) for each in Direction}
        self.asked_ns = 0
        """The time of the last request that is no copy."""


class UdpFlows:
    """Turns datagrams of Modbus ports into chunks, and tells copies and cut ones."""

    def __init__(self, ports: Container[int], *, across: bool) -> None:
        """`ports` are the wanted UDP ports; for `across` see TcpReassembler."""
        self._ports = ports
        self._across = across
        self._flows: OrderedDict[tuple[str, bytes, int, bytes, int], _Flow] = OrderedDict()
        self._opened = 0

    def feed(
        self, datagram: UdpDatagram, ts_ns: int, interface: str, origin: Origin | None
    ) -> list[StreamItem]:
        """Take a datagram from or to a wanted port; return its bytes, or an event for a copy."""
        flow, direction = self._flow(datagram, "" if self._across else interface)
        digest = blake2b(datagram.payload, digest_size=16).digest()
        seen = _Seen(digest, datagram.number, ts_ns, interface)
        before = flow.seen[direction]
        while before and ts_ns - before[0].ts_ns > COPY_WITH_NUMBER_NS:
            before.popleft()
        asked_ns = None if direction is Direction.REQUEST else flow.asked_ns
        copied = next((one for one in before if _is_copy(one, seen, asked_ns)), None)
        if direction is Direction.REQUEST and copied is None:
            flow.asked_ns = ts_ns
        before.append(seen)
        ends = flow.identity
        if copied is not None:
            if copied.interface != interface:
                return []
            told = WireEvent(
                ts_ns=ts_ns,
                link=ends.link,
                kind=EventKind.REPEATED,
                message=DOUBLED,
                source=str(endpoint(datagram.source, datagram.source_port)),
                destination=str(endpoint(datagram.destination, datagram.destination_port)),
                raw=datagram.payload,
            )
            return [StreamEvent(ends, told)]
        chunk = Chunk(
            ts_ns=ts_ns,
            link=ends.link,
            data=datagram.payload,
            direction=direction,
            stamp=Stamp.AT_ONCE,
            connection=ends,
            place=StreamPlace(0, None, origin),
        )
        items: list[StreamItem] = [chunk] if datagram.payload else []
        if datagram.missing:
            items.append(StreamGap(ts_ns, ends, direction, datagram.missing, EventKind.CUT))
        return items

    def _flow(self, one: UdpDatagram, scope: str) -> tuple[_Flow, Direction]:
        key = scope, one.source, one.source_port, one.destination, one.destination_port
        back = scope, one.destination, one.destination_port, one.source, one.source_port
        for each in (key, back):
            flow = self._flows.get(each)
            if flow is not None:
                self._flows.move_to_end(each)
                return flow, Direction.REQUEST if each is key else Direction.RESPONSE
        ends = (
            endpoint(one.source, one.source_port),
            endpoint(one.destination, one.destination_port),
        )
        is_request = _is_from_master(one.source_port, one.destination_port, self._ports)
        master, slave = ends if is_request else ends[::-1]
        flow = _Flow(Connection(master, slave, self._opened, is_udp=True))
        self._opened += 1
        self._flows[key if is_request else back] = flow
        if len(self._flows) > MAX_FLOWS:
            self._flows.popitem(last=False)
        return flow, Direction.REQUEST if is_request else Direction.RESPONSE


def _is_from_master(source: int, destination: int, ports: Container[int]) -> bool:
    if source in ports and destination in ports:
        return destination <= source
    return destination in ports


def _is_copy(before: _Seen, now: _Seen, asked_ns: int | None) -> bool:
    """True if a datagram is a copy of an earlier one of its direction.

    `asked_ns` is the time of the last request for a response, None for a request.
    """
    if before.digest != now.digest or before.number != now.number:
        return False
    is_sure = now.number or (asked_ns is not None and asked_ns <= before.ts_ns)
    return now.ts_ns - before.ts_ns <= (COPY_WITH_NUMBER_NS if is_sure else COPY_NS)
