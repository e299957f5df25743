"""Finds out whether another master sends requests on a serial line, and when it pauses."""

# All bytes that were heard go through the same splitter (serial_line) as those of a line on which
# mbtool only listens. The splitter finds out which frames are requests. Each different request is a
# poll of the other master.
#
# After a response the other master leaves the line silent until its next request. The shortest of
# the last MAX_PAUSES silences after a poll counts as its certain pause, once LEAST_SEEN were
# measured. If the splitter decides late that a response was whole, less of the pause is left, and
# nothing is sent in it.
#
# A pause also ends when a poll with a steady period is due: a master that polls at fixed times
# pauses less after a slow answer, and a poll with a timer of its own may fall into any pause. If a
# poll is due and was not heard yet, nothing is sent until it comes, or until it counts as stopped
# (_STOPPED).
#
# If a unit did not answer in time, its late answer could be taken for the answer to a request of
# this program. So this program asks the unit again only when the unit has answered two polls of the
# other master in a row.
#
# The time of bytes is uncertain in two cases: the bytes were there before a read began, so they
# came at any time since the read before; or this process had to wait for a processor. Bytes whose
# time is uncertain by more than MOST_DOUBT_NS are not used to measure a pause or a period, because
# pauses would seem far too short.
#
# If other bytes come while a request of this program is pending, the pause was shorter than it
# seemed. This is noted, too.
#
# Memory: at most MAX_POLLS different requests with MAX_PAUSES pauses each, MAX_DOUBTS spans of
# time, and what the splitter holds.

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from mbtool.core import Direction, LinkError, SerialLink
from mbtool.core.moments import counted, duration
from mbtool.devices import write_reference
from mbtool.modbus import FUNCTIONS, Adu, Skipped, function_name
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.serial_line import AsciiSplitter, RtuSplitter

SILENT_LISTEN_NS = 1_000_000_000
"""A line on which nothing is heard for this long (ns) counts as free."""
MOST_LISTEN_NS = 5_000_000_000
"""Listening ends after this time (ns), or sooner once the period and the pause of each poll are
known."""
LEAST_SEEN = 3
"""A request is sent in a pause of the other master only if this pause was heard at least this
often."""
MAX_POLLS = 256
"""At most this many different requests of the other master are kept."""
MAX_PAUSES = 64
"""The number of last pauses and periods that are kept of each request."""
MAX_DOUBTS = 64
"""The number of last spans of doubtful times that are kept."""
MOST_DOUBT_NS = 5_000_000
"""A time is used to measure a pause or a period only if the byte came at most this much later (ns)
than it seems."""
MARGIN_NS = 20_000_000
"""A request is sent in a pause only if at least this much time (ns) is left after its response. USB
adapters deliver bytes up to 16 ms late."""
RELIABLE = 0.9
"""The next pause is expected to be at least this share (0 to 1) of the shortest one heard."""
_PROOFS = 2
"""After a request without an answer, its late answer may come until the unit has answered this many
polls; then it counts as lost."""
_STOPPED = 1.5
"""A poll is no longer waited for if it was not heard for this many times its longest period."""
FEW_BYTES = 8
"""Fewer bytes than this count as noise, not as another master, if they have no frame with a correct
CRC."""
_NAMED = 3
"""An error names at most this many polls of the other master."""


class NoPauseError(LinkError):
    """The other master leaves no pause that is long enough for a request; a shorter one may fit."""


@dataclass(slots=True)
class HeardPoll:
    """A request that another master repeats. All times are in ns."""

    request: Adu
    times: int = 1
    first_ns: int = 0
    last_ns: int = 0
    longest_latency_ns: int = 0
    pauses: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_PAUSES))
    """The last silences heard between the end of its response and the next request."""
    periods: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_PAUSES))
    """The last times between two of these requests."""
    shortest_period_ns: int = 0
    """The shortest of `periods`, in ns; 0 if the request was heard once."""
    usual_period_ns: int = 0
    """The median of `periods`, in ns; 0 if the request was heard once."""
    longest_period_ns: int = 0
    """The longest of `periods`, in ns; 0 if the request was heard once."""
    is_followed: bool = True
    """True if nothing on the line was missed since the last of these requests."""

    def note_request(self, at_ns: int) -> None:
        """Note that the request was heard again, and ended at the time `at_ns`."""
        if self.times and self.is_followed:
            self.periods.append(at_ns - self.last_ns)
            ordered = sorted(self.periods)
            self.shortest_period_ns, self.longest_period_ns = ordered[0], ordered[-1]
            self.usual_period_ns = ordered[len(ordered) // 2]
        self.times += 1
        self.last_ns, self.is_followed = at_ns, True

    @property
    def usable_pause_ns(self) -> int:
        """The silence, in ns, that surely follows the response; 0 if it was heard too rarely."""
        return round(min(self.pauses) * RELIABLE) if len(self.pauses) >= LEAST_SEEN else 0

    @property
    def due_ns(self) -> int | None:
        """The earliest time at which the request should begin again; None if it has no steady
        period.

        Its periods have been shorter than usual by some time, and may be by twice that. A request
        that came late may be followed by one at its proper time.
        """
        early_ns = self.usual_period_ns - self.shortest_period_ns
        if not self.periods or 2 * early_ns >= self.shortest_period_ns:
            return None
        begun_ns = self.last_ns - (self.request.end_ns - self.request.start_ns)
        late_ns = max(self.periods[-1] - self.usual_period_ns, 0)
        return begun_ns + self.shortest_period_ns - early_ns - late_ns

    def note_latency(self, latency_ns: int) -> None:
        self.longest_latency_ns = max(self.longest_latency_ns, latency_ns)

    @property
    def text(self) -> str:
        """The request and its period, as in `unit 2 03 holding 16..19 every 0.50 s`."""
        code, pdu = self.request.pdu[0], self.request.pdu
        table = FUNCTIONS[code].table if code in FUNCTIONS else None
        what = function_name(code).replace("_", " ").lower()
        if table is not None and len(pdu) >= 5:
            first = int.from_bytes(pdu[1:3])
            quantity = 1 if code in (0x05, 0x06) else int.from_bytes(pdu[3:5])
            last = first + max(quantity, 1) - 1
            what = write_reference(None, table, first) + (f"..{last}" if last > first else "")
        every = ""
        if self.times > 1:
            every = f" every {duration((self.last_ns - self.first_ns) // (self.times - 1))}"
        return f"unit {self.request.unit} {code:02X} {what}{every}"


class OtherMaster:
    """The requests of another master on a serial line, and their periods."""

    def __init__(self, link: SerialLink) -> None:
        self._link = link
        self._splitter = (AsciiSplitter if link.ascii else RtuSplitter)(link.format)
        self.polls: dict[bytes, HeardPoll] = {}
        """Each different request that was heard, by the bytes of its ADU."""
        self.unread_bytes = 0
        """The number of bytes heard that belong to no frame."""
        self.listened_ns = 0
        self._last_byte_ns = 0
        self._asked: HeardPoll | None = None
        """The poll whose response is to come."""
        self._answered: tuple[HeardPoll, int] | None = None
        """The poll whose response was the last frame, and the end of that frame in ns."""
        self._used: tuple[HeardPoll, int] | None = None
        """The poll before the pause that this program used last, and its response's end (ns)."""
        self._owed: dict[int, int] = {}
        """By unit that left a request of the other master unanswered: the number of polls that it
        must still answer before the late answer counts as lost."""
        self._anew_ns = 0
        """The time since which nothing on the line was missed."""
        self._doubts: deque[tuple[int, int]] = deque(maxlen=MAX_DOUBTS)
        """The spans of time of bytes whose times are doubtful, in ns."""

    def feed(self, data: bytes, at_ns: int, doubt_ns: int = 0) -> None:
        """Take bytes that were heard, the last of them at the time `at_ns` or at most `doubt_ns` ns
        later; or no bytes, if the line was silent up to that time.
        """
        if data and doubt_ns > MOST_DOUBT_NS:
            begin_ns = at_ns - len(data) * self._link.format.character_ns
            self._doubts.append((begin_ns, at_ns))
        self._last_byte_ns = at_ns if data else self._last_byte_ns
        self._take(self._splitter.feed(data, at_ns) if data else self._splitter.advance(at_ns))

    def end(self, listened_ns: int) -> None:
        """End the listening before the first request, which took `listened_ns` ns."""
        self.listened_ns = listened_ns
        self._take(self._splitter.close())

    @property
    def has_heard(self) -> bool:
        """True if any byte was heard."""
        return self._last_byte_ns > 0

    def _take(self, events: Iterable[Adu | Skipped]) -> None:
        for event in events:
            if isinstance(event, Adu):
                self._take_frame(event)
            else:
                self.unread_bytes += len(event.raw)

    def _take_frame(self, adu: Adu) -> None:
        begins, ends = self._is_sure(adu.start_ns), self._is_sure(adu.end_ns)
        if self._answered is not None:
            poll, end_ns = self._answered
            if begins and self._is_sure(end_ns):
                poll.pauses.append(adu.start_ns - end_ns)
            self._answered = None
        if adu.direction is Direction.RESPONSE:
            if self._asked is not None and self._asked.request.unit == adu.unit:
                self._note_owed(self._asked, adu)
                if begins and self._asked.is_followed:
                    self._asked.note_latency(adu.start_ns - self._asked.last_ns)
                self._answered = self._asked, adu.end_ns
            self._asked = None
            return
        if self._asked is not None:
            self._owed[self._asked.request.unit] = _PROOFS
        known = self.polls.get(adu.raw)
        if known is None:
            known = HeardPoll(adu, 0, adu.end_ns)
            if len(self.polls) < MAX_POLLS:
                self.polls[adu.raw] = known
        known.is_followed = known.is_followed and ends
        known.note_request(adu.end_ns)
        known.is_followed = ends
        self._asked = known

    def _note_owed(self, asked: HeardPoll, response: Adu) -> None:
        """Note if a unit may still send an answer to a request that it did not answer in time."""
        expected = ExpectedResponse.of(asked.request.pdu)
        if expected is not None and not expected.fits(response.pdu):
            self._owed[response.unit] = _PROOFS
        elif response.unit in self._owed:
            self._owed[response.unit] -= 1
            if not self._owed[response.unit]:
                del self._owed[response.unit]

    def _is_sure(self, at_ns: int) -> bool:
        """True if the bytes around this time came when they seem to have come."""
        return not any(begin_ns <= at_ns <= end_ns for begin_ns, end_ns in self._doubts)

    @property
    def is_known(self) -> bool:
        """True if each poll was heard often enough to tell its period and its pause."""
        return bool(self.polls) and all(one.times > LEAST_SEEN for one in self.polls.values())

    @property
    def has_known_pauses(self) -> bool:
        """True if the pause behind each poll was heard often enough to be relied on."""
        return all(len(one.pauses) >= LEAST_SEEN for one in self.polls.values())

    def silence_left_ns(self, now_ns: int, unit: int | None = None) -> int:
        """Return how long, in ns, the other master will surely leave the line silent; 0 if nothing
        tells, or if a late answer of `unit` to the other master may come.
        """
        if unit in self._owed or self._answered is None or self._last_byte_ns > self._answered[1]:
            return 0
        poll, end_ns = self._answered
        until_ns = end_ns + poll.usable_pause_ns
        for one in self.polls.values():
            due_ns = one.due_ns
            if due_ns is None:
                continue
            if due_ns > now_ns:
                until_ns = min(until_ns, due_ns)
            elif now_ns < max(one.last_ns, self._anew_ns) + _STOPPED * one.longest_period_ns:
                return 0
        return max(0, until_ns - now_ns)

    @property
    def longest_pause_ns(self) -> int:
        """The longest certain pause of a poll (`usable_pause_ns`), in ns; 0 if there is none."""
        return max((one.usable_pause_ns for one in self.polls.values()), default=0)

    @property
    def greatest_pause_ns(self) -> int:
        """The longest pause, in ns, among the last pauses of all polls; 0 if there is none."""
        return max((max(one.pauses, default=0) for one in self.polls.values()), default=0)

    def latency_ns(self, unit: int) -> int | None:
        """Return the longest latency heard of a unit, in ns; None if no response was heard."""
        heard = [one.longest_latency_ns for one in self.polls.values() if one.request.unit == unit]
        return max(heard, default=0) or None

    def listen_anew(self, now_ns: int) -> None:
        """Forget what was heard last, as bytes were missed before `now_ns`; keep the polls."""
        self._splitter.close()
        self._answered = self._asked = None
        self._anew_ns = now_ns
        for one in self.polls.values():
            one.is_followed = False

    def note_our_request(self) -> None:
        """Note that a request of this program fills the pause, so that no other is sent."""
        self._used = self._answered
        self._answered = self._asked = None

    def note_intrusion(self, at_ns: int, doubt_ns: int = 0) -> None:
        """Note that somebody else began to speak at `at_ns`, or at most `doubt_ns` ns later, while
        a request of this program was pending: the pause was shorter than it seemed.
        """
        if self._used is not None:
            poll, end_ns = self._used
            if doubt_ns <= MOST_DOUBT_NS:
                poll.pauses.append(max(at_ns - end_ns, 0))
            self._used = None
        self.listen_anew(at_ns)

    def demand_free(self) -> None:
        """Raise LinkError if another program sends on the line; the text names its requests."""
        listened = duration(self.listened_ns)
        if self.polls:
            often = sorted(self.polls.values(), key=lambda one: -one.times)
            named = ", ".join(one.text for one in often[:_NAMED])
            more = f" and {len(often) - _NAMED} more" if len(often) > _NAMED else ""
            raise LinkError(
                f"{self._link}: another master asks on this line: {named}{more} (heard in "
                f"{listened}). Nothing was sent; --between asks in its pauses, --listen 0s at once"
            )
        if self.unread_bytes >= FEW_BYTES:
            raise LinkError(
                f"{self._link}: {counted(self.unread_bytes, 'byte', ',')} were heard in "
                f"{listened}, and no frame: somebody speaks with other settings, which mbtool "
                f"sniff {self._link.scheme}:{self._link.port}@auto finds. Nothing was sent; "
                "--listen 0s asks at once"
            )
