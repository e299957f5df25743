"""Plays the slaves of a recording."""

# For each request, in this order:
#
#     1  what the matcher finds (matching.py): a recorded answer, silence included
#     2  of a unit that the recording does not have: silence, as the request is another slave's
#     3  under OnMiss.IMAGE: the register image as of this moment of the recording; and where that
#        knows too little, the device that the workflow gives for the unit
#     4  else an exception response, or silence under OnMiss.SILENT
#
# The moment is the clock's, where the matcher goes by it. Else it is the recorded time of the
# answer that was played last, so one rare request does not throw the others forward for good;
# silence leaves it, and before the first answer it is the beginning. Until an address is first seen
# it holds its first known value. The clock starts with the first request.
#
# A write that is acknowledged lies over the image until the recording has a change there; recorded
# answers stay as they are. One never seen is acknowledged where the recording knows its addresses.
# When the clock begins anew, writes are gone. A broadcast on a serial line writes to every unit.
#
# What nothing answers gets an exception response: 03 for a request that breaks its form or the
# standard's limits, 02 for an address never seen, 01 for a function that reaches no register.

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Protocol

from mbtool.core import Direction
from mbtool.modbus import (
    TABLE_FUNCTIONS,
    Response,
    Table,
    Transport,
    exception_pdu,
    parse_pdu,
    register_access,
    response_to,
    values_after,
)
from mbtool.modbus import ExceptionCode as _Code
from mbtool.replay.clock import PlayClock
from mbtool.replay.latency import LatencyModel, RecordedLatency
from mbtool.replay.matching import MatchStrategy, Moment, NoAnswer, OnEnd, matcher_for
from mbtool.replay.recording import RecordedAnswer
from mbtool.replay.steering import Control, Progress, Steering

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mbtool.modbus import Pdu, RegisterAccess
    from mbtool.replay.recording import Recording

BROADCAST_UNIT = 0
_LOOP_GAP_NS = 1_000_000_000
"""Between the end and the next beginning of a recording that has no length."""


class OnMiss(StrEnum):
    """What a request gets that the recording does not have."""

    IMAGE = "image"
    """An answer from the register image, where it knows one, else an exception response."""
    EXCEPTION = "exception"
    SILENT = "silent"


class Device(Protocol):
    """Answers for a unit what its recording does not know."""

    def learn(self, table: Table, address: int, value: int) -> None:
        """Take over what the recording knows."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None: ...


class RecordedSlave:
    """A Responder that answers as a recording did."""

    def __init__(
        self,
        recording: Recording,
        *,
        match: MatchStrategy = MatchStrategy.AUTO,
        on_miss: OnMiss = OnMiss.IMAGE,
        on_end: OnEnd = OnEnd.LAST,
        rate: Fraction | None = Fraction(1),
        latency: LatencyModel | None = None,
        devices: Mapping[int, Device] | None = None,
        transport: Transport = Transport.RTU,
        with_damage: bool = False,
    ) -> None:
        """`rate` is that of the clock, and divides recorded latencies; None leaves them out.

        `transport` is how requests come; `with_damage` plays answers that were damaged, too.
        Raises ValueError for a rate that is not more than 0, or none where a clock is needed.
        """
        if rate is None and match.by_clock:
            raise ValueError(f"{match} goes by the clock, which needs a rate")
        self._recording = recording
        self._match = match
        self._matcher = matcher_for(match, recording, on_end)
        self._on_miss = on_miss
        self._latency = latency or RecordedLatency(recording)
        self._devices = dict(devices or {})
        self._transport = transport
        self._with_damage = with_damage
        self._clock = PlayClock(
            recording.length_ns,
            rate=rate,
            gap_ns=0 if recording.length_ns else _LOOP_GAP_NS,
            is_loop=match.by_clock and on_end is OnEnd.LOOP,
        )
        self._steering = Steering(self._clock, self._step)
        self._steps = 0
        """How many answers may be used up although the player stands still."""
        self._moment_ns = recording.begin_ns
        self._lap = 0
        self._written: dict[tuple[int, Table, int], tuple[int, int]] = {}
        """Live writes: by unit, table and address the value, and the moment it was written."""
        self.asked = 0
        self.missed = 0
        """How many requests the recording has no answer for."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        self._steering.begin(now_ns)
        self.asked += 1
        found = self._matcher.find((unit, pdu), self._moment(now_ns))
        if self._is_broadcast(unit):
            request = parse_pdu(pdu, Direction.REQUEST)
            for each in self._recording.units:
                self._keep_write(each, request)
            if isinstance(found, RecordedAnswer):
                self._pass_by(found)
            return None
        if isinstance(found, RecordedAnswer):
            return self._play(unit, pdu, found)
        if unit not in self._recording.units or not pdu or found is NoAnswer.SILENCE:
            return None
        if found is NoAnswer.MISS:
            self.missed += 1
        return self._make_up(unit, pdu, found, now_ns)

    def control(self, control: Control, now_ns: int) -> None:
        """Do what someone at the keyboard wants."""
        self._steering.apply(control, now_ns)

    def progress(self, now_ns: int) -> Progress:
        by_clock = self._match.by_clock
        since_ns = self._moment_ns - self._recording.begin_ns
        done = f"{self.asked:,} asked"
        if self.missed:
            done = f"{done}, {self.missed:,} not in the recording"
        return self._steering.progress(self._clock.place(now_ns) if by_clock else since_ns, done)

    def _moment(self, now_ns: int) -> Moment:
        """Where in the recording we are now."""
        if not self._match.by_clock:
            holds = self._steering.is_paused and not self._steps
            self._steps = max(self._steps - 1, 0)
            return Moment(self._moment_ns, holds=holds)
        place_ns = self._clock.place(now_ns)
        lap = self._clock.lap(place_ns)
        if lap != self._lap:
            self._lap = lap
            self._written.clear()
        self._moment_ns = self._recording.begin_ns + self._clock.in_recording(place_ns)
        return Moment(self._moment_ns, is_over=self._clock.is_over(now_ns))

    def _step(self, now_ns: int) -> None:
        """Go on to what was asked next, or use up one answer more."""
        if not self._match.by_clock:
            self._steps += 1
            return
        place_ns = self._clock.place(now_ns)
        begin_ns = self._recording.begin_ns
        next_ns = self._recording.next_ns(begin_ns + self._clock.in_recording(place_ns))
        lap = self._clock.lap(place_ns)
        if next_ns is None and self._clock.is_loop:
            lap, next_ns = lap + 1, self._recording.next_ns(begin_ns - 1)
        if next_ns is not None:
            self._clock.jump(self._clock.lap_begin(lap) + next_ns - begin_ns, now_ns)

    def _is_broadcast(self, unit: int) -> bool:
        is_line = self._transport is not Transport.TCP
        return unit == BROADCAST_UNIT and is_line and unit not in self._recording.units

    def _play(self, unit: int, pdu: bytes, recorded: RecordedAnswer) -> Response | None:
        if recorded.pdu is None:
            if recorded.damaged is None or not self._with_damage:
                return None
            delay_ns = self._delay_ns(unit, pdu[0], recorded.damaged.latency_ns)
            return recorded.damaged.again(self._transport, delay_ns)
        self._pass_by(recorded)
        if recorded.pdu[0] == pdu[0]:
            self._keep_write(unit, parse_pdu(pdu, Direction.REQUEST))
        return Response(recorded.pdu, self._delay_ns(unit, pdu[0], recorded.latency_ns))

    def _pass_by(self, played: RecordedAnswer) -> None:
        """The answers say where in the recording we are, where the clock does not."""
        if not self._match.by_clock:
            self._moment_ns = played.at_ns

    def _delay_ns(self, unit: int, function: int, own_ns: int | None) -> int:
        latency_ns = self._latency.ns(unit, function, own_ns)
        if not self._latency.is_recorded_time:
            return latency_ns
        return 0 if self._clock.rate is None else round(latency_ns / self._clock.rate)

    def _make_up(self, unit: int, pdu: bytes, found: NoAnswer, now_ns: int) -> Response | None:
        """An answer to what was never recorded."""
        request = parse_pdu(pdu, Direction.REQUEST)
        reach = register_access(request)
        if found is NoAnswer.IMAGE or self._on_miss is OnMiss.IMAGE:
            delay_ns = self._delay_ns(unit, pdu[0], None)
            response = self._from_image(unit, request, reach, pdu)
            if response is not None:
                return Response(response, delay_ns)
            if unit in self._devices:
                answer = self._from_device(unit, request, reach, pdu, now_ns)
                return None if answer is None else replace(answer, delay_ns=delay_ns)
        if self._on_miss is OnMiss.SILENT:
            return None
        refusal = _Code.ILLEGAL_DATA_ADDRESS
        if reach is None:
            reaching = request.code in TABLE_FUNCTIONS
            refusal = _Code.ILLEGAL_DATA_VALUE if reaching else _Code.ILLEGAL_FUNCTION
        refused = exception_pdu(request.code, refusal)
        return Response(refused, self._delay_ns(unit, pdu[0], None))

    def _from_image(
        self, unit: int, request: Pdu, reach: RegisterAccess | None, pdu: bytes
    ) -> bytes | None:
        """The response, or None where one of its addresses was never seen."""
        if reach is None:
            return None
        for span in (reach.reads, reach.writes):
            if any(self._value(unit, reach.table, address) is None for address in span):
                return None
        self._keep_write(unit, request)
        values = [self._value(unit, reach.table, address) or 0 for address in reach.reads]
        return response_to(request, pdu, values)

    def _from_device(
        self, unit: int, request: Pdu, reach: RegisterAccess | None, pdu: bytes, now_ns: int
    ) -> Response | None:
        """The device's own answer, given the values that the recording knows."""
        device = self._devices[unit]
        if reach is not None:
            for address in (*reach.reads, *reach.writes):
                value = self._value(unit, reach.table, address)
                if value is not None:
                    device.learn(reach.table, address, value)
        answer = device.respond(unit, pdu, now_ns)
        if answer is not None and answer.pdu[0] == pdu[0]:
            self._keep_write(unit, request)
        return answer

    def _keep_write(self, unit: int, request: Pdu) -> None:
        """Lay what an acknowledged request wrote over the image, where that knows the address."""
        reach = register_access(request)
        if reach is None or not reach.writes:
            return
        before = [self._value(unit, reach.table, address) for address in reach.writes]
        after = values_after(request, [value or 0 for value in before])
        for address, known, value in zip(reach.writes, before, after, strict=True):
            if known is not None:
                self._written[unit, reach.table, address] = value, self._moment_ns

    def _value(self, unit: int, table: Table, address: int) -> int | None:
        """What an address holds at this moment, or None where it was never seen."""
        recorded = self._recording.timeline(unit, table).at(address, self._moment_ns)
        if recorded is None:
            return None
        value, since_ns = recorded
        written, written_ns = self._written.get((unit, table, address), (value, since_ns))
        return value if written_ns < since_ns else written
