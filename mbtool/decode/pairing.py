"""Pairs the requests and responses of one serial line, and makes their transactions."""

# One request is open at a time. The next request closes it without an answer, even if that is for
# another unit. network_pairing.py pairs those of a connection.
#
# A request without an answer is a transaction of its own. `retries` of the next equal request
# counts the requests before it that had no answer.
#
# Memory: one open request, and at most MAX_OPEN_REQUESTS counts of unanswered requests.

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import Direction
from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.decode.transactions import Ends, broadcast, no_answer, unsolicited, with_response
from mbtool.modbus.adu import Verdict
from mbtool.modbus.request_match import is_response_code

if TYPE_CHECKING:
    from mbtool.decode.stream_progress import AduPlace
    from mbtool.modbus.adu import Adu
    from mbtool.modbus.transaction import Transaction

BUS_TIMEOUT_NS = 5_000_000_000
"""Longer than any master waits, so that a late response is still paired with its request."""


class Pairing:
    """Takes the ADUs of one serial line, returns complete transactions."""

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self._open: Adu | None = None
        self._unanswered: dict[tuple[int, bytes], int] = {}
        """By unit and PDU, how many requests in a row had no answer."""

    def feed(self, adu: Adu, _place: AduPlace | None = None) -> list[Transaction]:
        """Take the next ADU, in order of time."""
        done = self.advance(adu.start_ns)
        if adu.direction is not Direction.RESPONSE:
            self._doubt_silence(adu)
            done += self.close()
            if adu.unit == 0:
                done.append(broadcast(self._ends, adu))
            else:
                self._open = adu
            return done
        request = self._open
        if (
            request is None
            or request.unit != adu.unit
            or not is_response_code(request.pdu[0], adu.pdu[0])
        ):
            done.append(unsolicited(self._ends, adu))
            return done
        self._open = None
        retries = self._unanswered.pop((request.unit, request.pdu), 0)
        done.append(with_response(self._ends, request, adu, retries, ()))
        return done

    def advance(self, now_ns: int) -> list[Transaction]:
        """Give up a request that has waited longer than the timeout; return its transaction."""
        if self._open is None or now_ns - self._open.end_ns <= BUS_TIMEOUT_NS:
            return []
        return self.close()

    def _doubt_silence(self, adu: Adu) -> None:
        """Make the open request ambiguous if an equal frame, called a retry, may be its response.

        The outcome of a request is no more certain than the direction of the frame after it.
        """
        request = self._open
        if request is not None and request.raw == adu.raw and Verdict.AMBIGUOUS in adu.verdicts:
            verdicts = tuple(dict.fromkeys((*request.verdicts, Verdict.AMBIGUOUS)))
            confidence = min(request.confidence, adu.confidence)
            self._open = replace(request, confidence=confidence, verdicts=verdicts)

    def close(self) -> list[Transaction]:
        """End the line: the open request stays without an answer."""
        request, self._open = self._open, None
        if request is None:
            return []
        key = request.unit, request.pdu
        retries = self._unanswered.pop(key, 0)
        if len(self._unanswered) >= MAX_OPEN_REQUESTS:
            del self._unanswered[next(iter(self._unanswered))]
        self._unanswered[key] = retries + 1
        return [no_answer(self._ends, request, retries)]
