"""Decodes a serial line with two taps: one hears the master, the other the slaves."""

# A side is one tap with a splitter of its own, which knows the direction of its bytes. The events
# of both sides (ADUs and skipped bytes) are merged into the order in which they were sent, and go
# to one pairing. Times alone do not give that order, as each adapter has its own delay; the
# alignment of requests with responses does. If no alignment decides, times do.
#
# A side is known up to a time if all its events that began before that time were found. That is the
# time of the first byte that its splitter still holds. If the splitter holds none, it is the time
# of the side's last read, or the time until which the side was silent. The earliest event goes to
# the pairing when both sides are known up to LOOKAHEAD_NS after it; events that began later have no
# influence. So the result depends neither on how the bytes were cut into reads nor on which side
# was read first.
#
# A log does not record silence. But a read arrives at most MAX_CLOCK_STEP_NS after a read of the
# other side with the same time. So the reads of one side show the least time for which the other
# side was silent.
#
# If a read is more than MAX_CLOCK_STEP_NS older than the time up to which its side is known, the
# clock was set back. All waiting events then go to the pairing, and both sides start again, as at
# the start of a capture.
#
# If the first MISPLACED_FRAMES frames that fit one direction only are all on the wrong side, one
# MISPLACED event reports that the two ports are exchanged.
#
# Limit: MAX_HELD waiting events, and what the splitters hold. Beyond that the earliest event goes
# to the pairing without waiting for the lookahead.

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import islice, takewhile

from mbtool.core import Direction, EventKind, SerialFormat, WireEvent
from mbtool.core.limits import MAX_CLOCK_STEP_NS
from mbtool.decode.connections import Decoded, skipped_event
from mbtool.decode.pairing import BUS_TIMEOUT_NS, Pairing, has_code
from mbtool.decode.transactions import Ends
from mbtool.framing.rtu_lengths import MIN_FRAME, frame_size
from mbtool.modbus.adu import Adu, Skipped, crc
from mbtool.modbus.expected_response import is_response_to
from mbtool.modbus.pdu import Pdu, parse_pdu, pdu_length
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

# The code below aligns the requests that one tap heard with the responses that another tap heard.
#
# Each of the two adapters delivers bytes with its own delay, so a response can seem to begin before
# its request has ended. These rules hold on every line, within the difference of the delays:
#
#     1  a response follows its request         the response may seem up to SKEW_NS too early
#     2  the next request follows the response  the request may seem up to SKEW_NS too early
#     3  a request has at most one response, and responses come in the order of the requests
#     4  a master waits for a response before it sends the next request
#
# Among all alignments that keep rules 1 to 3, the one with the lowest cost is taken. A cost is a
# time in ns: by how much a response is too early for its request or too late for the next one, plus
# the constants below for a pair whose contents do not fit, a request without a response (rule 4)
# and a response without a request. So a pair whose times are wrong by less than SKEW_NS is still
# aligned. If a capture begins with a response whose request is missing, that response stays alone;
# otherwise every later response of a fast poll would be assigned to the wrong request. If earlier
# responses seemed early, a later one costs nothing for being early by the same time.
#
# At most MAX_ALIGNED requests and responses are examined; later ones do not affect the first.

SKEW_NS = 50_000_000
"""The largest difference in ns between the delays of two adapters: three times the 16 ms for which
the latency timer of an FTDI adapter holds bytes back."""

MAX_ALIGNED = 8
"""At most this many requests, and this many responses, are compared at one time to pair the first
of them."""

_MISMATCH_NS = 4 * SKEW_NS
"""Cost (ns) of aligning a request and a response of the same unit and function of which the
response does not fit, for instance because of its quantity. That is rarer than a lost response."""
_IMPATIENCE = 8
"""Cost (ns) of a request without a response, for each ns by which the master waited less than
SKEW_NS before its next request. Masters wait longer for a response."""
_UNSOLICITED_NS = MAX_ALIGNED * SKEW_NS
"""Cost (ns) of a response without a request: slaves do not send on their own."""
_FIRST_UNSOLICITED_NS = SKEW_NS
"""Cost (ns) of a response without a request if it is the first of a capture: its request may have
been sent before the capture."""
_IMPOSSIBLE_NS = sys.maxsize
"""The cost (ns) of a pair that is excluded."""


@dataclass(frozen=True, slots=True, eq=False)
class TapRequest:
    """A request that a tap heard, with its parsed PDU."""

    adu: Adu
    pdu: Pdu

    @classmethod
    def of(cls, adu: Adu) -> TapRequest:
        return cls(adu, parse_pdu(adu.pdu, Direction.REQUEST))


def request_of_first(
    requests: Sequence[TapRequest],
    responses: Sequence[Adu],
    until_ns: int,
    *,
    ahead_ns: int = 0,
    at_start: bool = False,
) -> int | None:
    """Return the index of the request that the first response belongs to; None if it has none.

    `requests` and `responses` are all ADUs of the two taps that began until `until_ns`, in order of
    time; the first request may be an older, pending one. `ahead_ns` is the time by which earlier
    responses seemed to begin before their request ended. `at_start` is True if the capture begins
    here, so that the request of the first response may be missing.
    """
    if len(requests) > MAX_ALIGNED:
        until_ns = min(until_ns, requests[MAX_ALIGNED].adu.start_ns)
    requests, responses = requests[:MAX_ALIGNED], responses[:MAX_ALIGNED]
    if _pairs_in_order_cost_nothing(requests, responses, ahead_ns):
        return 0  # The usual case; no alignment can cost less.

    def costs(request: int, response: int) -> tuple[int, int, int]:
        """Return the lowest costs (ns) of aligning the requests from the index `request` on with
        the responses from the index `response` on.

        The first cost is that of making the first two a pair, the second that of leaving the first
        request without a response, the third that of leaving the first response without a request.
        """
        has_request, has_response = request < len(requests), response < len(responses)
        paired = unanswered = unsolicited = _IMPOSSIBLE_NS
        if has_request and has_response:
            pair_ns = _pair_cost(requests, request, responses[response], ahead_ns)
            paired = lowest(request + 1, response + 1) + pair_ns
        if has_request:
            unanswered = lowest(request + 1, response) + _unanswered_cost(requests, request)
        if has_response:
            is_first = at_start and response == 0
            alone_ns = _unsolicited_cost(responses[response], until_ns, is_first)
            unsolicited = lowest(request, response + 1) + alone_ns
        return paired, unanswered, unsolicited

    @cache
    def lowest(request: int, response: int) -> int:
        at_end = request == len(requests) and response == len(responses)
        return 0 if at_end else min(costs(request, response))

    for request in range(len(requests)):
        paired, unanswered, unsolicited = costs(request, 0)
        if paired <= min(unanswered, unsolicited):
            return request
        if unsolicited < unanswered:
            return None
    return None


def _pairs_in_order_cost_nothing(
    requests: Sequence[TapRequest], responses: Sequence[Adu], ahead_ns: int
) -> bool:
    """True if there is no cost in pairing the n-th response with the n-th request, for every n."""
    answered = len(responses)
    return (
        0 < answered <= len(requests)
        and not any(
            _pair_cost(requests, index, each, ahead_ns) for index, each in enumerate(responses)
        )
        and not any(_unanswered_cost(requests, index) for index in range(answered, len(requests)))
    )


def _pair_cost(requests: Sequence[TapRequest], index: int, response: Adu, ahead_ns: int) -> int:
    request = requests[index].adu
    if not has_code(request, response):
        return _IMPOSSIBLE_NS
    early_ns = request.end_ns - response.start_ns
    late_ns = -_IMPOSSIBLE_NS
    if index + 1 < len(requests):
        late_ns = response.end_ns - requests[index + 1].adu.start_ns
    if max(early_ns, late_ns) > SKEW_NS or -early_ns > BUS_TIMEOUT_NS:
        return _IMPOSSIBLE_NS
    mismatch_ns = 0 if is_response_to(requests[index].pdu, response.pdu) else _MISMATCH_NS
    return max(early_ns - ahead_ns, 0) + max(late_ns + ahead_ns, 0) + mismatch_ns


def _unanswered_cost(requests: Sequence[TapRequest], index: int) -> int:
    request = requests[index].adu
    if request.unit == 0 or index + 1 == len(requests):
        return 0  # A broadcast has no response; the last request's may still come.
    waited_ns = requests[index + 1].adu.start_ns - request.end_ns
    return _IMPATIENCE * max(SKEW_NS - waited_ns, 0)


def _unsolicited_cost(response: Adu, until_ns: int, is_first: bool) -> int:
    before_end_ns = until_ns - response.start_ns
    if before_end_ns <= SKEW_NS:
        return max(before_end_ns, 0)  # The request may begin after `until_ns`.
    return _FIRST_UNSOLICITED_NS if is_first else _UNSOLICITED_NS


LOOKAHEAD_NS = 2 * SKEW_NS
"""An event is paired once both sides are known up to this time (ns) after it."""
MAX_HELD = 512
"""At most this many events wait until both sides are known; beyond it, the first is paired at once.
A line at 115200 baud has about this many of the shortest frames in 1 s."""
MISPLACED_FRAMES = 4
"""If the first frames that fit one direction only are all on the wrong side, an event reports
exchanged sides after this many."""

_SPEAKERS = {Direction.REQUEST: "the master", Direction.RESPONSE: "a slave"}


class TapPair:
    """Takes the bytes of both taps of one serial line; returns ADUs, transactions and events."""

    def __init__(self, link: str, line: SerialFormat, *, ascii: bool = False) -> None:  # noqa: A002
        self._link = link
        self._pairing = Pairing(Ends(link))
        self._sides = {
            speaker: _TapSide(speaker, line, ascii=ascii)
            for speaker in (Direction.REQUEST, Direction.RESPONSE)
        }
        self._master = self._sides[Direction.REQUEST]
        self._slaves = self._sides[Direction.RESPONSE]
        self._pending: TapRequest | None = None
        """The last request that was passed to the pairing. None before the first request, after a
        broadcast, and once the request's response was passed to the pairing, too."""
        self._has_request = False
        """True once the first request was passed to the pairing, which joins requests and
        responses."""
        self._answered_ns: int | None = None
        """The time at which the last response ended, in ns. None before the first response, and
        after the next request."""
        self._ahead_ns = 0
        """The time in ns by which responses seem to begin before their request ends, because the
        two adapters differ in delay. It is learned from earlier responses; negative if responses
        seem to end after the next request begins."""
        self._misplaced = 0
        """The number of frames so far whose form fits only the other tap's direction; -1 once a
        frame fitted its own tap only, or exchanged ports were reported."""

    def feed(self, direction: Direction, data: bytes, ts_ns: int) -> list[Decoded]:
        """Take the bytes of one read; return the ADUs, transactions and events that they complete.

        `direction` names the tap: RESPONSE the one that hears the slaves, every other direction the
        one that hears the master. `ts_ns` is the time of the last byte.
        """
        speaker = Direction.RESPONSE if direction is Direction.RESPONSE else Direction.REQUEST
        decoded = self._restart_if_set_back(ts_ns, self._sides[speaker].until_ns)
        for side in self._sides.values():
            if side.speaker is speaker:
                side.feed(data, ts_ns)
            else:
                side.advance(ts_ns - MAX_CLOCK_STEP_NS)
        return decoded + self._take_known()

    def advance(self, now_ns: int) -> list[Decoded]:
        """Note that all bytes that the taps heard until `now_ns` were fed; return the ADUs,
        transactions and events that this completes, such as a request that has waited too long.
        """
        known_ns = min(side.until_ns for side in self._sides.values())
        decoded = self._restart_if_set_back(now_ns, known_ns)
        for side in self._sides.values():
            side.advance(now_ns)
        decoded += self._take_known()
        if not any(side.has_pending_events for side in self._sides.values()):
            decoded += self._pairing.advance(now_ns)
        return decoded

    def close(self, end_ns: int | None = None) -> list[Decoded]:
        """End the line: return all ADUs, transactions and events that still wait.

        `end_ns` is the time at which the capture ended: a pending request whose response may have
        come later gets the outcome `not-captured`. If `end_ns` is None, it gets the outcome
        `no-answer`.
        """
        return [*self._take_all(), *self._pairing.close(end_ns)]

    def _restart_if_set_back(self, ts_ns: int, known_ns: int) -> list[Decoded]:
        """If the clock was set back, give all waiting events to the pairing and forget all times.

        `ts_ns` is the latest time, `known_ns` the time up to which all bytes were fed before.
        Returns the results of the waiting events; nothing if the clock was not set back.
        """
        if ts_ns >= known_ns - MAX_CLOCK_STEP_NS:
            return []
        decoded = self._take_all()
        for side in self._sides.values():
            side.until_ns = 0
        self._pending = self._answered_ns = None
        self._has_request = False
        self._ahead_ns = 0
        return decoded

    def _take_all(self) -> list[Decoded]:
        for side in self._sides.values():
            side.close()
        decoded: list[Decoded] = []
        while self._held:
            self._take_next(decoded)
        return decoded

    def _take_known(self) -> list[Decoded]:
        """Give each waiting event to the pairing once all events of both taps are known that began
        up to LOOKAHEAD_NS after it.

        Returns their results. If more than MAX_HELD events wait, the earliest ones do not wait
        longer.
        """
        known_ns = min(side.known_ns for side in self._sides.values())
        decoded: list[Decoded] = []
        while self._held and (self._first_ns + LOOKAHEAD_NS <= known_ns or self._held > MAX_HELD):
            self._take_next(decoded)
        return decoded

    @property
    def _held(self) -> int:
        return sum(len(side.events) for side in self._sides.values())

    @property
    def _first_ns(self) -> int:
        return min(_start_ns(side.events[0]) for side in self._sides.values() if side.events)

    def _take_next(self, decoded: list[Decoded]) -> None:
        side = self._next_side()
        event = side.events.popleft()
        self._check_ports(event, side.speaker, decoded)
        if isinstance(event, Skipped):
            decoded += self._pairing.note_skipped(event)
            decoded.append(skipped_event(event, self._link, ("", ""), _SPEAKERS[side.speaker]))
            return
        decoded.append(event)
        decoded += self._pairing.feed(event)
        if side is self._master:
            self._note_request(event)
        elif self._pending is not None and has_code(self._pending.adu, event):
            self._ahead_ns = max(self._ahead_ns, self._pending.adu.end_ns - event.start_ns)
            self._answered_ns = event.end_ns
            self._pending = None

    def _note_request(self, request: Adu) -> None:
        if self._answered_ns is not None:
            self._ahead_ns = min(self._ahead_ns, request.start_ns - self._answered_ns)
            self._answered_ns = None
        self._has_request = True
        self._pending = TapRequest.of(request) if request.unit != 0 else None

    def _next_side(self) -> _TapSide:
        """Return the tap whose first waiting event was sent before the other tap's."""
        if not self._slaves.events:
            return self._master
        if not self._master.events:
            return self._slaves
        until_ns = self._first_ns + LOOKAHEAD_NS
        responses = list(self._slaves.adus(until_ns))
        if responses:
            requests = [TapRequest.of(adu) for adu in self._master.adus(until_ns)]
            pending = [self._pending] if self._pending is not None else []
            index = request_of_first(
                [*pending, *requests],
                responses,
                until_ns,
                ahead_ns=self._ahead_ns,
                at_start=not self._has_request,
            )
            if index is not None:
                return self._slaves if index < len(pending) else self._master
        by_time = _start_ns(self._slaves.events[0]) < _start_ns(self._master.events[0])
        return self._slaves if by_time else self._master

    def _check_ports(
        self, event: Adu | Skipped, speaker: Direction, decoded: list[Decoded]
    ) -> None:
        """Count `event` if its form fits only the other tap's direction.

        After MISPLACED_FRAMES such events, append an event to `decoded` that reports exchanged
        ports. `speaker` is the direction of the tap that heard `event`.
        """
        if self._misplaced < 0:
            return
        fitting = _only_speaker(event)
        if fitting is None:
            return
        self._misplaced = -1 if fitting is speaker else self._misplaced + 1
        if self._misplaced == MISPLACED_FRAMES:
            self._misplaced = -1
            decoded.append(
                WireEvent(
                    ts_ns=_start_ns(event),
                    link=self._link,
                    kind=EventKind.MISPLACED,
                    message="the first port hears what slaves say, or the second what the master "
                    "says; name them the other way round",
                )
            )


class _TapSide:
    """One tap of a TapPair: its splitter, and its events that are not yet passed to the pairing."""

    def __init__(self, speaker: Direction, line: SerialFormat, *, ascii: bool) -> None:  # noqa: A002
        self.speaker = speaker
        self.events: deque[Adu | Skipped] = deque()
        splitter = AsciiSplitter if ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(line, speaker=speaker)
        self._character_ns = line.character_ns
        self.until_ns = 0
        """All bytes of this tap up to this time, in ns, were fed."""
        self._held: deque[_Read] = deque()
        """The reads of which the splitter still holds bytes, the oldest read first."""

    @property
    def known_ns(self) -> int:
        """The time (ns) before which no further event of this tap can begin."""
        return self._held[0].start_ns if self._held else self.until_ns

    @property
    def has_pending_events(self) -> bool:
        return bool(self._held or self.events)

    def feed(self, data: bytes, ts_ns: int) -> None:
        if data:
            self._held.append(_Read(len(data), ts_ns, self._character_ns))
            self.until_ns = max(self.until_ns, ts_ns)
            self._add(self._splitter.feed(data, ts_ns))

    def advance(self, now_ns: int) -> None:
        self.until_ns = max(self.until_ns, now_ns)
        self._add(self._splitter.advance(now_ns))

    def close(self) -> None:
        self._add(self._splitter.close())

    def adus(self, until_ns: int) -> Iterator[Adu]:
        """Yield the waiting ADUs that began by the time `until_ns`, at most MAX_ALIGNED + 1."""
        began = takewhile(lambda event: _start_ns(event) <= until_ns, self.events)
        return islice((event for event in began if isinstance(event, Adu)), MAX_ALIGNED + 1)

    def _add(self, events: list[Adu | Skipped]) -> None:
        """Append events of the splitter; forget the reads of which it then holds no bytes."""
        self.events += events
        released = sum(len(event.raw) for event in events)
        while released and self._held:
            read = self._held[0]
            part = min(released, read.size)
            read.size -= part
            released -= part
            if not read.size:
                self._held.popleft()


@dataclass(slots=True)
class _Read:
    """A read of which the splitter still holds the last `size` bytes."""

    size: int
    ts_ns: int
    """The time of the read's last byte, in ns."""
    character_ns: int = field(repr=False)

    @property
    def start_ns(self) -> int:
        """The time (ns) at which the first of the `size` bytes began on the line."""
        return self.ts_ns - self.size * self.character_ns


def _start_ns(event: Adu | Skipped) -> int:
    return event.start_ns if isinstance(event, Adu) else event.ts_ns


def _only_speaker(event: Adu | Skipped) -> Direction | None:
    """Return REQUEST or RESPONSE if the bytes of an event have the length of only this direction.

    None if they fit both directions or neither.
    """
    speakers = (Direction.REQUEST, Direction.RESPONSE)
    if isinstance(event, Adu):
        fitting = [each for each in speakers if pdu_length(event.pdu, each) == len(event.pdu)]
    else:
        fitting = [each for each in speakers if _begins_frame(event.raw, each)]
    return fitting[0] if len(fitting) == 1 else None


def _begins_frame(raw: bytes, speaker: Direction) -> bool:
    size = frame_size(raw, speaker) if len(raw) >= MIN_FRAME else None
    return size is not None and MIN_FRAME <= size <= len(raw) and crc(raw[:size]) == 0
