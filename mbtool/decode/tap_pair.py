"""A serial line of which one tap hears the master and another the slaves."""

# Each side has a splitter of its own that knows who speaks. Its ADUs wait until the other side is
# known to have nothing that comes before them; then they go to one pairing, in the order in which
# they were spoken. Times alone do not say that order, as each adapter delays what it hears; which
# response belongs to which request does (alignment.py). Where it does not matter, times decide.
#
# What is known of a side reaches up to its last read, to the time until which it was silent, or
# to the first byte that its splitter still holds. Which event is first is decided when both sides
# are known up to LOOK_NS behind it, from what began until then: so the result depends neither on
# how the bytes were cut into reads nor on which side was read first. A read is fed at most
# MAX_CLOCK_STEP_NS after one of the other side with the same time, so silence need not be told: a
# log has none.
#
# A time that lies more than MAX_CLOCK_STEP_NS before what is known says that the clock was set
# back. What was held comes out, and both sides begin anew, as at the start of a capture.
#
# Ports that are exchanged are told: SURE frames that can only be the other side's, and none that
# can only be its own.
#
# Holds, beside what the splitters hold, at most MAX_HELD ADUs and runs of skipped bytes; beyond,
# the first is decided by what is there.

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import islice, takewhile
from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.core.limits import MAX_CLOCK_STEP_NS
from mbtool.core.wording import counted
from mbtool.decode.pairing import Pairing
from mbtool.decode.tap_alignment import MOST, SKEW_NS, TapRequest, asker_of_first, can_answer
from mbtool.decode.transactions import Ends
from mbtool.framing.rtu_lengths import MIN_FRAME, frame_size
from mbtool.modbus.adu import Adu, Skipped
from mbtool.modbus.adu_bytes import crc
from mbtool.modbus.pdu import pdu_length
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.rtu import RtuSplitter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import SerialFormat
    from mbtool.decode.connections import Decoded

LOOK_NS = 2 * SKEW_NS
MAX_HELD = 512
"""What a line at 115200 baud brings in a second of the shortest frames."""
SURE = 4

_SPEAKERS = {Direction.REQUEST: "the master", Direction.RESPONSE: "a slave"}


class TapPair:
    """Bytes of both sides in, what `Bus` gives out."""

    def __init__(self, link: str, line: SerialFormat, *, ascii: bool = False) -> None:  # noqa: A002
        self._link = link
        self._pairing = Pairing(Ends(link), bus=True)
        self._sides = {
            speaker: _TapSide(speaker, line, ascii=ascii)
            for speaker in (Direction.REQUEST, Direction.RESPONSE)
        }
        self._master = self._sides[Direction.REQUEST]
        self._slaves = self._sides[Direction.RESPONSE]
        self._waiting: TapRequest | None = None
        """The last request that was given out, while no response has come."""
        self._has_asked = False
        self._answered_ns: int | None = None
        """When the last response ended, if no request has come since."""
        self._ahead_ns = 0
        """By how much responses seem early, as far as pairs have shown; less than 0: late."""
        self._misplaced = 0
        """How many frames could only be the other side's; less than 0: this is settled."""

    def feed(self, direction: Direction, data: bytes, ts_ns: int) -> list[Decoded]:
        """Take the bytes of one read; `ts_ns` is the time of the last one.

        What is not said to be the slaves' is the master's.
        """
        speaker = Direction.RESPONSE if direction is Direction.RESPONSE else Direction.REQUEST
        decoded = (
            self._begin_anew() if ts_ns < self._sides[speaker].until_ns - MAX_CLOCK_STEP_NS else []
        )
        for side in self._sides.values():
            if side.speaker is speaker:
                side.feed(data, ts_ns)
            else:
                side.advance(ts_ns - MAX_CLOCK_STEP_NS)
        return decoded + self._decide()

    def advance(self, now_ns: int) -> list[Decoded]:
        """Learn that all that either side has said until now was fed."""
        known_ns = min(side.until_ns for side in self._sides.values())
        decoded = self._begin_anew() if now_ns < known_ns - MAX_CLOCK_STEP_NS else []
        for side in self._sides.values():
            side.advance(now_ns)
        decoded += self._decide()
        if not any(side.is_busy for side in self._sides.values()):
            decoded += self._pairing.advance(now_ns)
        return decoded

    def close(self) -> list[Decoded]:
        """The capture ends."""
        return [*self._give_all(), *self._pairing.close()]

    def _begin_anew(self) -> list[Decoded]:
        """The clock was set back: what is held comes out, and no time is known any more."""
        decoded = self._give_all()
        for side in self._sides.values():
            side.until_ns = 0
        self._waiting = self._answered_ns = None
        self._has_asked = False
        self._ahead_ns = 0
        return decoded

    def _give_all(self) -> list[Decoded]:
        for side in self._sides.values():
            side.close()
        decoded: list[Decoded] = []
        while self._held:
            self._give_next(decoded)
        return decoded

    def _decide(self) -> list[Decoded]:
        """Give out what nothing that is still to come can come before."""
        known_ns = min(side.known_ns for side in self._sides.values())
        decoded: list[Decoded] = []
        while self._held and (self._first_ns + LOOK_NS <= known_ns or self._held > MAX_HELD):
            self._give_next(decoded)
        return decoded

    @property
    def _held(self) -> int:
        return sum(len(side.events) for side in self._sides.values())

    @property
    def _first_ns(self) -> int:
        return min(_start_ns(side.events[0]) for side in self._sides.values() if side.events)

    def _give_next(self, decoded: list[Decoded]) -> None:
        side = self._next_side()
        event = side.events.popleft()
        speaker = side.speaker
        self._look_who_speaks(event, speaker, decoded)
        if isinstance(event, Skipped):
            decoded += self._pairing.advance(event.ts_ns)
            decoded.append(self._told(event, speaker))
            return
        decoded.append(event)
        decoded += self._pairing.feed(event)
        if speaker is Direction.REQUEST:
            self._ask(event)
        elif self._waiting is not None and can_answer(self._waiting.adu, event):
            self._ahead_ns = max(self._ahead_ns, self._waiting.adu.end_ns - event.start_ns)
            self._answered_ns = event.end_ns
            self._waiting = None

    def _ask(self, request: Adu) -> None:
        if self._answered_ns is not None:
            self._ahead_ns = min(self._ahead_ns, request.start_ns - self._answered_ns)
            self._answered_ns = None
        self._has_asked = True
        self._waiting = TapRequest.of(request) if request.unit != 0 else None

    def _next_side(self) -> _TapSide:
        """Whose first event was first."""
        if not self._slaves.events:
            return self._master
        if not self._master.events:
            return self._slaves
        until_ns = self._first_ns + LOOK_NS
        responses = list(self._slaves.adus(until_ns))
        if responses:
            requests = [TapRequest.of(adu) for adu in self._master.adus(until_ns)]
            waiting = [self._waiting] if self._waiting is not None else []
            place = asker_of_first(
                [*waiting, *requests],
                responses,
                until_ns,
                ahead_ns=self._ahead_ns,
                at_start=not self._has_asked,
            )
            if place is not None:
                return self._slaves if place < len(waiting) else self._master
        by_time = _start_ns(self._slaves.events[0]) < _start_ns(self._master.events[0])
        return self._slaves if by_time else self._master

    def _look_who_speaks(
        self, event: Adu | Skipped, speaker: Direction, decoded: list[Decoded]
    ) -> None:
        if self._misplaced < 0:
            return
        spoken = _only_speaker(event)
        if spoken is None:
            return
        self._misplaced = -1 if spoken is speaker else self._misplaced + 1
        if self._misplaced == SURE:
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

    def _told(self, skipped: Skipped, speaker: Direction) -> WireEvent:
        return WireEvent(
            ts_ns=skipped.ts_ns,
            link=self._link,
            kind=skipped.kind,
            message=f"{counted(len(skipped.raw), 'byte')} of {_SPEAKERS[speaker]}: "
            f"{skipped.reason}",
            raw=skipped.raw,
        )


class _TapSide:
    """What one tap hears: a splitter, and its events that wait."""

    def __init__(self, speaker: Direction, line: SerialFormat, *, ascii: bool) -> None:  # noqa: A002
        self.speaker = speaker
        self.events: deque[Adu | Skipped] = deque()
        splitter = AsciiSplitter if ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(line, speaker=speaker)
        self._character_ns = line.character_ns
        self.until_ns = 0
        """Until when all that it says was fed."""
        self._held: deque[_Read] = deque()
        """The reads of which the splitter still holds bytes."""

    @property
    def known_ns(self) -> int:
        """No event that is still to come begins before this."""
        return self._held[0].start_ns if self._held else self.until_ns

    @property
    def is_busy(self) -> bool:
        return bool(self._held or self.events)

    def feed(self, data: bytes, ts_ns: int) -> None:
        if data:
            self._held.append(_Read(len(data), ts_ns, self._character_ns))
            self.until_ns = max(self.until_ns, ts_ns)
            self._take(self._splitter.feed(data, ts_ns))

    def advance(self, now_ns: int) -> None:
        self.until_ns = max(self.until_ns, now_ns)
        self._take(self._splitter.advance(now_ns))

    def close(self) -> None:
        self._take(self._splitter.close())

    def adus(self, until_ns: int) -> Iterator[Adu]:
        """The first ADUs that wait, of those that began by a time."""
        began = takewhile(lambda event: _start_ns(event) <= until_ns, self.events)
        return islice((event for event in began if isinstance(event, Adu)), MOST + 1)

    def _take(self, events: list[Adu | Skipped]) -> None:
        self.events += events
        given = sum(len(event.raw) for event in events)
        while given and self._held:
            read = self._held[0]
            part = min(given, read.size)
            read.size -= part
            given -= part
            if not read.size:
                self._held.popleft()


@dataclass(slots=True)
class _Read:
    """A read of which so many last bytes are held."""

    size: int
    ts_ns: int
    character_ns: int = field(repr=False)

    @property
    def start_ns(self) -> int:
        """When the first of them began."""
        return self.ts_ns - self.size * self.character_ns


def _start_ns(event: Adu | Skipped) -> int:
    return event.start_ns if isinstance(event, Adu) else event.ts_ns


def _only_speaker(event: Adu | Skipped) -> Direction | None:
    """Who alone can have said it, where its form tells."""
    speakers = (Direction.REQUEST, Direction.RESPONSE)
    if isinstance(event, Adu):
        fitting = [each for each in speakers if pdu_length(event.pdu, each) == len(event.pdu)]
    else:
        fitting = [each for each in speakers if _begins_frame(event.raw, each)]
    return fitting[0] if len(fitting) == 1 else None


def _begins_frame(raw: bytes, speaker: Direction) -> bool:
    size = frame_size(raw, speaker) if len(raw) >= MIN_FRAME else None
    return size is not None and MIN_FRAME <= size <= len(raw) and crc(raw[:size]) == 0
