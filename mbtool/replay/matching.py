"""Finds in a recording what answers a request."""

# Each way to look has its own idea of where in the recording we are:
#
#     KeyMatcher        how many answers each request got: the next one is its own
#     SequenceMatcher   one place for all: only the request that comes next there is answered
#     TimeMatcher       the clock: of the answers to the same request the one asked nearest to it;
#                       else, of those to the same function and address, an exception or silence as
#                       it was, and for a good one the register image
#     ImageMatcher      the register image for all that reaches registers; the rest by key
#
# Where the recorded answers are over (OnEnd), `last` of a request is its last one that was no
# silence, since a capture often ends before an answer.
#
# While the player stands still (`holds`), a request gets the answer that it got last, and nothing
# is used up.

from __future__ import annotations

from bisect import bisect_left
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol

from mbtool.core import Direction
from mbtool.modbus import TABLE_FUNCTIONS, parse_pdu

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.replay.recording import Key, RecordedAnswer, Recording

_EXCEPTION_BIT = 0x80


class MatchStrategy(StrEnum):
    """How the answer to a request is found."""

    AUTO = "auto"
    """By key, then from the register image, then by what the device's profile says."""
    SEQUENCE = "sequence"
    """The recording's exact order."""
    KEY = "key"
    """The next answer to the same unit, function, addresses and values."""
    TIME = "time"
    """The answer that was given nearest to the moment of the recording."""
    IMAGE = "image"
    """The register image at the moment of the recording."""

    @property
    def by_clock(self) -> bool:
        """Whether the clock says where in the recording we are; else the requests do."""
        return self in (MatchStrategy.TIME, MatchStrategy.IMAGE)


class OnEnd(StrEnum):
    """What comes when the recorded answers are over."""

    LAST = "last"
    """The last one, again and again."""
    LOOP = "loop"
    """All of it from the beginning."""
    IMAGE = "image"
    """The registers as they were last."""
    SILENT = "silent"


class NoAnswer(Enum):
    """What there is in place of a recorded answer."""

    MISS = "miss"
    IMAGE = "image"
    SILENCE = "silence"


_AT_END = {OnEnd.IMAGE: NoAnswer.IMAGE, OnEnd.SILENT: NoAnswer.SILENCE}


class Moment(NamedTuple):
    """Where in the recording we are."""

    at_ns: int
    is_over: bool = False
    """The clock has come to the end."""
    holds: bool = False
    """The player stands still."""


class Matcher(Protocol):
    """Finds the answer to each request."""

    def find(self, key: Key, moment: Moment) -> RecordedAnswer | NoAnswer: ...


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
    """Each request has a sequence of its own."""

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._answers = recording.answers
        self._on_end = on_end
        self._given: dict[Key, int] = {}
        """How many answers were given to a request."""

    def find(self, key: Key, moment: Moment) -> RecordedAnswer | NoAnswer:
        answers = self._answers.get(key)
        if answers is None:
            return NoAnswer.MISS
        place = self._given.get(key, 0)
        if moment.holds:
            place = max(place - 1, 0)
        elif place < len(answers) or self._on_end is OnEnd.LOOP:
            self._given[key] = place + 1
        if place < len(answers):
            return answers[place]
        if self._on_end is OnEnd.LOOP:
            return answers[place % len(answers)]
        return _AT_END.get(self._on_end) or _last(answers)


class SequenceMatcher:
    """All requests have one sequence; one that is not the next is a miss."""

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._order = recording.order
        self._answers = recording.answers
        self._on_end = on_end
        self._next = 0
        self._last: dict[Key, RecordedAnswer] = {}

    def find(self, key: Key, moment: Moment) -> RecordedAnswer | NoAnswer:
        if moment.holds:
            return self._last.get(key, NoAnswer.MISS)
        if self._next >= len(self._order) and self._on_end is not OnEnd.LOOP:
            if key not in self._answers:
                return NoAnswer.MISS
            return _AT_END.get(self._on_end) or _last(self._answers[key])
        expected, answer = self._order[self._next % len(self._order)]
        if key != expected:
            return NoAnswer.MISS
        self._next += 1
        self._last[key] = answer
        return answer


class TimeMatcher:
    """The clock says which of the answers to a request it gets."""

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._answers = recording.answers
        self._on_end = on_end
        self._alike: dict[bytes, list[RecordedAnswer]] = {}
        for key, answer in recording.order:
            alike = _likeness(key)
            if alike is not None:
                self._alike.setdefault(alike, []).append(answer)

    def find(self, key: Key, moment: Moment) -> RecordedAnswer | NoAnswer:
        if moment.is_over and self._on_end in _AT_END:
            return _AT_END[self._on_end]
        answers = self._answers.get(key)
        if answers is not None:
            return _nearest(answers, moment.at_ns)
        alike = self._alike.get(_likeness(key) or b"")
        if alike is None:
            return NoAnswer.MISS
        answer = _nearest(alike, moment.at_ns)
        is_good = answer.pdu is not None and not answer.pdu[0] & _EXCEPTION_BIT
        return NoAnswer.IMAGE if is_good else answer


class ImageMatcher:
    """The register image answers."""

    def __init__(self, recording: Recording, on_end: OnEnd) -> None:
        self._others = KeyMatcher(recording, on_end)
        self._on_end = on_end

    def find(self, key: Key, moment: Moment) -> RecordedAnswer | NoAnswer:
        if moment.is_over and self._on_end is OnEnd.SILENT:
            return NoAnswer.SILENCE
        if not key[1] or key[1][0] not in TABLE_FUNCTIONS:
            return self._others.find(key, moment)
        return NoAnswer.IMAGE


def _last(answers: Sequence[RecordedAnswer]) -> RecordedAnswer:
    return next((one for one in reversed(answers) if one.pdu is not None), answers[-1])


def _nearest(answers: Sequence[RecordedAnswer], at_ns: int) -> RecordedAnswer:
    """The one asked nearest to a moment, of two equally near the earlier."""
    place = bisect_left(answers, at_ns, key=lambda one: one.asked_ns)
    return min(answers[max(place - 1, 0) : place + 1], key=lambda one: abs(one.asked_ns - at_ns))


def _likeness(key: Key) -> bytes | None:
    """What requests have in common that reach the same place by the same function."""
    unit, pdu = key
    if not pdu or pdu[0] not in TABLE_FUNCTIONS:
        return None
    request = parse_pdu(pdu, Direction.REQUEST)
    return None if request.problem is not None else bytes([unit]) + pdu[:3]
