"""A recording made ready to be played as the slave: its answers by request, its values by time."""

# Two views of the same transactions:
#
#     answers   by unit and request PDU, so by function, addresses and written values; in the order
#               of the requests, each with its recorded time and latency, silence among them
#     values    by unit and table a Timeline, from every read that was answered well and every write
#               that was acknowledged; a broadcast write counts for every unit
#
# Units are all that a slave is known by: from a capture of several links with equal units the
# caller picks one link's transactions. Answers that no request asked for are left out.
#
# Memory grows with the recording: one entry for each transaction, one for each change of a value.

from __future__ import annotations

from dataclasses import dataclass
from statistics import median_low
from typing import TYPE_CHECKING, Self

from mbtool.core import Direction
from mbtool.modbus import Outcome, Table, parse_pdu, reach_of, values_after, whole_pdu
from mbtool.replay.timeline import Timeline

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.modbus import Transaction

Key = tuple[int, bytes]
"""Unit and request PDU."""


@dataclass(frozen=True, slots=True)
class RecordedAnswer:
    """What came back for one request."""

    pdu: bytes | None
    """None where the slave stayed silent."""
    at_ns: int
    """When it was complete on the wire; for silence, when the request was."""
    latency_ns: int


class Recording:
    """The answers and values of a recording; unchanged once made."""

    def __init__(self) -> None:
        self.units: set[int] = set()
        """The units that were asked, broadcasts apart."""
        self.answers: dict[Key, list[RecordedAnswer]] = {}
        self._values: dict[tuple[int, Table], Timeline] = {}
        self._latencies: dict[tuple[int, int | None], int] = {}
        self.begin_ns = 0
        """The time of the first request."""

    @classmethod
    def of(cls, transactions: Iterable[Transaction]) -> Self:
        """Build a recording; the transactions may come in any order."""
        recording = cls()
        asked = sorted(filter(_is_asked, transactions), key=lambda one: one.start_ns)
        if asked:
            recording.begin_ns = asked[0].start_ns
        recording.units = {one.unit for one in asked if one.outcome is not Outcome.BROADCAST}
        for transaction in asked:
            recording._add_answer(transaction)
        for transaction in sorted(asked, key=_answered_ns):
            recording._add_values(transaction)
        recording._latencies = _median_latencies(asked)
        return recording

    def timeline(self, unit: int, table: Table) -> Timeline:
        """What is known of one table of a unit."""
        return self._values.get((unit, table), _NOTHING)

    def latency_ns(self, unit: int, function: int) -> int:
        """The median latency of a unit for a function, else of the unit; 0 where none is known."""
        of_unit = self._latencies.get((unit, None), 0)
        return self._latencies.get((unit, function), of_unit)

    def _add_answer(self, transaction: Transaction) -> None:
        request = whole_pdu(transaction.transport, transaction.request_raw)
        if request is None:
            return
        answer = RecordedAnswer(
            whole_pdu(transaction.transport, transaction.response_raw),
            _answered_ns(transaction),
            transaction.latency_ns or 0,
        )
        self.answers.setdefault((transaction.unit, request), []).append(answer)

    def _add_values(self, transaction: Transaction) -> None:
        pdu = whole_pdu(transaction.transport, transaction.request_raw)
        if pdu is None or transaction.outcome not in (Outcome.OK, Outcome.BROADCAST):
            return
        request = parse_pdu(pdu, Direction.REQUEST)
        reach = reach_of(request)
        if reach is None:
            return
        is_broadcast = transaction.outcome is Outcome.BROADCAST
        at_ns = _answered_ns(transaction)
        for unit in self.units if is_broadcast else (transaction.unit,):
            timeline = self._values.setdefault((unit, reach.table), Timeline())
            before = timeline.last(reach.writes) if request.code == 0x16 else []
            if reach.writes and before is not None:
                timeline.note(at_ns, reach.writes.start, values_after(request, before))
            if reach.reads and not is_broadcast:
                values = (transaction.response_values or [])[: len(reach.reads)]
                timeline.note(at_ns, reach.reads.start, values)


_NOTHING = Timeline()


def _is_asked(transaction: Transaction) -> bool:
    return transaction.request_raw is not None and transaction.outcome is not Outcome.UNSOLICITED


def _answered_ns(transaction: Transaction) -> int:
    return transaction.start_ns if transaction.response_ns is None else transaction.response_ns


def _median_latencies(transactions: Iterable[Transaction]) -> dict[tuple[int, int | None], int]:
    """By unit and function, and by unit and None for all functions of the unit."""
    seen: dict[tuple[int, int | None], list[int]] = {}
    for transaction in transactions:
        if transaction.latency_ns is not None:
            for function in (transaction.function, None):
                seen.setdefault((transaction.unit, function), []).append(transaction.latency_ns)
    return {key: median_low(latencies) for key, latencies in seen.items()}
