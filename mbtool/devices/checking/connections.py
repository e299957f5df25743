"""Connections of Modbus/TCP: transaction ids, and what in them is not Modbus."""

# TCP-101  two requests are open at once with one id: each was sent before the other was answered
# TCP-102  an answer has another id than its request
# TCP-103  a message with another protocol id (an FA3 module does not answer one: FA3-X1 instead)
# TCP-201  a connection to a Modbus port is another protocol's
# TCP-202  bytes that are no ADU
# TCP-203  a retransmission that differs from the first copy
# RTU-201  a wrong CRC, where RTU goes over TCP
#
# A capture may begin and end inside an ADU, and lack bytes in between: bytes before the first ADU
# of a connection that was open before, bytes around those that are missing, and bytes within
# EDGE_NS of the capture's end are no finding.
#
# Holds for each connection the ids and times of the last MAX_RECENT transactions (kept.py), and at
# most MAX_WAITING events whose place in the capture is not known yet.

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.finding import Finding, found, found_in, is_joined
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import asked_for
from mbtool.modbus.adu import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.named_transaction import NamedTransaction

MAX_RECENT = 32
MAX_WAITING = 256
EDGE_NS = 1_000_000_000

_MBAP = 6
"""Bytes of a header up to its length."""


@dataclass(slots=True)
class _Connection:
    recent: deque[tuple[int, int, int]] = field(default_factory=lambda: deque(maxlen=MAX_RECENT))
    """Transaction id, and when it was asked and answered."""
    is_cut: bool = False
    """Bytes are missing in the capture, and no request with its answer came since then."""


class ConnectionRules:
    """Records of a network in; findings out."""

    def __init__(self, ports: frozenset[int] | None) -> None:
        """`ports` are those at which Modbus is expected; None for all."""
        self._ports = ports
        self._connections: LruDict[tuple[str, str | None], _Connection] = LruDict(_Connection)
        self._waiting: deque[WireEvent] = deque()
        self._last_ns = 0

    def transaction(self, transaction: NamedTransaction) -> Iterator[Finding]:
        """Take the next transaction."""
        yield from self._pass(transaction.response_ns or transaction.start_ns)
        connection = self._connections[transaction.link, transaction.source]
        if transaction.request_raw is not None and transaction.response_raw is not None:
            connection.is_cut = False
        if Verdict.OTHER_TRANSACTION_ID in transaction.verdicts:
            yield found("TCP-102", transaction, _other_id_text(transaction))
        asked_ns, answered_ns = transaction.request_ns, transaction.response_ns
        number = transaction.transaction_id
        if number is None or asked_ns is None or answered_ns is None:
            return
        if any(
            number == other and began_ns < answered_ns and asked_ns < ended_ns
            for other, began_ns, ended_ns in connection.recent
        ):
            yield found(
                "TCP-101",
                transaction,
                f"{asked_for(transaction)}: transaction id {number:04X}H is also another open "
                "request's",
            )
        connection.recent.append((number, asked_ns, answered_ns))

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Take the next event of a network."""
        yield from self._pass(event.ts_ns)
        match event.kind:
            case EventKind.FOREIGN:
                if is_foreign_message(event.raw):
                    yield found_in("TCP-103", event, foreign_text(event))
                elif self._is_expected(event.destination):
                    yield found_in("TCP-201", event)
            case EventKind.OVERLAP:
                yield found_in("TCP-203", event)
            case EventKind.BAD_CHECK:
                yield found_in("RTU-201", event)
            case EventKind.OPENED if not is_joined(event):
                self._connections.pop((event.link, event.source))
                self._connections[event.link, event.source].is_cut = False
            case EventKind.GAP | EventKind.CUT | EventKind.DISCARDED:
                self._note_loss(event)
            case EventKind.SKIPPED if self._is_in_step(event):
                self._waiting.append(event)
                if len(self._waiting) > MAX_WAITING:
                    yield found_in("TCP-202", self._waiting.popleft())

    def close(self) -> Iterator[Finding]:
        """The capture ends; what waits came right before that."""
        yield from self._pass(self._last_ns)
        self._waiting.clear()

    def _pass(self, now_ns: int) -> Iterator[Finding]:
        self._last_ns = max(self._last_ns, now_ns)
        while self._waiting and self._last_ns - self._waiting[0].ts_ns > EDGE_NS:
            yield found_in("TCP-202", self._waiting.popleft())

    def _is_in_step(self, event: WireEvent) -> bool:
        """Whether an ADU was to be expected where bytes are none."""
        return any(
            key in self._connections and not self._connections[key].is_cut for key in _keys(event)
        )

    def _note_loss(self, event: WireEvent) -> None:
        """Bytes are missing; what was told right before is the ADU that they belong to."""
        for key in _keys(event):
            if key in self._connections:
                self._connections[key].is_cut = True
        ends = {event.source, event.destination}
        cut = [one for one in self._waiting if one.ts_ns >= event.ts_ns - EDGE_NS]
        for one in cut:
            if one.link == event.link and {one.source, one.destination} == ends:
                self._waiting.remove(one)

    def _is_expected(self, destination: str) -> bool:
        port = destination.rpartition(":")[2]
        return self._ports is None or (port.isdigit() and int(port) in self._ports)


def _keys(event: WireEvent) -> tuple[tuple[str, str | None], ...]:
    """The connection of an event, whose source may be either end."""
    return (event.link, event.source), (event.link, event.destination)


def is_foreign_message(raw: bytes) -> bool:
    """Whether bytes are one message that looks like Modbus/TCP, but for its protocol id."""
    if len(raw) < _MBAP + 2 or raw[2:4] == b"\x00\x00":
        return False
    return len(raw) == _MBAP + int.from_bytes(raw[4:6])


def foreign_text(event: WireEvent) -> str:
    """What protocol id a foreign message has."""
    return f"protocol id {event.raw[2:4].hex().upper()}H in a message of {len(event.raw)} bytes"


def _other_id_text(transaction: NamedTransaction) -> str:
    number = transaction.transaction_id
    raw = transaction.response_raw or b""
    asked = "" if number is None else f" to a request with id {number:04X}H"
    return f"{asked_for(transaction)}: answer with id {raw[:2].hex().upper()}H{asked}"
