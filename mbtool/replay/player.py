"""Plays the slaves of a recording: answers the requests of a live master."""

# A request is answered by the first of these that applies:
#
#     1  the recorded answer that the matcher finds (matching.py); it may be silence
#     2  silence, if the unit never answered in the recording
#     3  with OnMiss.IMAGE, the register image: the values of registers and bits at the player's
#        time in the recording. If the image lacks an address, the simulated device for the unit
#     4  an exception response, or silence with OnMiss.SILENT: 03 for a malformed request or one
#        beyond the standard's limits, 02 for an address that was never seen, 01 for a function that
#        accesses no register or bit
#
# The player's time is the time in the recording from which it takes values. If the matcher uses the
# clock, it is the clock's time. Otherwise it is the recorded time of the response played last. So
# the answer to a request that is rare in the recording moves it far forward, but only until the
# next response is played; a missing response does not move it. Before the first response it is the
# beginning of the recording. An address has its first recorded value from the beginning on. The
# clock starts with the first request.
#
# After an acknowledged write, all responses show the written value, recorded ones too, until the
# recording has a write to the same address (LiveWrites). A write that was never recorded is
# acknowledged if all its addresses are in the recording. A broadcast on a serial line writes to
# every unit that ever answered.

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple, Protocol

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
from mbtool.replay.matching import Found, MatchStrategy, Moment, NoAnswer, OnEnd, matcher_for
from mbtool.replay.recording import RecordedAnswer, Recording, RequestKind
from mbtool.replay.steering import Control, Progress, Steering

if TYPE_CHECKING:
    from mbtool.modbus import Pdu, RegisterAccess

# The code below keeps the values that the live master has written to a slave that is played from
# a recording.
#
# The live master is the one that talks to the player; the recorded master is the one in the
# recording. After the live master has written to a register or bit, all responses show the written
# value, recorded responses too. This ends when the player reaches a later write of the recorded
# master to the same address; after it, responses show the recorded values. A response that was
# recorded before that write, but is played after it, shows the value that was shown last, so that
# the register does not seem to change back.
#
# If the live master writes the same value as the recorded master's last write, the two count as the
# same write: later recorded changes are shown, for example of a command bit that the device resets.
#
# A recorded change without a recorded write, such as that of a counter, does not end a live write.
# Responses that are repeated after the end of the recording do not end it either. If the recording
# begins again, its next write to the address ends the live write.
#
# Memory: one entry for each register or bit that the live master has written, if it is in the
# recording.


class Place(NamedTuple):
    """A position in a recording that may be played several times. Positions compare in the order in
    which they are played.
    """

    lap: int
    """The number of times that the recording had begun again: 0 while it is played for the first
    time."""
    at_ns: int
    """The time in the recording, in UTC ns."""


@dataclass(slots=True)
class _LiveValue:
    """A register or bit that the live master has written: the value that responses show."""

    value: int
    place: Place
    """The player's position when the live master wrote `value`. When a later recorded write ends
    the live write, `value` and `place` become those of the recorded response that showed it."""
    recorded_writes: int
    """The number of recorded writes to this address up to the player's position when the live
    master wrote."""


class LiveWrites:
    """Holds the registers and bits that the live master (the one that talks to the player) has
    written.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._values: dict[tuple[int, Table], dict[int, _LiveValue]] = {}
        """The values that responses show in place of the recorded ones: by unit and table, then by
        address."""

    def keep(
        self, unit: int, table: Table, address: int, value: int, *, recorded: int, place: Place
    ) -> None:
        """Keep a value that the live master wrote to an address of `unit` with an acknowledged
        write.

        `place` is the player's position in the recording at the write; `recorded` is the recorded
        value of the address at that position.
        """
        values = self._values.setdefault((unit, table), {})
        before = values.get(address)
        if before is not None:
            place = max(place, before.place)
        writes = self._recorded_writes(unit, table, address, place)
        last = self._recording.timeline(unit, table).last_write(address, place.at_ns)
        if recorded == value == last:
            writes -= 1  # Count it as that recorded write, which ends it.
        values[address] = _LiveValue(value, place, writes)

    def shown(self, unit: int, table: Table, address: int, recorded: int, place: Place) -> int:
        """Return the value of an address of `unit` that a response shows.

        This is the live master's, or `recorded`, the recorded value at `place`, if the live master
        did not write or a later recorded write has ended its write.
        """
        live = self._values.get((unit, table), {}).get(address)
        if live is None or self._has_ended(live, unit, table, address, place):
            return recorded
        return live.value

    def overlay_on_recorded(
        self, unit: int, table: Table, start: int, values: Sequence[int], place: Place
    ) -> list[int]:
        """Return the values of a recorded response of `unit`, with those replaced that the live
        master has written.

        `values` are the recorded values, from address `start` on; `place` is the position at which
        the response was recorded.
        """
        shown = list(values)
        for address, live in self._values.get((unit, table), {}).items():
            index = address - start
            if not 0 <= index < len(values):
                continue
            if self._has_ended(live, unit, table, address, place):
                live.value, live.place = values[index], place
            shown[index] = live.value
        return shown

    def _has_ended(
        self, live: _LiveValue, unit: int, table: Table, address: int, place: Place
    ) -> bool:
        """True if the recording has a write to the address after the live write `live`, up to the
        position `place`.
        """
        if place < live.place:
            return False
        return self._recorded_writes(unit, table, address, place) > live.recorded_writes

    def _recorded_writes(self, unit: int, table: Table, address: int, place: Place) -> int:
        """The number of recorded writes to an address up to `place`, including those of earlier
        laps.
        """
        recording = self._recording
        timeline = recording.timeline(unit, table)
        before = timeline.writes_until(address, recording.begin_ns - 1)
        of_lap = timeline.writes_until(address, recording.begin_ns + recording.length_ns) - before
        return place.lap * of_lap + timeline.writes_until(address, place.at_ns)


BROADCAST_UNIT = 0
MAX_UNRECORDED = 1000
"""At most this many different requests that were never recorded are counted."""
_LOOP_GAP_NS = 1_000_000_000
"""If a recording of length 0 ns (such as a single request) is played in a loop, each lap takes this
long (ns of recorded time)."""


class OnMiss(StrEnum):
    """The player's answer to a request that the recording lacks."""

    IMAGE = "image"
    """A response with the recorded values of its registers, else one from the simulated device,
    else an exception response."""
    EXCEPTION = "exception"
    SILENT = "silent"


class AnsweredFrom(StrEnum):
    """The source of the player's answer to a request of the live master."""

    RECORDED = "recorded"
    """A recorded response; or no response, because the recording has none either."""
    IMAGE = "image"
    """The recorded values of the registers that the request reads or writes."""
    PROFILE = "profile"
    """The simulated device that was made from the device's profile."""
    NOWHERE = "unknown"
    """An exception response or no response, because the recording tells nothing about the
    request."""


class Device(Protocol):
    """A simulated device that answers requests that the recording cannot answer."""

    def learn(self, table: Table, address: int, value: int) -> None:
        """Set a register or bit to its recorded value, or to the value that the live master has
        written since.
        """

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None: ...


class RecordedSlave:
    """A Responder that answers as the slaves of a recording did."""

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
        any_unit: int | None = None,
    ) -> None:
        """Prepare to play a recording.

        `rate` is recorded time divided by real time. Recorded latencies are divided by it; with
        None, responses are sent at once. `devices` holds the simulated devices by unit. `transport`
        is the transport of the live requests. A request for a unit that was never asked in the
        recording is answered as if it were for `any_unit`, unless that is None. With `with_damage`,
        damaged responses are played, too. Raises ValueError if `rate` is not above 0, or if it is
        None although `match` goes by the clock.
        """
        if rate is None and match.by_clock:
            raise ValueError(f"{match} goes by the clock, which needs a rate")
        self._recording = recording
        self._any_unit = any_unit
        self._asked_units = frozenset(unit for unit, _ in recording.answers)
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
        """The number of answers that may still be played although the player is paused: one for
        each press of the step key."""
        self._time_ns = recording.begin_ns
        """The time in the recording (UTC ns) from which the values in responses are taken."""
        self._lap = 0
        """The number of the lap, from 0. With a matcher by the clock, the clock counts the laps;
        otherwise it is the `lap` of the answer that was played last."""
        self._writes = LiveWrites(recording)
        self.answered_from: Counter[AnsweredFrom] = Counter()
        """The number of requests from the live master, by what their answers were taken from."""
        self.unrecorded: Counter[RequestKind] = Counter()
        """The number of requests from the live master that are not in the recording, by request.
        Only the first MAX_UNRECORDED different ones are counted."""
        self.missed = 0
        """The number of requests that are not in the recording, to units that answer in it."""

    @property
    def asked(self) -> int:
        """The number of requests from the live master."""
        return self.answered_from.total()

    def begin(self, now_ns: int) -> None:
        """Start the clock, unless it was started before. The first request starts it, too."""
        self._steering.begin(now_ns)

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        self._steering.begin(now_ns)
        if self._any_unit is not None and unit not in self._asked_units:
            unit = self._any_unit
        if pdu and not self._recording.has(unit, pdu):
            self._note_unrecorded(RequestKind.of(unit, pdu))
        found = self._matcher.find((unit, pdu), self._moment(now_ns))
        if isinstance(found, Found) or found is NoAnswer.SILENCE:
            self.answered_from[AnsweredFrom.RECORDED] += 1
        if self._is_broadcast(unit):
            request = parse_pdu(pdu, Direction.REQUEST)
            for each in self._recording.units:
                self._keep_write(each, request)
            if isinstance(found, Found):
                self._go_to(found)
            elif found is not NoAnswer.SILENCE:
                self.answered_from[AnsweredFrom.NOWHERE] += 1
            return None
        if isinstance(found, Found):
            return self._play(unit, pdu, found)
        if found is NoAnswer.SILENCE:
            return None
        if unit not in self._recording.units or not pdu:
            self.answered_from[AnsweredFrom.NOWHERE] += 1
            return None
        if found is NoAnswer.MISS:
            self.missed += 1
        return self._make_up(unit, pdu, found, now_ns)

    def _note_unrecorded(self, kind: RequestKind) -> None:
        if kind in self.unrecorded or len(self.unrecorded) < MAX_UNRECORDED:
            self.unrecorded[kind] += 1

    def control(self, control: Control, now_ns: int) -> None:
        """Carry out the command of a key that the user has pressed: pause, step, faster or
        slower.
        """
        self._steering.apply(control, now_ns)

    def progress(self, now_ns: int) -> Progress:
        """Return the player's state, for the status line that the user sees."""
        position_ns = self._time_ns - self._recording.begin_ns
        if self._match.by_clock:
            position_ns = self._clock.position(now_ns)
        done = f"{self.asked:,} asked"
        if self.missed:
            done = f"{done}, {self.asked - self.missed:,} as recorded"
        return self._steering.progress(position_ns, done)

    def _moment(self, now_ns: int) -> Moment:
        """Set the time in the recording (`_time_ns`, `_lap`) to the clock's, if the matcher goes by
        the clock.

        Returns that time, with whether the player is paused or at the end.
        """
        if not self._match.by_clock:
            is_paused = self._steering.is_paused and not self._steps
            self._steps = max(self._steps - 1, 0)
            return Moment(self._time_ns, is_paused=is_paused)
        position_ns = self._clock.position(now_ns)
        self._lap = self._clock.lap(position_ns)
        self._time_ns = self._recording.begin_ns + self._clock.in_recording(position_ns)
        return Moment(self._time_ns, is_over=self._clock.is_over(now_ns))

    def _step(self, now_ns: int) -> None:
        """Carry out the step key: jump to the next recorded request.

        If the matcher does not use the clock, allow one more answer instead.
        """
        if not self._match.by_clock:
            self._steps += 1
            return
        position_ns = self._clock.position(now_ns)
        begin_ns = self._recording.begin_ns
        next_ns = self._recording.next_ns(begin_ns + self._clock.in_recording(position_ns))
        lap = self._clock.lap(position_ns)
        if next_ns is None and self._clock.is_loop:
            lap, next_ns = lap + 1, self._recording.next_ns(begin_ns - 1)
        if next_ns is not None:
            self._clock.jump(self._clock.lap_begin(lap) + next_ns - begin_ns, now_ns)

    def _is_broadcast(self, unit: int) -> bool:
        is_line = not self._transport.has_mbap
        return unit == BROADCAST_UNIT and is_line and unit not in self._recording.units

    def _play(self, unit: int, pdu: bytes, found: Found) -> Response | None:
        recorded = found.answer
        if recorded.pdu is None:
            if recorded.damaged is None or not self._with_damage:
                return None
            delay_ns = self._delay_ns(unit, pdu[0], recorded.damaged.latency_ns)
            return recorded.damaged.with_same_damage(self._transport, delay_ns)
        answer = recorded.pdu
        is_good = answer[0] == pdu[0]
        request = parse_pdu(pdu, Direction.REQUEST)
        if is_good:
            self._keep_write(unit, request)
        self._go_to(found)
        if is_good:
            answer = self._with_writes(unit, request, pdu, recorded)
        return Response(answer, self._delay_ns(unit, pdu[0], recorded.latency_ns))

    def _go_to(self, found: Found) -> None:
        """Set the time in the recording, from which later values are taken, to that of the answer
        `found`.

        Does nothing if the matcher goes by the clock, which then decides the time.
        """
        if not self._match.by_clock:
            self._time_ns, self._lap = found.answer.at_ns, found.lap

    def _place(self) -> Place:
        return Place(self._lap, self._time_ns)

    def _with_writes(self, unit: int, request: Pdu, pdu: bytes, recorded: RecordedAnswer) -> bytes:
        """Return the PDU of a recorded response, with the values replaced that the live master has
        written.

        `request` is the live request parsed, and `pdu` its bytes.
        """
        answer = recorded.pdu or b""
        access = register_access(request)
        if access is None or not access.reads:
            return answer
        response = parse_pdu(answer, Direction.RESPONSE)
        values = (response.numbers() or ())[: len(access.reads)]
        if response.problem is not None or len(values) < len(access.reads):
            return answer
        # If the matcher uses the clock, the answer may have been recorded later than the clock's
        # time.
        place = min(self._place(), Place(self._lap, recorded.at_ns))
        shown = self._writes.overlay_on_recorded(
            unit, access.table, access.reads.start, values, place
        )
        return answer if shown == list(values) else response_to(request, pdu, shown)

    def _delay_ns(self, unit: int, function: int, own_ns: int | None) -> int:
        latency_ns = self._latency.ns(unit, function, own_ns)
        if not self._latency.is_recorded_time:
            return latency_ns
        return 0 if self._clock.rate is None else round(latency_ns / self._clock.rate)

    def _make_up(self, unit: int, pdu: bytes, found: NoAnswer, now_ns: int) -> Response | None:
        """Make a response to a request (its PDU is `pdu`) to which the recording has no answer.

        `found` says why: the matcher wants the register image, or the recording lacks the request.
        Returns None if no response is to be sent.
        """
        request = parse_pdu(pdu, Direction.REQUEST)
        access = register_access(request)
        if found is NoAnswer.IMAGE or self._on_miss is OnMiss.IMAGE:
            delay_ns = self._delay_ns(unit, pdu[0], None)
            from_image = self._image_response(unit, request, access, pdu)
            if from_image is not None:
                self.answered_from[AnsweredFrom.IMAGE] += 1
                return Response(from_image, delay_ns)
            if unit in self._devices:
                self.answered_from[AnsweredFrom.PROFILE] += 1
                response = self._device_response(unit, request, access, pdu, now_ns)
                return None if response is None else replace(response, delay_ns=delay_ns)
        self.answered_from[AnsweredFrom.NOWHERE] += 1
        if self._on_miss is OnMiss.SILENT:
            return None
        code = _Code.ILLEGAL_DATA_ADDRESS
        if access is None:
            has_table = request.code in TABLE_FUNCTIONS
            code = _Code.ILLEGAL_DATA_VALUE if has_table else _Code.ILLEGAL_FUNCTION
        return Response(exception_pdu(request.code, code), self._delay_ns(unit, pdu[0], None))

    def _image_response(
        self, unit: int, request: Pdu, access: RegisterAccess | None, pdu: bytes
    ) -> bytes | None:
        """Return the PDU of a response with the recorded values of the registers.

        None if the request accesses no registers or bits, or if one of the addresses was never seen
        in the recording.
        """
        if access is None:
            return None
        for span in (access.reads, access.writes):
            if any(self._value(unit, access.table, address) is None for address in span):
                return None
        self._keep_write(unit, request)
        values = [self._value(unit, access.table, address) or 0 for address in access.reads]
        return response_to(request, pdu, values)

    def _device_response(
        self, unit: int, request: Pdu, access: RegisterAccess | None, pdu: bytes, now_ns: int
    ) -> Response | None:
        """Return the simulated device's response to a request, None for no response. `pdu` is the
        request's PDU, and `access` the registers that it addresses (None for none).

        Before that, the device is given the present values of those addressed registers that the
        recording has.
        """
        device = self._devices[unit]
        if access is not None:
            for address in (*access.reads, *access.writes):
                value = self._value(unit, access.table, address)
                if value is not None:
                    device.learn(access.table, address, value)
        response = device.respond(unit, pdu, now_ns)
        if response is not None and response.pdu[0] == pdu[0]:
            self._keep_write(unit, request)
        return response

    def _keep_write(self, unit: int, request: Pdu) -> None:
        """Keep the values that the live master's acknowledged write gives to addresses that the
        recording has.
        """
        access = register_access(request)
        if access is None or not access.writes:
            return
        before = [self._value(unit, access.table, address) for address in access.writes]
        after = values_after(request, [value or 0 for value in before])
        for address, value in zip(access.writes, after, strict=True):
            recorded = self._recorded(unit, access.table, address)
            if recorded is not None:
                self._writes.keep(
                    unit, access.table, address, value, recorded=recorded, place=self._place()
                )

    def _value(self, unit: int, table: Table, address: int) -> int | None:
        """The value of a register or bit at the player's time in the recording, or the value that
        the live master has written since. None if the recording never shows a value of it.
        """
        recorded = self._recorded(unit, table, address)
        if recorded is None:
            return None
        return self._writes.shown(unit, table, address, recorded, self._place())

    def _recorded(self, unit: int, table: Table, address: int) -> int | None:
        """The recorded value of a register or bit at the player's time in the recording; None if
        the recording never shows a value of it.
        """
        known = self._recording.timeline(unit, table).at(address, self._time_ns)
        return None if known is None else known[0]
