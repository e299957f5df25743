"""Finds the recorded answer to a request of the live master, by one of several strategies."""

# The matchers differ in the recorded answer that they choose:
#
#     KeyMatcher        counts for each request separately: each time the same request comes, it
#                       gets its next recorded answer
#     SequenceMatcher   goes through the recording in order: only the request that comes next in the
#                       recording is answered
#     TimeMatcher       takes the answer to the same request that was recorded nearest to the
#                       clock's time. If the recording lacks the request, it takes the nearest
#                       answer to the same unit, function and first address: if this is an exception
#                       or silence, it is played; else the values come from the register image
#     ImageMatcher      answers from the register image; functions that access no registers or bits
#                       are answered as by KeyMatcher
#
# OnEnd says what happens after the last recorded answer. OnEnd.LAST repeats the last response and
# ignores missing responses, as a capture often ends before a response.
#
# While the player is paused (`is_paused`), a request gets the answer that it got last.

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol

from mbtool.core import Direction
from mbtool.modbus import TABLE_FUNCTIONS, parse_pdu
from mbtool.modbus.functions import EXCEPTION_BIT

if TYPE_CHECKING:
    from mbtool.replay.recording import Key, RecordedAnswer, Recording


class MatchStrategy(StrEnum):
    """The strategy by which the player finds the answer to a request of the live master."""

    AUTO = "auto"
    """Answers as KEY does. For a request that the recording lacks, the response comes from the
    register image (the recorded values at the player's time), else from the simulated device."""
    SEQUENCE = "sequence"
    """Only the request that comes next in the recording is answered; any other gets no recorded
    answer."""
    KEY = "key"
    """Each time the same request (unit, function, addresses and values) comes, it gets its next
    recorded answer."""
    TIME = "time"
    """Among all recorded answers to the same request, the one recorded nearest to the clock's time
    is given."""
    IMAGE = "image"
    """A request gets the values that the registers had in the recording at the clock's time."""

    @property
    def by_clock(self) -> bool:
        """True if the clock gives the position in the recording; False if the requests of the live
        master move it.
        """
        return self in (MatchStrategy.TIME, MatchStrategy.IMAGE)


class OnEnd(StrEnum):
    """The answer to a request after all recorded answers to it were played."""

    LAST = "last"
    """A request gets its last recorded answer again."""
    LOOP = "loop"
    """A request gets its first recorded answer again, then the second, and so on."""
    IMAGE = "image"
    """A request gets the values that its registers had at the player's time in the recording."""
    SILENT = "silent"


class NoAnswer(Enum):
    """The value that a matcher returns if it has no recorded answer to a request.

    MISS: the recording has no such request. IMAGE: the player is to answer from the register image
    (the recorded values). SILENCE: the player is to send no response.
    """

    MISS = "miss"
    IMAGE = "image"
    SILENCE = "silence"


_AT_END = {OnEnd.IMAGE: NoAnswer.IMAGE, OnEnd.SILENT: NoAnswer.SILENCE}


class Moment(NamedTuple):
    """The player's time in the recording (UTC ns), and whether the player is paused or at
    the end.
    """

    at_ns: int
    is_over: bool = False
    """True if the clock has reached the end of the recording; False if the matcher does not use the
    clock."""
    is_paused: bool = False


class Found(NamedTuple):
    """A recorded answer that a matcher has chosen to be played."""

    answer: RecordedAnswer
    lap: int = 0
    """The number of times that all recorded answers (with KeyMatcher, all answers to this request)
    were played before this one; always 0 if the matcher uses the clock."""


class Matcher(Protocol):
    """Finds the recorded answer to a request. Each class that does so follows another strategy."""

    def find(self, key: Key, moment: Moment) -> Found | NoAnswer: ...


def matcher_for(match: MatchStrategy, recording: Recording, on_end: OnEnd) -> Matcher:
    match match:
        case MatchStrategy.SEQUENCE:
            return SequenceMatcher(recording, on_end)
        case MatchStrategy.TIME:
            return TimeMatcher(recording, on_end)
        case MatchStrategy.IMAGE:
            return ImageMatcher(recording, on_end)
        case _:
            return KeyMatcher(recording, on_end)


class KeyMatcher:
    """Gives each request its next recorded answer, whatever other requests come between."""

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._answers = recording.answers
        self._on_end = on_end
        self._given: dict[Key, int] = {}
        """For each request (unit and PDU), the number of its recorded answers that were played."""

    def find(self, key: Key, moment: Moment) -> Found | NoAnswer:
        answers = self._answers.get(key)
        if answers is None:
            return NoAnswer.MISS
        index = self._given.get(key, 0)
        if moment.is_paused:
            index = max(index - 1, 0)
        elif index < len(answers) or self._on_end is OnEnd.LOOP:
            self._given[key] = index + 1
        if index < len(answers) or self._on_end is OnEnd.LOOP:
            lap, index = divmod(index, len(answers))
            return Found(answers[index], lap)
        return _AT_END.get(self._on_end) or _last_answer(answers)


class SequenceMatcher:
    """Answers a request only if it comes next in the recording; any other gets NoAnswer.MISS."""

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._order = recording.order
        self._answers = recording.answers
        self._on_end = on_end
        self._next = 0
        self._last: dict[Key, Found] = {}

    def find(self, key: Key, moment: Moment) -> Found | NoAnswer:
        if moment.is_paused:
            return self._last.get(key, NoAnswer.MISS)
        if self._next >= len(self._order) and self._on_end is not OnEnd.LOOP:
            if key not in self._answers:
                return NoAnswer.MISS
            return _AT_END.get(self._on_end) or _last_answer(self._answers[key])
        lap, index = divmod(self._next, len(self._order))
        expected, answer = self._order[index]
        if key != expected:
            return NoAnswer.MISS
        self._next += 1
        self._last[key] = Found(answer, lap)
        return self._last[key]


class TimeMatcher:
    """Gives a request the answer to the same request that was recorded nearest to the clock's time.
    If the recording lacks the request, an answer to the same first address decides.
    """

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._answers = recording.answers
        self._on_end = on_end
        self._by_address: dict[bytes, list[RecordedAnswer]] = {}
        for key, answer in recording.order:
            address_key = _address_key(key)
            if address_key is not None:
                self._by_address.setdefault(address_key, []).append(answer)

    def find(self, key: Key, moment: Moment) -> Found | NoAnswer:
        if moment.is_over and self._on_end in _AT_END:
            return _AT_END[self._on_end]
        answers = self._answers.get(key)
        if answers is not None:
            return Found(_nearest_answer(answers, moment.at_ns))
        similar = self._by_address.get(_address_key(key) or b"")
        if similar is None:
            return NoAnswer.MISS
        answer = _nearest_answer(similar, moment.at_ns)
        is_good = answer.pdu is not None and not answer.pdu[0] & EXCEPTION_BIT
        return NoAnswer.IMAGE if is_good else Found(answer)


class ImageMatcher:
    """Lets the player answer all requests for registers or bits with their recorded values; other
    requests get their next recorded answer.
    """

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._others = KeyMatcher(recording, on_end)
        self._on_end = on_end

    def find(self, key: Key, moment: Moment) -> Found | NoAnswer:
        if moment.is_over and self._on_end is OnEnd.SILENT:
            return NoAnswer.SILENCE
        if not key[1] or key[1][0] not in TABLE_FUNCTIONS:
            return self._others.find(key, moment)
        return NoAnswer.IMAGE


def _last_answer(answers: Sequence[RecordedAnswer]) -> Found:
    return Found(next((one for one in reversed(answers) if one.pdu is not None), answers[-1]))


def _nearest_answer(answers: Sequence[RecordedAnswer], at_ns: int) -> RecordedAnswer:
    """The answer whose request was recorded nearest to `at_ns` (UTC ns); if two are equally near,
    the earlier one.
    """
    index = bisect_left(answers, at_ns, key=lambda one: one.asked_ns)
    return min(answers[max(index - 1, 0) : index + 1], key=lambda one: abs(one.asked_ns - at_ns))


def _address_key(key: Key) -> bytes | None:
    """Unit, function and first address of a request as 4 bytes; None if the request accesses no
    registers or bits, or is malformed.
    """
    unit, pdu = key
    if not pdu or pdu[0] not in TABLE_FUNCTIONS:
        return None
    request = parse_pdu(pdu, Direction.REQUEST)
    return None if request.problem is not None else bytes([unit]) + pdu[:3]
