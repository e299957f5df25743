"""Plays the slaves of a recording."""

# For each request, in this order:
#
#     1  seen in the recording (unit and PDU): its next recorded answer, silence included; once they
#        have run out, the last that was no silence, since a capture often ends before an answer
#     2  of a unit that the recording does not have: silence, as the request is another slave's
#     3  never seen: the register image as of this moment of the recording, under OnMiss.IMAGE
#
# The moment is the latest recorded time among the answers that were played, so it never runs
# backwards; before the first of them it is the beginning of the recording. Until an address is
# first seen it holds its first known value.
#
# A write that is acknowledged lies over the image until the recording has a change there; recorded
# answers stay as they are. One never seen is acknowledged where the recording knows its addresses.
#
# What the image cannot answer gets an exception response: 03 for a request that breaks its form or
# the standard's limits, 02 for an address never seen, 01 for a function that reaches no register.

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.modbus import (
    REACHING,
    Answer,
    Table,
    exception_pdu,
    parse_pdu,
    reach_of,
    response_to,
    values_after,
)
from mbtool.modbus import ExceptionCode as _Code

if TYPE_CHECKING:
    from mbtool.modbus import Pdu
    from mbtool.replay.recording import Key, RecordedAnswer, Recording


class OnMiss(StrEnum):
    """What a request gets that the recording does not have."""

    IMAGE = "image"
    """An answer from the register image, where it knows one, else an exception response."""
    EXCEPTION = "exception"
    SILENT = "silent"


class RecordedSlave:
    """A Responder that answers as a recording did."""

    def __init__(
        self,
        recording: Recording,
        *,
        on_miss: OnMiss = OnMiss.IMAGE,
        speed: float | None = 1.0,
    ) -> None:
        """`speed` divides the recorded latencies; None leaves them out."""
        if speed is not None and not speed > 0:
            raise ValueError(f"speed must be more than 0, not {speed}")
        self._recording = recording
        self._on_miss = on_miss
        self._speed = speed
        self._moment_ns = recording.begin_ns
        self._played: dict[Key, int] = {}
        """How many recorded answers were given for a request."""
        self._written: dict[tuple[int, Table, int], tuple[int, int]] = {}
        """Live writes: by unit, table and address the value, and the moment it was written."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Answer | None:
        recorded = self._next((unit, pdu))
        if recorded is not None:
            self._moment_ns = max(self._moment_ns, recorded.at_ns)
            if recorded.pdu is not None and recorded.pdu[0] == pdu[0]:
                self._keep_write(unit, parse_pdu(pdu, Direction.REQUEST))
            return self._answer(recorded.pdu, recorded.latency_ns)
        if unit not in self._recording.units or not pdu or self._on_miss is OnMiss.SILENT:
            return None
        response = self._from_image(unit, pdu)
        return self._answer(response, self._recording.latency_ns(unit, pdu[0]))

    def _next(self, key: Key) -> RecordedAnswer | None:
        answers = self._recording.answers.get(key)
        if answers is None:
            return None
        place = self._played.get(key, 0)
        if place < len(answers):
            self._played[key] = place + 1
            return answers[place]
        return next((one for one in reversed(answers) if one.pdu is not None), answers[-1])

    def _answer(self, pdu: bytes | None, latency_ns: int) -> Answer | None:
        if pdu is None:
            return None
        return Answer(pdu, 0 if self._speed is None else round(latency_ns / self._speed))

    def _from_image(self, unit: int, pdu: bytes) -> bytes:
        request = parse_pdu(pdu, Direction.REQUEST)
        reach = reach_of(request)
        if reach is None:
            reaching = request.code in REACHING
            refusal = _Code.ILLEGAL_DATA_VALUE if reaching else _Code.ILLEGAL_FUNCTION
            return exception_pdu(request.code, refusal)
        spans = (reach.reads, reach.writes)
        known = all(self._values(unit, reach.table, span) is not None for span in spans)
        if not known or self._on_miss is OnMiss.EXCEPTION:
            return exception_pdu(request.code, _Code.ILLEGAL_DATA_ADDRESS)
        self._keep_write(unit, request)
        values = self._values(unit, reach.table, reach.reads)
        return response_to(request, pdu, values or [])

    def _keep_write(self, unit: int, request: Pdu) -> None:
        """Lay what an acknowledged request wrote over the image."""
        reach = reach_of(request)
        if reach is None or not reach.writes:
            return
        before = self._values(unit, reach.table, reach.writes)
        if before is None:
            return
        for address, value in zip(reach.writes, values_after(request, before), strict=True):
            self._written[unit, reach.table, address] = value, self._moment_ns

    def _values(self, unit: int, table: Table, addresses: range) -> list[int] | None:
        """What the addresses hold at this moment, or None where one was never seen."""
        timeline = self._recording.timeline(unit, table)
        values = []
        for address in addresses:
            recorded = timeline.at(address, self._moment_ns)
            if recorded is None:
                return None
            value, since_ns = recorded
            written, written_ns = self._written.get((unit, table, address), (value, since_ns))
            changed_since = written_ns < since_ns <= self._moment_ns
            values.append(value if changed_since else written)
        return values
