"""Prepares a recording to be played as the slave: recorded answers, and values over time."""

# A Recording holds the same transactions in two forms:
#
#     answers   for each unit and request PDU, its answers in the order of the requests, each with
#               time and latency. A missing response is an answer, too. `order` has the answers to
#               all requests in one sequence
#     values    for each unit and table, a Timeline of the values in all successful reads and
#               acknowledged writes; a broadcast write counts for every unit that ever answered
#
# Slaves are identified by their unit only: if several links have the same units, the caller passes
# the transactions of one link. Unsolicited responses are left out.
#
# If only a time range is played, only requests inside it have answers. Values come from the whole
# recording, so that the registers begin with the values that they had at the start of the range.
#
# Memory grows with the recording: one entry for each transaction, for each change of a value and
# for each register of a write.

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import median_low
from typing import TYPE_CHECKING, NamedTuple, Self

from mbtool.core import Direction, WireEvent
from mbtool.modbus import Outcome, Table, parse_pdu, register_access, values_after, whole_pdu
from mbtool.replay.damaged import DamagedAnswer, damaged_answers
from mbtool.replay.timeline import Timeline, TimeRange

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

Key = tuple[int, bytes]
"""Identifies equal requests: the unit and the PDU of the request."""


@dataclass(frozen=True, slots=True)
class RecordedAnswer:
    """The recorded answer to a request: a response, or none."""

    pdu: bytes | None
    """The PDU of the response; None if there was no intact response."""
    at_ns: int
    """The time (UTC ns) of the response's last byte; if there is no response, of the request's last
    byte."""
    latency_ns: int
    asked_ns: int = 0
    """The time (UTC ns) of the request's last byte."""
    damaged: DamagedAnswer | None = None
    """The damaged response, if one was captured in place of an intact one; else None."""


class RequestKind(NamedTuple):
    """What a request asks for, without the values that it writes."""

    unit: int
    code: int
    address: int | None
    quantity: int | None
    pdu: bytes
    """The whole PDU if the request addresses no registers or bits; otherwise empty."""

    @classmethod
    def of(cls, unit: int, pdu: bytes) -> RequestKind:
        request = parse_pdu(pdu, Direction.REQUEST)
        if register_access(request) is None:
            return cls(unit, request.code, None, None, pdu)
        return cls(unit, request.code, request.number("address"), request.number("quantity"), b"")


_ALL = TimeRange()


class Recording:
    """A recording prepared to be played as the slave: answers and values; it never changes once
    built.
    """

    def __init__(self) -> None:
        self.units: set[int] = set()
        """The units from which the recording has at least one intact response."""
        self.answers: dict[Key, list[RecordedAnswer]] = {}
        self.order: list[tuple[Key, RecordedAnswer]] = []
        self._values: dict[tuple[int, Table], Timeline] = {}
        self._latencies: dict[tuple[int, int | None], array[int]] = {}
        self._medians: dict[tuple[int, int | None], int] = {}
        self.begin_ns = 0
        """The time (UTC ns) at which the played part begins: the first request of the recording, or
        the beginning of the time range that the user gave."""
        self.length_ns = 0
        """The length of the played part in ns: from `begin_ns` to the last answer, or to the end of
        the time range that the user gave."""

    @classmethod
    def of(
        cls,
        transactions: Iterable[Transaction],
        part: TimeRange = _ALL,
        events: Iterable[WireEvent] = (),
        origin_ns: int | None = None,
    ) -> Self:
        """Build a recording; the transactions may come in any order.

        Only requests inside the time range `part` get answers. `part` counts from `origin_ns` (UTC
        ns); if that is None, from the first request. The bytes of damaged responses are taken from
        `events`, the events of the same links as the transactions.
        """
        recording = cls()
        asked = sorted(filter(_is_asked, transactions), key=lambda one: one.start_ns)
        first_ns = asked[0].start_ns if asked else 0
        if origin_ns is not None:
            first_ns = origin_ns
        recording.begin_ns = first_ns + part.start_ns
        recording.units = {
            one.unit for one in asked if whole_pdu(one.transport, one.response_raw) is not None
        }
        damaged = damaged_answers(asked, events)
        keys: dict[Key, Key] = {}
        for index, transaction in enumerate(asked):
            if transaction.start_ns - first_ns in part:
                recording._add_answer(transaction, damaged.get(index), keys)
        for transaction in sorted(asked, key=_answered_ns):
            recording._add_values(transaction)
        recording._add_latencies(asked)
        last_ns = max((answer.at_ns for _, answer in recording.order), default=0)
        end_ns = last_ns if part.end_ns is None else first_ns + part.end_ns
        recording.length_ns = max(end_ns - recording.begin_ns, 0)
        return recording

    def has(self, unit: int, pdu: bytes) -> bool:
        """True if the recording has such a request; if it writes, with these or other values."""
        return (unit, pdu) in self.answers or RequestKind.of(unit, pdu) in self._kinds

    @cached_property
    def _kinds(self) -> frozenset[RequestKind]:
        return frozenset(RequestKind.of(*key) for key in self.answers)

    def timeline(self, unit: int, table: Table) -> Timeline:
        """The recorded values of one table of a unit over time; without any values if the unit has
        none.
        """
        return self._values.get((unit, table), _NOTHING)

    def latency_ns(self, unit: int, function: int) -> int:
        """The median latency (ns) of the unit's responses to this function code.

        If the unit never responded to it, the median of all responses of the unit; 0 if there are
        none.
        """
        of_unit = self._medians.get((unit, None), 0)
        return self._medians.get((unit, function), of_unit)

    def latencies(self, unit: int, function: int) -> Sequence[int]:
        """The latencies (ns) of all responses of the unit to this function code.

        If the unit never responded to it, the latencies of all responses of the unit.
        """
        seen = self._latencies.get((unit, function)) or self._latencies.get((unit, None))
        return seen or ()

    def next_ns(self, at_ns: int) -> int | None:
        """The time (UTC ns) of the first request after `at_ns` (UTC ns); None if there is none."""
        index = bisect_right(self.order, at_ns, key=lambda each: each[1].asked_ns)
        return self.order[index][1].asked_ns if index < len(self.order) else None

    def _add_answer(
        self, transaction: Transaction, damaged: DamagedAnswer | None, keys: dict[Key, Key]
    ) -> None:
        """Add the recorded answer to a transaction's request; `damaged` is its damaged response, if
        any.

        `keys` holds each Key once, as key and as value, so that equal requests share one object and
        memory is saved.
        """
        request = whole_pdu(transaction.transport, transaction.request_raw)
        if request is None:
            return
        answer = RecordedAnswer(
            whole_pdu(transaction.transport, transaction.response_raw),
            _answered_ns(transaction),
            transaction.latency_ns or 0,
            transaction.start_ns,
            damaged,
        )
        key = keys.setdefault((transaction.unit, request), (transaction.unit, request))
        self.answers.setdefault(key, []).append(answer)
        self.order.append((key, answer))

    def _add_latencies(self, asked: Iterable[Transaction]) -> None:
        """Collect the latencies of the transactions `asked`, by unit and function code.

        The key (unit, None) has the latencies of all functions of a unit.
        """
        for one in asked:
            if one.latency_ns is not None:
                for function in (one.function, None):
                    seen = self._latencies.setdefault((one.unit, function), array("q"))
                    seen.append(one.latency_ns)
        self._medians = {key: median_low(seen) for key, seen in self._latencies.items()}

    def _add_values(self, transaction: Transaction) -> None:
        pdu = whole_pdu(transaction.transport, transaction.request_raw)
        if pdu is None or transaction.outcome not in (Outcome.OK, Outcome.LATE, Outcome.BROADCAST):
            return
        request = parse_pdu(pdu, Direction.REQUEST)
        access = register_access(request)
        if access is None:
            return
        is_broadcast = transaction.outcome is Outcome.BROADCAST
        at_ns = _answered_ns(transaction)
        for unit in self.units if is_broadcast else (transaction.unit,):
            timeline = self._values.setdefault((unit, access.table), Timeline())
            # A mask write (16H) changes only some bits of a register, so the register's value
            # before it is needed.
            before = timeline.last(access.writes) if request.code == 0x16 else []
            if access.writes:
                after = None if before is None else values_after(request, before)
                unknown = [None] * len(access.writes)
                timeline.note_writes(at_ns, access.writes.start, after or unknown)
                timeline.note(at_ns, access.writes.start, after or ())
            if access.reads and not is_broadcast:
                values = (transaction.response_values or [])[: len(access.reads)]
                timeline.note(at_ns, access.reads.start, values)


_NOTHING = Timeline()


def _is_asked(transaction: Transaction) -> bool:
    return transaction.request_raw is not None and transaction.outcome is not Outcome.NOT_CAPTURED


def _answered_ns(transaction: Transaction) -> int:
    return transaction.start_ns if transaction.response_ns is None else transaction.response_ns
