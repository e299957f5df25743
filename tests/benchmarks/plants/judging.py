"""What a decoder told of a line, counted against the truth."""

# Found is counted over the transactions of the truth: a request with its response, or one that got
# none. Equal requests in a row (retries) that got one response are a group: which of them it
# answers can be told in several ways, and each is right as long as the numbers agree.
#
# Told right: request, response and outcome agree. Sure and wrong: told with a confidence of SURE or
# more, not as ambiguous, and not right. What cannot be known (knowable.py) is also found if it is
# told as ambiguous; what is hidden is not counted.
#
# A frame that lacks bytes is no frame. Its request or response is not counted as found, and may not
# be told with a frame of another transaction. A response whose request was not heard is right if it
# is told alone.
#
# Calibration is counted over frames, whose confidence is that of their direction, and over pairs of
# a request and a response, whose confidence is that of the transaction.

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

from mbtool.core import Direction
from mbtool.modbus import Outcome
from tests.benchmarks.plants.recording import Role

if TYPE_CHECKING:
    from tests.benchmarks.plants.knowable import Unknowable
    from tests.benchmarks.plants.recording import Recording, Sent

SURE = 0.9
LIKELY = 0.8
NO_FRAME = -1


@dataclass(frozen=True, slots=True)
class ToldFrame:
    offset: int
    raw: bytes
    direction: Direction | None
    confidence: float


@dataclass(frozen=True, slots=True)
class ToldTransaction:
    request: tuple[int, bytes] | None
    """Its offset in the bytes of the line and its bytes, None if there is none."""
    response: tuple[int, bytes] | None
    outcome: Outcome | None
    """None if the decoder tells none."""
    confidence: float
    is_ambiguous: bool


@dataclass(slots=True)
class Told:
    """What a decoder made of a line."""

    frames: list[ToldFrame] = field(default_factory=list)
    transactions: list[ToldTransaction] | None = field(default_factory=list)
    """None if the decoder makes none."""
    echoes: list[int] = field(default_factory=list)
    """Offsets of what was recognised as the adapter's echo."""


@dataclass(slots=True, kw_only=True)
class PlantFigures:
    """The counts of one plant and adapter."""

    frames: int = 0
    frames_found: int = 0
    frames_false: int = 0
    frames_told: int = 0
    transactions: int = 0
    """Those of the truth that are counted."""
    hidden: int = 0
    """Those of the truth that are not, since nobody could know them."""
    doubtful: int = 0
    found: int = 0
    all: int = 0
    """All transactions of the truth, hidden ones too."""
    right: int = 0
    """Those of all that were told rightly, whether or not they could be known."""
    told: int = 0
    wrong: int = 0
    """Told, and not in the truth."""
    sure_wrong: int = 0
    sure: int = 0
    """Frames told with SURE or more, and how many of them have the other direction or are none."""
    sure_amiss: int = 0
    likely: int = 0
    likely_amiss: int = 0
    pairs_sure: int = 0
    """Pairs told with SURE or more, and how many of them are none."""
    pairs_sure_amiss: int = 0
    ambiguous_knowable: int = 0
    """Transactions told as ambiguous though the truth can be known."""
    misses: list[str] = field(default_factory=list)

    def add(self, other: PlantFigures) -> None:
        for one in fields(self):
            setattr(self, one.name, getattr(self, one.name) + getattr(other, one.name))

    @property
    def found_share(self) -> float | None:
        return _share(self.found, self.transactions)

    @property
    def right_share(self) -> float | None:
        return _share(self.right, self.all)

    @property
    def frames_found_share(self) -> float | None:
        return _share(self.frames_found, self.frames)

    @property
    def sure_wrong_share(self) -> float | None:
        return _share(self.sure_wrong, self.told)

    @property
    def sure_amiss_share(self) -> float | None:
        return _share(self.sure_amiss, self.sure)

    @property
    def likely_amiss_share(self) -> float | None:
        return _share(self.likely_amiss, self.likely)

    @property
    def pairs_amiss_share(self) -> float | None:
        return _share(self.pairs_sure_amiss, self.pairs_sure)

    @property
    def ambiguous_knowable_share(self) -> float | None:
        return _share(self.ambiguous_knowable, self.told)

    def as_json(self) -> dict[str, Any]:
        counts = asdict(self)
        del counts["misses"]
        derived = (n for n in dir(PlantFigures) if isinstance(getattr(PlantFigures, n), property))
        return counts | {name: getattr(self, name) for name in derived}


def judge(recording: Recording, unclear: Unknowable, told: Told) -> PlantFigures:
    """Count one decoder's word against the truth."""
    figures = PlantFigures()
    _judge_frames(recording, unclear, told, figures)
    if told.transactions is not None:
        _Transactions(recording, unclear, told, figures).judge()
    return figures


def _judge_frames(
    recording: Recording, unclear: Unknowable, told: Told, figures: PlantFigures
) -> None:
    places = {one.offset: at for at, one in enumerate(recording.sent) if one.role is not Role.NOISE}
    figures.frames = len(places)
    figures.frames_told = len(told.frames)
    # Which of the two copies is the request and which the echo may be told either way.
    copied = {one.copies for one in recording.sent}
    for offset in told.echoes:
        at = places.get(offset)
        is_copy = at is not None and (at in copied or recording.sent[at].role is Role.ECHO)
        figures.frames_found += is_copy
        figures.frames_false += not is_copy
    for one in told.frames:
        at = places.get(one.offset)
        truth = None if at is None else recording.sent[at]
        is_frame = truth is not None and truth.raw == one.raw
        figures.frames_found += is_frame
        figures.frames_false += not is_frame
        if at in unclear.hidden or (is_frame and truth is not None and truth.role is Role.ECHO):
            continue
        amiss = not is_frame or truth is None or str(truth.role) != str(one.direction)
        if one.direction is None and is_frame:
            continue
        if one.confidence >= SURE:
            figures.sure += 1
            figures.sure_amiss += amiss
        elif one.confidence >= LIKELY:
            figures.likely += 1
            figures.likely_amiss += amiss


@dataclass(slots=True)
class _Group:
    """Equal requests in a row, and their responses."""

    requests: list[int] = field(default_factory=list)
    responses: list[int] = field(default_factory=list)
    joined: int = 0
    """Responses that were told with a request of the group."""
    alone: int = 0
    """Requests that were told without a response."""

    @property
    def unanswered(self) -> int:
        return max(0, len(self.requests) - len(self.responses))

    @property
    def found(self) -> int:
        return min(self.joined, len(self.responses)) + min(self.alone, self.unanswered)


class _Transactions:
    """Judges the transactions that a decoder told."""

    def __init__(
        self, recording: Recording, unclear: Unknowable, told: Told, figures: PlantFigures
    ) -> None:
        self._sent = recording.sent
        self._unclear = unclear
        self._told = told.transactions or []
        self._figures = figures
        self._groups = _groups(recording)
        self._places = {one.offset: at for at, one in enumerate(recording.sent)}
        self._joined: set[int] = set()
        """Responses that were told with a request."""
        self._covered: Counter[int] = Counter()
        """Frames in transactions that were told right or as ambiguous."""

    def judge(self) -> None:
        for one in self._told:
            self._judge_one(one)
        done: set[int] = set()
        for group in self._groups.values():
            if id(group) not in done:
                done.add(id(group))
                self._count(group)

    def _judge_one(self, told: ToldTransaction) -> None:
        request, response = (
            None if frame is None else self._place(*frame)
            for frame in (told.request, told.response)
        )
        frames = [at for at in (request, response) if at is not None]
        right = self._is_right(told, request, response)
        if frames and all(at in self._unclear.hidden for at in frames):
            return
        self._figures.told += 1
        if not any(at in self._unclear.doubtful | self._unclear.hidden for at in frames):
            self._figures.ambiguous_knowable += told.is_ambiguous
        if (
            told.request is not None
            and told.response is not None
            and told.confidence >= SURE
            and not any(at in self._unclear.hidden for at in frames)
        ):
            self._figures.pairs_sure += 1
            self._figures.pairs_sure_amiss += not right
        if right or told.is_ambiguous:
            # Also where a frame ends may be in doubt, so that only its beginning counts here.
            self._covered.update(
                self._beginning(frame[0])
                for frame in (told.request, told.response)
                if frame is not None
            )
        if not right and not any(at in self._unclear.hidden for at in frames):
            self._note_wrong(told, request, response)

    def _note_wrong(self, told: ToldTransaction, request: int | None, response: int | None) -> None:
        self._figures.wrong += 1
        self._figures.sure_wrong += told.confidence >= SURE and not told.is_ambiguous
        self._figures.misses.append(
            f"{_at(told.request)}, {_at(told.response)}: "
            f"told {told.outcome} with {told.confidence:.2f}"
            f"{' (ambiguous)' if told.is_ambiguous else ''}, is "
            f"{self._truth(request)}, {self._truth(response)}"
        )

    def _place(self, offset: int, raw: bytes) -> int:
        """The place of a frame among all that was sent, NO_FRAME if there is none."""
        at = self._beginning(offset)
        if at == NO_FRAME or self._sent[at].raw != raw or self._sent[at].role is Role.NOISE:
            return NO_FRAME
        return at

    def _beginning(self, offset: int) -> int:
        """The place of what begins there; an echo stands for the request that it copies."""
        at = self._places.get(offset, NO_FRAME)
        copied = None if at == NO_FRAME else self._sent[at].copies
        return at if copied is None else copied

    def _truth(self, at: int | None) -> str:
        if at is None:
            return "-"
        return "no frame" if at < 0 else f"{self._sent[at].role} {self._sent[at].raw.hex(' ')}"

    def _is_right(self, told: ToldTransaction, request: int | None, response: int | None) -> bool:
        if request is None:
            return (
                response is not None
                and response >= 0
                and self._may_be_unasked(response)
                and told.outcome in (Outcome.UNSOLICITED, Outcome.NOT_CAPTURED, None)
            )
        if request < 0 and told.request is not None and response is not None and response >= 0:
            return self._is_damaged_request(told.request[0], response)
        if request < 0 or self._sent[request].role is not Role.REQUEST:
            return False
        group = self._groups[request]
        if response is None:
            return self._is_alone(told, request, group)
        if response < 0 and told.response is not None:
            return self._is_damaged_response(told, group)
        if response < 0 or response not in group.responses or response in self._joined:
            return False
        self._joined.add(response)
        group.joined += 1
        expected = Outcome.EXCEPTION if self._sent[response].is_exception else Outcome.OK
        if self._sent[response].is_odd and told.outcome is Outcome.MALFORMED:
            return True
        may_be_late = self._sent[response].is_late or len(group.requests) > 1
        return told.outcome in (expected, None) or (may_be_late and told.outcome is Outcome.LATE)

    def _is_damaged_request(self, offset: int, response: int) -> bool:
        """True if what was told as the request is what the listener heard of it."""
        at = self._damaged_at(offset)
        return at is not None and self._sent[response].answers == at

    def _is_damaged_response(self, told: ToldTransaction, group: _Group) -> bool:
        """True if what was told as the response is what the listener heard of it."""
        assert told.response is not None
        at = self._damaged_at(told.response[0])
        return (
            at is not None
            and self._sent[at].answers in group.requests
            and told.outcome in (Outcome.MALFORMED, Outcome.NOT_CAPTURED, None)
        )

    def _damaged_at(self, offset: int) -> int | None:
        at = self._places.get(offset)
        return at if at is not None and self._sent[at].is_damaged else None

    def _is_alone(self, told: ToldTransaction, request: int, group: _Group) -> bool:
        if self._sent[request].unit == 0:
            return told.outcome in (Outcome.BROADCAST, None)
        lacks_response = any(self._sent[at].lacks_response for at in group.requests)
        if told.outcome not in (Outcome.NO_ANSWER, None) and not (
            lacks_response and told.outcome in (Outcome.NOT_CAPTURED, Outcome.MALFORMED)
        ):
            return False
        group.alone += 1
        if any(self._sent[at].is_late for at in group.responses):
            return True
        # Of a request and its retry that both got a response, one response may be told as unasked.
        most = len(group.requests) - 1 if len(group.responses) > 1 else group.unanswered
        return group.alone <= most

    def _may_be_unasked(self, response: int) -> bool:
        """True for a late response, and the second response to a request and its retry."""
        one = self._sent[response]
        if one.role is not Role.RESPONSE or response in self._joined:
            return False
        group = self._groups[one.answers if one.answers in self._groups else response]
        if group.requests and not one.is_late and len(group.responses) < 2:
            return False
        self._joined.add(response)
        group.joined += 1
        return True

    def _count(self, group: _Group) -> None:
        figures = self._figures
        frames = [*group.requests, *group.responses]
        total = len(group.responses) + group.unanswered
        figures.all += total
        figures.right += group.found
        if any(at in self._unclear.hidden for at in frames):
            figures.hidden += total
            return
        figures.transactions += total
        is_doubtful = any(at in self._unclear.doubtful for at in frames)
        figures.doubtful += total if is_doubtful else 0
        if is_doubtful and all(self._covered[at] for at in frames):
            figures.found += total
            return
        figures.found += group.found
        if group.found < total:
            first = self._sent[frames[0]]
            figures.misses.append(
                f"{first.offset}: not told: {len(group.requests)} x {first.raw.hex(' ')} with "
                f"{len(group.responses)} responses"
            )


def _at(frame: tuple[int, bytes] | None) -> str:
    return "-" if frame is None else str(frame[0])


def _groups(recording: Recording) -> dict[int, _Group]:
    """For each request the group that it belongs to; for a response whose request was not heard
    a group of its own.
    """
    sent = recording.sent
    answers: dict[int, list[int]] = defaultdict(list)
    frames = recording.frames()
    for at in frames:
        if sent[at].answers is not None:
            answers[sent[at].answers or 0].append(at)
    groups: dict[int, _Group] = {}
    before: Sent | None = None
    group = _Group()
    for at in frames:
        one = sent[at]
        if one.role is Role.REQUEST:
            if before is None or before.role is not Role.REQUEST or before.raw != one.raw:
                group = _Group()
            group.requests.append(at)
            group.responses += answers[at]
            groups[at] = group
        elif one.answers is None or sent[one.answers].is_damaged:
            groups[at] = _Group(responses=[at])
        before = one
    return groups


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
