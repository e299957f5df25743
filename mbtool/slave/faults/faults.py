"""Faults that a slave simulates, and the conditions under which each of them acts on a request."""

# FaultySlave passes requests to another responder, a device or a recording, and changes the
# responses. `FaultCondition` says which requests a fault is for, and `Fault` what happens to the
# responses. If several faults are for a request, they change its response one after the other.
#
# The faults are repeatable: the same requests at the same times meet the same faults. For this,
# each fault has a random generator of its own, seeded with the file's seed and the fault's position
# in the file. For each request that fits all other conditions, the fault draws one number and
# compares it with the probability.
#
# A request is executed even if its response is replaced by an exception or left out. With the kind
# STUCK, masters always read the first value that the slave gave after the fault began. A fault
# keeps such values for at most MAX_STUCK addresses; other addresses are read as usual.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from random import Random
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.devices import Span
from mbtool.modbus import Response, Table, exception_pdu, parse_pdu, register_access, response_to
from mbtool.modbus.response import ConnectionEnding, Distortion

if TYPE_CHECKING:
    from mbtool.modbus import Responder
    from mbtool.modbus.pdu import Pdu
    from mbtool.modbus.register_access import RegisterAccess

MAX_STUCK = 1 << 16

_WORD = 0xFFFF


class FaultKind(StrEnum):
    """The kind of change that a fault makes to a response; docs/faults.md describes each kind."""

    DELAY = "delay"
    NO_ANSWER = "no-answer"
    EXCEPTION = "exception"
    WRONG_UNIT = "wrong-unit"
    WRONG_ID = "wrong-id"
    TRUNCATED = "truncated"
    BAD_CRC = "bad-crc"
    EXTRA_BYTES = "extra-bytes"
    SPLIT = "split"
    CLOSE = "close"
    RESET = "reset"
    STUCK = "stuck"
    OFFSET = "offset"


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultCondition:
    """The conditions that a request must meet for a fault to act. A field that is None allows every
    request.
    """

    units: frozenset[int] | None = None
    functions: frozenset[int] | None = None
    span: Span | None = None
    """The fault is for requests that read or write at least one of these addresses; None: any."""
    from_ns: int = 0
    until_ns: int | None = None
    """The fault acts from `from_ns` until `until_ns`, both in ns since the first request."""
    nth: int = 1
    """The fault begins with the nth request that fits `units`, `functions`, `span` and the times; 1
    is the first."""
    every: int = 1
    """From the nth request on, the fault acts on every request (1), on every fifth (5), and so
    on."""
    times: int | None = None
    """The most requests on which the fault acts; None for no limit."""
    probability: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A fault: its kind, the requests on which it acts, and the parameters of its kind."""

    kind: FaultKind
    match: FaultCondition = field(default_factory=FaultCondition)
    delay_ns: int = 0
    code: int = 4
    """The exception code, for the kind EXCEPTION."""
    by: int = 1
    """The number that WRONG_UNIT adds to the unit, WRONG_ID to the transaction id, and OFFSET to
    each value."""
    count: int = 1
    """The number of bytes that TRUNCATED leaves out, or of pieces in which SPLIT sends the
    response."""
    extra: bytes = b""


class FaultySlave:
    """A responder that passes requests to another one and applies faults to its responses."""

    def __init__(self, slave: Responder, faults: Sequence[Fault], *, seed: int = 0) -> None:
        self._slave = slave
        self._faults = [
            _Active(fault, Random(f"{seed}/{place}")) for place, fault in enumerate(faults)
        ]
        self._begin_ns: int | None = None

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        """Return the slave's response, changed by all faults that act on this request.

        Without a response, only faults that end the connection act. None means no response.
        """
        if self._begin_ns is None:
            self._begin_ns = now_ns
        answer = self._slave.respond(unit, pdu, now_ns)
        if not pdu:
            return answer
        request = parse_pdu(pdu, Direction.REQUEST)
        access = register_access(request)
        for fault in self._faults:
            if not fault.is_due(unit, request, access, now_ns - self._begin_ns):
                continue
            if answer is not None:
                answer = fault.applied(unit, pdu, request, access, answer)
            elif fault.ends_connections:
                silence = Response(b"", distortion=Distortion(silent=True))
                answer = fault.applied(unit, pdu, request, access, silence)
        return answer


class _Active:
    """Counts the requests that fit the condition of one fault, and decides on which it acts."""

    def __init__(self, fault: Fault, chance: Random) -> None:
        self._fault = fault
        self._chance = chance
        self._seen = 0
        self._done = 0
        self._stuck: dict[tuple[int, Table, int], int] = {}

    @property
    def ends_connections(self) -> bool:
        """True if the fault ends the connection, even if the request gets no response."""
        return self._fault.kind in (FaultKind.CLOSE, FaultKind.RESET)

    def is_due(self, unit: int, request: Pdu, access: RegisterAccess | None, at_ns: int) -> bool:
        """Count a request if it fits the fault's condition; return True if the fault acts on it.

        `access` has the addresses that the request reads and writes, None if it has none. `at_ns`
        is the time since the first request.
        """
        match = self._fault.match
        if not _fits(match, unit, request, access, at_ns):
            return False
        self._seen += 1
        place = self._seen - match.nth
        if (
            place < 0
            or place % match.every
            or (match.times is not None and self._done >= match.times)
        ):
            return False
        if match.probability < 1 and self._chance.random() >= match.probability:
            return False
        self._done += 1
        return True

    def applied(
        self, unit: int, pdu: bytes, request: Pdu, access: RegisterAccess | None, answer: Response
    ) -> Response:
        fault = self._fault
        match fault.kind:
            case FaultKind.DELAY:
                return replace(answer, delay_ns=answer.delay_ns + fault.delay_ns)
            case FaultKind.EXCEPTION:
                return replace(answer, pdu=exception_pdu(pdu[0], fault.code))
            case FaultKind.STUCK | FaultKind.OFFSET:
                return self._with_other_values(unit, pdu, request, access, answer)
            case _:
                distortion = _distorted(fault, answer.distortion or Distortion())
                return replace(answer, distortion=distortion)

    def _with_other_values(
        self, unit: int, pdu: bytes, request: Pdu, access: RegisterAccess | None, answer: Response
    ) -> Response:
        """Return a response to a read with other values, as the kinds STUCK and OFFSET need.

        Only values at the addresses of the fault's condition change, or all if it names none. A
        response to any other request is returned unchanged.
        """
        if access is None or not access.reads or answer.pdu[:1] != pdu[:1]:
            return answer
        response = parse_pdu(answer.pdu, Direction.RESPONSE)
        values = response.numbers()
        if response.problem is not None or values is None:
            return answer
        span = self._fault.match.span
        given = [
            value
            if span is not None and address not in span
            else self._false_value(unit, access.table, address, value)
            for address, value in zip(access.reads, values, strict=False)
        ]
        return replace(answer, pdu=response_to(request, pdu, given))

    def _false_value(self, unit: int, table: Table, address: int, value: int) -> int:
        if self._fault.kind is FaultKind.OFFSET:
            return value ^ 1 if table.is_bits else value + self._fault.by & _WORD
        if len(self._stuck) >= MAX_STUCK:
            return self._stuck.get((unit, table, address), value)
        return self._stuck.setdefault((unit, table, address), value)


def _fits(
    match: FaultCondition, unit: int, request: Pdu, access: RegisterAccess | None, at_ns: int
) -> bool:
    if match.units is not None and unit not in match.units:
        return False
    if match.functions is not None and request.code not in match.functions:
        return False
    if at_ns < match.from_ns or (match.until_ns is not None and at_ns >= match.until_ns):
        return False
    return match.span is None or (access is not None and _touches(access, match.span))


def _touches(access: RegisterAccess, span: Span) -> bool:
    return access.table is span.table and any(
        part and part.start <= span.last and span.first < part.stop
        for part in (access.reads, access.writes)
    )


def _distorted(fault: Fault, before: Distortion) -> Distortion:
    match fault.kind:
        case FaultKind.NO_ANSWER:
            return replace(before, silent=True)
        case FaultKind.WRONG_UNIT:
            return replace(before, unit_by=before.unit_by + fault.by)
        case FaultKind.WRONG_ID:
            return replace(before, id_by=before.id_by + fault.by)
        case FaultKind.TRUNCATED:
            return replace(before, cut=before.cut + fault.count)
        case FaultKind.BAD_CRC:
            return replace(before, wrong_check=True)
        case FaultKind.EXTRA_BYTES:
            return replace(before, extra=before.extra + fault.extra)
        case FaultKind.SPLIT:
            return replace(before, pieces=fault.count, gap_ns=fault.delay_ns)
        case FaultKind.RESET:
            return replace(before, ending=ConnectionEnding.RESET)
        case _:
            return replace(before, ending=ConnectionEnding.CLOSE)
