"""The rules for Modbus/TCP connections: transaction ids, and bytes that are not Modbus."""

# TCP-101  two requests with one transaction id are pending at the same time
# TCP-102  the transaction id of a response differs from its request's
# TCP-103  a message has another protocol id than 0 (at an FA3 module: FA3-X1 instead)
# TCP-104  the unit of a response differs from its request's
# TCP-201  a connection to a Modbus port carries another protocol
# TCP-202  bytes are no ADU
# TCP-203  a retransmission differs from the first copy
#
# A capture may begin and end inside an ADU, and may lack bytes in between. So unreadable bytes give
# no finding in three cases: before the first ADU of a connection that was open before the capture,
# right before or after missing bytes, and within EDGE_NS of the end of the capture.
#
# Memory: ids and times of the last MAX_RECENT transactions of each connection (LruDict), and
# at most MAX_PENDING events with unreadable bytes, which wait because missing bytes or the end of
# the capture may follow.

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.finding import Finding, event_finding, is_joined, transaction_finding
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.modbus.adu import Verdict

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.named_transaction import NamedTransaction

MAX_RECENT = 32
MAX_PENDING = 256
EDGE_NS = 1_000_000_000

_LENGTH_END = 6
"""Number of bytes of an MBAP header up to and including the length field, which does not count
them."""


@dataclass(slots=True)
class _Connection:
    recent: deque[tuple[int, int, int]] = field(default_factory=lambda: deque(maxlen=MAX_RECENT))
    """The last transactions: transaction id, time of the request (ns), time of the response
    (ns)."""
    latest_ns: int = 0
    """The latest of the times of responses."""
    is_cut: bool = False
    """True if the capture misses bytes of the connection since the last request with a response."""


class ConnectionRules:
    """Finds wrong transaction and protocol ids, and bytes that are no ADU, on TCP connections.

    The findings are TCP-101 to TCP-203.
    """

    def __init__(self, ports: frozenset[int] | None) -> None:
        """Take the TCP ports that should carry Modbus; None for all ports."""
        self._ports = ports
        self._connections: LruDict[tuple[str, str | None], _Connection] = LruDict(_Connection)
        self._pending: deque[WireEvent] = deque()
        """Events with bytes that are no ADU. They become findings when the capture has gone on for
        EDGE_NS after them without missing bytes on their connection."""
        self._last_ns = 0

    def transaction(self, transaction: NamedTransaction) -> Iterator[Finding]:
        """Check the next transaction. Yields each finding as soon as it is certain."""
        yield from self._advance(transaction.response_ns or transaction.start_ns)
        connection = self._connections[transaction.link, transaction.source]
        if transaction.request_raw is not None and transaction.response_raw is not None:
            connection.is_cut = False
        if Verdict.OTHER_TRANSACTION_ID in transaction.verdicts:
            yield transaction_finding("TCP-102", transaction, _other_id_text(transaction))
        if Verdict.OTHER_UNIT in transaction.verdicts:
            yield transaction_finding("TCP-104", transaction, _other_unit_text(transaction))
        request_ns, response_ns = transaction.request_ns, transaction.response_ns
        id_ = transaction.transaction_id
        if id_ is None or request_ns is None or response_ns is None:
            return
        if request_ns < connection.latest_ns and any(
            id_ == other_id and other_request_ns < response_ns and request_ns < other_response_ns
            for other_id, other_request_ns, other_response_ns in connection.recent
        ):
            yield transaction_finding(
                "TCP-101",
                transaction,
                f"{request_text(transaction)}: transaction id {id_:04X}H is also another open "
                "request's",
            )
        connection.recent.append((id_, request_ns, response_ns))
        connection.latest_ns = max(connection.latest_ns, response_ns)

    @property
    def has_pending(self) -> bool:
        """True if events with unreadable bytes wait until it is certain that they are findings."""
        return bool(self._pending)

    def takes(self, run: QuietRun) -> bool:
        """True if the method `run` may check these transactions together, not one by one.

        That is so if all earlier requests on their connections were answered before their first
        request, so that no two requests were pending at the same time.
        """
        keys = [(one.link, one.source) for one in run.connections]
        if not self._connections.would_keep(keys):
            return False
        for key, one in zip(keys, run.connections, strict=True):
            known = self._connections.get(key) if one.opened_ns is None else None
            if known is not None and any(end > one.least_ns for _, _, end in known.recent):
                return False
        return True

    def run(self, run: QuietRun) -> Iterator[Finding]:
        """Check many transactions together, with the same result as `transaction` for each.

        `run` has their times and transaction ids, grouped by connection.
        """
        yield from self._advance(max(run.last_response_ns, run.last_event_ns))
        for one in run.connections:
            if one.opened_ns is not None:
                self._connections.pop((one.link, one.source))
            connection = self._connections[one.link, one.source]
            connection.is_cut = False
            connection.recent.extend(one.recent)
            connection.latest_ns = max(connection.latest_ns, one.last_response_ns)

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Check the next event of a TCP connection. Yields each finding as soon as it is
        certain.
        """
        yield from self._advance(event.ts_ns)
        match event.kind:
            case EventKind.FOREIGN:
                if is_foreign_message(event.raw):
                    yield event_finding("TCP-103", event, foreign_text(event))
                elif self._is_expected(event.destination):
                    yield event_finding("TCP-201", event)
            case EventKind.OVERLAP:
                yield event_finding("TCP-203", event)
            case EventKind.OPENED if not is_joined(event):
                self._connections.pop((event.link, event.source))
                self._connections[event.link, event.source].is_cut = False
            case EventKind.GAP | EventKind.CUT | EventKind.DISCARDED:
                self._note_loss(event)
            case EventKind.SKIPPED if self._is_complete(event):
                self._pending.append(event)
                if len(self._pending) > MAX_PENDING:
                    yield event_finding("TCP-202", self._pending.popleft())

    def close(self) -> Iterator[Finding]:
        """Drop unreadable bytes within EDGE_NS of the end of the capture.

        They may belong to an ADU that the end of the capture cuts.
        """
        yield from self._advance(self._last_ns)
        self._pending.clear()

    def _advance(self, now_ns: int) -> Iterator[Finding]:
        self._last_ns = max(self._last_ns, now_ns)
        while self._pending and self._last_ns - self._pending[0].ts_ns > EDGE_NS:
            yield event_finding("TCP-202", self._pending.popleft())

    def _is_complete(self, event: WireEvent) -> bool:
        """True if the capture has all bytes since the connection's opening or last transaction.

        Then an ADU should come next, and unreadable bytes are a finding.
        """
        return any(
            key in self._connections and not self._connections[key].is_cut for key in _keys(event)
        )

    def _note_loss(self, event: WireEvent) -> None:
        """Remember that the capture misses bytes of the connection that `event` is about.

        Unreadable bytes of this connection from the last EDGE_NS are no finding, because they
        probably belong to an ADU of which the missing bytes are a part.
        """
        for key in _keys(event):
            if key in self._connections:
                self._connections[key].is_cut = True
        ends = {event.source, event.destination}
        recent = [one for one in self._pending if one.ts_ns >= event.ts_ns - EDGE_NS]
        for one in recent:
            if one.link == event.link and {one.source, one.destination} == ends:
                self._pending.remove(one)

    def _is_expected(self, destination: str) -> bool:
        port = destination.rpartition(":")[2]
        return self._ports is None or (port.isdigit() and int(port) in self._ports)


def _keys(event: WireEvent) -> tuple[tuple[str, str | None], ...]:
    """The two keys that the connection of an event may have in ConnectionRules.

    A key is the link and the HOST:PORT of the master (None if unknown). The master may be the
    event's source or its destination.
    """
    return (event.link, event.source), (event.link, event.destination)


def is_foreign_message(raw: bytes) -> bool:
    """True if `raw` looks like one Modbus/TCP message, except that its protocol id is not 0."""
    if len(raw) < _LENGTH_END + 2 or raw[2:4] == b"\x00\x00":
        return False
    return len(raw) == _LENGTH_END + int.from_bytes(raw[4:6])


def foreign_text(event: WireEvent) -> str:
    """Describe the message in `event.raw`, whose protocol id is not 0, for a finding."""
    return f"protocol id {event.raw[2:4].hex().upper()}H in a message of {len(event.raw)} bytes"


def _other_id_text(transaction: NamedTransaction) -> str:
    id_ = transaction.transaction_id
    raw = transaction.response_raw or b""
    request = "" if id_ is None else f" to a request with id {id_:04X}H"
    return f"{request_text(transaction)}: answer with id {raw[:2].hex().upper()}H{request}"


def _other_unit_text(transaction: NamedTransaction) -> str:
    raw = transaction.response_raw or b""
    unit = raw[_LENGTH_END] if len(raw) > _LENGTH_END else 0
    return f"{request_text(transaction)} to unit {transaction.unit}: answer with unit {unit}"
