"""Decodes a serial line with two taps: one hears the master, the other the slaves."""

# A side is one tap with a splitter of its own, which knows the direction of its bytes. The events
# of both sides (ADUs and skipped bytes) are merged into the order in which they were sent, and go
# to one pairing. Times alone do not give that order, as each adapter has its own delay; the
# alignment of requests with responses does (tap_alignment.py). If no alignment decides, times do.
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

from collections import deque
from dataclasses import dataclass, field
from itertools import islice, takewhile
from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.core.limits import MAX_CLOCK_STEP_NS
from mbtool.decode.connections import skipped_event
from mbtool.decode.pairing import Pairing
from mbtool.decode.tap_alignment import (
    MAX_ALIGNED,
    SKEW_NS,
    TapRequest,
    can_answer,
    request_of_first,
)
from mbtool.decode.transactions import Ends
from mbtool.framing.rtu_lengths import MIN_FRAME, frame_size
from mbtool.modbus.adu import Adu, Skipped, crc
from mbtool.modbus.pdu import pdu_length
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import SerialFormat
    from mbtool.decode.connections import Decoded

LOOKAHEAD_NS = 2 * SKEW_NS
MAX_HELD = 512
"""The most events that wait for the pairing. A line at 115200 baud carries so many frames in a
second, if they are the shortest ones."""
MISPLACED_FRAMES = 4

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
        if not any(side.is_busy for side in self._sides.values()):
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
        elif self._pending is not None and can_answer(self._pending.adu, event):
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
    def is_busy(self) -> bool:
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
