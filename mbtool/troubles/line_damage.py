"""Finds LINE-NOISE, LINE-LOST-BYTES, LINE-SAME-UNIT and LINE-TWO-MASTERS: damage of frames.

A damaged frame is an event: a wrong CRC, or bytes that are no frame.
"""

# Each damaged frame is assigned first:
#
# - to a request, if it has most bytes of a known request, or if a response without a request
#   follows it directly;
# - to the answer of the last request, if this request got no answer;
# - otherwise to nobody.
#
# The request shows how many bytes the answer should have, and with which bytes it begins.
#
# LINE-TWO-MASTERS  Two requests at once: the damaged bytes begin like one known request and end
#                   like another, and are longer than one request; or the bytes of two known frames
#                   are mixed, as where programs share a port. Or a master sends a request while
#                   another one still waits: sooner than the unit usually answers, sooner than the
#                   usual time-out, and with nothing on the line in between. Or the decoder reports
#                   it (EventKind.TWO_MASTERS). Two exact poll periods alone prove nothing, as one
#                   master can poll two lists. Where two masters are proved, the periods show which
#                   master asks for what.
# LINE-SAME-UNIT    Two slaves answer one request. Nearly all damage of the line is in the answers
#                   of one unit, or directly after them, and at most of its answers, while other
#                   units answer well. And there are more bytes than asked for, which neither noise
#                   nor lost bytes cause. Or nearly all answers of the unit are damaged, from their
#                   first bytes on or with many different lengths, though the unit understands each
#                   request, so the cable is good. Or a second, whole response of the same form with
#                   other bytes follows the first one, and nothing in between can be a damaged
#                   request to the unit.
# LINE-LOST-BYTES   Most damaged frames of a known length are too short.
# LINE-NOISE        All other damage. The trouble says where it is: in the answers of one unit, in
#                   those of all units, in the requests, or in both.
#
# False alarms: single damaged frames happen on healthy lines, so MIN_CASES of them are needed; less
# than the share MIN_DAMAGED_SHARE of the transactions is a note. An adapter that cuts frames loses
# no bytes. Single constant bytes are another trouble (line_strays.py).
#
# Memory: HELD events, KNOWN requests, numbers for each of 256 units, and MAX_EVIDENCE cases of each
# kind, for each of at most MAX_LINKS links.

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import counted, duration, percent
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus import Outcome
from mbtool.modbus.adu import crc
from mbtool.troubles.line_late import SHORTEST_TIMEOUT_NS
from mbtool.troubles.sense import DAMAGE, MAX_LINKS, SortedSense, is_text
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from mbtool.ledger.poll_statistics import PollStatistics
    from mbtool.ledger.statistics_report import LinkReport, PollReport

MIN_CASES = 3
"""The least number of cases from which a trouble is reported."""
MIN_MERGED = 2
"""The least number of damaged frames with the bytes of two requests that proves two masters."""
MIN_MERGED_SHARE = 0.1
"""If a unit seems to have two slaves, damaged frames with the bytes of two requests prove two
masters only if they are at least this share (0 to 1) of all damaged frames."""
MIN_DAMAGED_SHARE = 0.01
"""LINE-NOISE and LINE-LOST-BYTES are notes if damaged frames are fewer than this share (0 to 1) of
the transactions."""
MIN_PLACE_SHARE = 0.8
"""If at least this share (0 to 1) of a line's damaged frames is in one kind of place (the answers
of one unit, all answers, or the requests), the trouble names that place."""
MIN_UNIT_SHARE = 0.8
"""A unit has two slaves only if at least this share (0 to 1) of the line's damaged frames is in or
directly after its answers."""
MIN_DAMAGED_ANSWERS = 0.8
"""If damaged answers of a unit have no extra bytes, they show two slaves only if they follow at
least this share (0 to 1) of the requests to it."""
MIN_ASKED_BEFORE = 0.8
"""The trouble names the unit that is asked right before the one with two slaves if that is the same
unit in at least this share (0 to 1) of the cases."""
MIN_SHORTER_SHARE = 0.6
"""LINE-LOST-BYTES is reported, not LINE-NOISE, if at least this share (0 to 1) of the damaged
frames of a known length are shorter than they should be."""
KEPT_WAITS = 1000
"""The last times (ns) that are kept of a line's requests without an answer in time."""
MAX_INTERRUPTED_WAIT = 0.85
"""If a request comes sooner after an unanswered one than this share (0 to 1) of the median time
that this line's masters wait for missing answers, no time-out has passed: another master sent
it."""
MIN_DAMAGED_REQUESTS = 0.5
"""A unit has two slaves only if at least this share (0 to 1) of its requests had damage or a second
answer behind them."""
MAX_AFTER_LATE = 0.5
"""A unit has two slaves only if less than this share (0 to 1) of the damage after its requests
follows a request to another unit without an answer in time, whose late answer may be the cause."""
MIN_WRONG_ANSWERS = 0.5
"""If damaged answers of a unit have no extra bytes, they show two slaves only if at least this
share (0 to 1) of them has another length than asked for, or begins with wrong bytes."""
MIN_EXTRA_SHARE = 0.25
"""A unit has two slaves if at least this share (0 to 1) of the damage after its requests has more
bytes than asked for."""
MIN_LENGTHS = 4
"""If damaged answers of a unit have no extra bytes, their lengths show two slaves only if there are
at least this many different ones."""
MIN_EQUAL_BYTES = 0.6
"""Damaged bytes are taken for a known request of the same size if at least this share (0 to 1) of
its bytes are equal."""
MIN_EQUAL_PERIODS = 0.6
"""A poll has a usual period if at least this share (0 to 1) of its periods is about equal to the
median one (PERIOD_TOLERANCE)."""
LEAST_BYTES = 4
"""Damage of fewer bytes than this is not compared with known frames."""
SECOND_NS = 200_000_000
"""A response without a request counts as a second response to the last request only if it comes at
most this long (ns) after the first one."""
PERIOD_TOLERANCE = 0.1
"""Two periods of polls (ns) count as equal if they differ by at most this share (0 to 1)."""
MIN_PERIODS = 5
"""Polls with fewer measured periods than this do not show which master sent them."""
MOST_NAMED = 4
"""A text names at most this many units of each master."""
HELD = 32
"""At most this many damaged frames of a line wait to be assigned to a request or an answer; beyond
it, the oldest is forgotten."""
KNOWN = 64
"""At most this many different requests of a line are remembered; beyond it, the one sent least
recently is forgotten."""
POLLED = 2
"""A request counts as one of a master only if the same bytes came at least this many times: bytes
that came once may be an answer that was taken for a request."""
_HEAD, _TAIL = 4, 4
"""Damage may be two requests at once if its first and last bytes, this many of each, are those of
two known requests."""
_SHORTEST_REQUEST = 8
"""The size in bytes of a request with one of the functions 1 to 6 over RTU."""
_READS = frozenset((1, 2, 3, 4))
_NOT_IN_TIME = frozenset((Outcome.NO_ANSWER, Outcome.LATE))
_AROUND_VALUES = 5
"""The number of bytes around the values in the answer to a read: unit, function, byte count and CRC
(2)."""


@dataclass(slots=True)
class _DamagedUnit:
    damaged: int = 0
    """The number of damaged answers."""
    shorter: int = 0
    """The number of damaged answers with fewer bytes than asked for."""
    longer: int = 0
    lengths: set[int] = field(default_factory=set)
    """Different sizes of damaged answers, as bytes more than asked for; at most MIN_LENGTHS of
    them."""
    garbled: int = 0
    """The number of damaged answers whose first bytes are wrong, too."""
    seconds: int = 0
    """The number of second responses to one request."""
    after: int = 0
    """The number of damaged frames right after an answer of the unit."""
    before: Counter[int] = field(default_factory=Counter)
    """By unit, the number of its requests that came right before a request whose answer is damaged
    or has damaged bytes behind it."""
    after_late: int = 0
    """The number of damaged frames after a request to another unit that was not answered in time:
    its late answer may have caused the damage."""
    asked: int = 0
    answered: int = 0
    latency_ns: int = 0
    """The sum of the latencies (ns) of the unit's answers."""
    last: NamedTransaction | None = None
    """The last transaction with an answer in time."""
    cases: list[Evidence] = field(default_factory=list)


@dataclass(slots=True)
class _DamagedLine:
    held: deque[WireEvent] = field(default_factory=lambda: deque(maxlen=HELD))
    """Events about damaged bytes that are not assigned yet."""
    odd: int = 0
    """The number of pieces too short for `held` since the last transaction."""
    requests: OrderedDict[bytes, int] = field(default_factory=OrderedDict)
    """The last different requests, and how often each came."""
    units: dict[int, _DamagedUnit] = field(default_factory=dict)
    last: NamedTransaction | None = None
    before: NamedTransaction | None = None
    """The last transaction with another unit than the last one."""
    in_requests: int = 0
    short_requests: int = 0
    elsewhere: int = 0
    merged: int = 0
    """The number of times that two requests were on the line at once."""
    interrupted: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT_WAITS))
    """The waits (ns) of requests that another request interrupted before the usual answer."""
    responses: deque[int] = field(default_factory=lambda: deque(maxlen=HELD))
    """The times (ns) of the last responses."""
    late: int = 0
    """The number of late answers, which make a master go on sooner, too."""
    waits: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT_WAITS))
    """The times (ns) from a request without an answer in time to the next request."""
    is_told: bool = False
    """True if the decoder reported two masters."""
    transactions: int = 0
    cases: list[Evidence] = field(default_factory=list)
    masters_cases: list[Evidence] = field(default_factory=list)

    @property
    def interruptions(self) -> int:
        """The number of requests that another request interrupted within the share
        MAX_INTERRUPTED_WAIT of the master's usual time-out.
        """
        if not self.waits:
            return len(self.interrupted)
        soon_ns = MAX_INTERRUPTED_WAIT * median(self.waits)
        return sum(waited_ns < soon_ns for waited_ns in self.interrupted)

    def unit(self, number: int) -> _DamagedUnit:
        return self.units.setdefault(number, _DamagedUnit())

    @property
    def damaged(self) -> int:
        return self.in_requests + self.elsewhere + sum(one.damaged for one in self.units.values())


class LineDamage(SortedSense):
    """Finds LINE-NOISE, LINE-LOST-BYTES, LINE-SAME-UNIT and LINE-TWO-MASTERS."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: dict[str, _DamagedLine] = {}

    def begin_capture(self) -> None:
        super().begin_capture()
        for line in self._lines.values():
            line.held.clear()
            line.last = line.before = None
            for unit in line.units.values():
                unit.last = None

    def take_event(self, event: WireEvent) -> None:
        if event.kind is EventKind.TWO_MASTERS and (line := self._line(event.link)) is not None:
            line.is_told = True
            keep(line.masters_cases, Evidence.of_event(event))
        elif event.kind in DAMAGE and (line := self._line(event.link)) is not None:
            if len(event.raw) < LEAST_BYTES:
                line.odd += 1
            elif not is_text(event.raw):
                self._note_merged(line, event)
                line.held.append(event)

    def take_transaction(self, one: NamedTransaction) -> None:
        if (line := self._line(one.link)) is None:
            return
        line.transactions += 1
        unit = line.unit(one.unit)
        if one.request_ns is not None:
            self._note_interrupted(line, one)
            self._note_request(line, one)
            unit.asked += 1
        if one.response_ns is not None:
            line.responses.append(one.response_ns)
        if one.outcome is Outcome.UNSOLICITED:
            self._note_alone(line, unit, one)
        elif one.latency_ns is not None and one.outcome is not Outcome.LATE:
            unit.answered += 1
            unit.last = one
            unit.latency_ns += one.latency_ns
        self._assign_damage(line)
        if line.last is not None and line.last.unit != one.unit:
            line.before = line.last
        line.last, line.odd = one, 0

    def _line(self, link: str) -> _DamagedLine | None:
        line = self._lines.get(link)
        if line is None and len(self._lines) < MAX_LINKS:
            line = self._lines[link] = _DamagedLine()
        return line

    def _note_request(self, line: _DamagedLine, one: NamedTransaction) -> None:
        raw = one.request_raw or b""
        line.requests[raw] = line.requests.get(raw, 0) + 1
        line.requests.move_to_end(raw)
        if len(line.requests) > KNOWN:
            line.requests.popitem(last=False)

    def _note_merged(self, line: _DamagedLine, event: WireEvent) -> None:
        """Note if an event has the bytes of two requests that were sent at once."""
        raw = event.raw
        if len(raw) >= 2 * _SHORTEST_REQUEST and _are_woven(raw, line.requests):
            line.merged += 1
            keep(line.masters_cases, Evidence.of_event(event, "two frames at once"))
        if not _SHORTEST_REQUEST < len(raw) < 2 * _SHORTEST_REQUEST:
            return
        first = [one for one in line.requests if one[:_HEAD] == raw[:_HEAD]]
        last = [one for one in line.requests if one[-_TAIL:] == raw[-_TAIL:]]
        if any(one != other for one in first for other in last):
            line.merged += 1
            keep(line.masters_cases, Evidence.of_event(event, "two requests at once"))

    def _note_interrupted(self, line: _DamagedLine, one: NamedTransaction) -> None:
        """Note if `one` was sent while the request before it surely waited for its answer."""
        last = line.last
        if last is None or last.request_ns is None or one.request_ns is None:
            return
        waited_ns = one.request_ns - last.request_ns
        is_late, is_given_up = last.outcome is Outcome.LATE, waited_ns >= SHORTEST_TIMEOUT_NS
        if last.outcome in _NOT_IN_TIME:
            line.waits.append(waited_ns)
            line.late += is_late and is_given_up
        else:
            return
        if last.unit == one.unit or (is_late and is_given_up):
            return
        if any(last.request_ns < at_ns < one.request_ns for at_ns in line.responses):
            return  # The master took a late answer for this one.
        if line.requests.get(last.request_raw or b"", 0) < POLLED:
            return  # Perhaps an answer that was taken for a request.
        unit = line.unit(last.unit)
        usual_ns = unit.latency_ns // (unit.answered or 1)
        if 0 < waited_ns < usual_ns and not line.held:
            line.interrupted.append(waited_ns)
            keep(line.masters_cases, Evidence.of(one, "sent while another request waited"))

    def _assign_damage(self, line: _DamagedLine) -> None:
        """Assign the damaged frames since the last transaction: to its answer if it has none."""
        held, last = [*line.held], line.last
        line.held.clear()
        if not held or last is None:
            return
        answer = []
        for event in held:
            request = _request_of(event.raw, line.requests)
            if request is None:
                answer.append(event)
            else:
                line.in_requests += 1
                line.short_requests += len(event.raw) < len(request)
                keep(line.cases, Evidence.of_event(event))
        unit = line.unit(last.unit)
        before = line.before
        if before is not None and before.outcome in _NOT_IN_TIME:
            unit.after_late += bool(answer)
        elif before is not None and answer and last.start_ns - before.start_ns <= SECOND_NS:
            unit.before[before.unit] += 1
        if last.outcome is not Outcome.NO_ANSWER:
            line.elsewhere += len(answer)
            unit.after += len(answer) if last.outcome is Outcome.OK else 0
            for event in answer:
                keep(line.cases, Evidence.of_event(event))
        elif answer:
            _note_answer(unit, last, answer)

    def _note_alone(self, line: _DamagedLine, unit: _DamagedUnit, one: NamedTransaction) -> None:
        """Take the damaged frame right before a response without a request as its request, if that
        frame is not the answer of the request before.
        """
        last = line.last
        own = [request for request in line.requests if request[0] == one.unit]
        may_be_asked = line.odd or any(_request_of(event.raw, own) for event in line.held)
        if not may_be_asked and _is_second(unit.last, one):
            unit.seconds += 1
            keep(unit.cases, Evidence.of(one, "a second answer to the same request"))
        elif line.held:
            request = line.held.pop()
            line.in_requests += 1
            line.short_requests += len(request.raw) < _SHORTEST_REQUEST
            if last is not None and last.outcome is Outcome.OK:
                line.unit(last.unit).after += len(request.raw) > _SHORTEST_REQUEST
            keep(line.cases, Evidence.of_event(request))
        elif line.odd:
            line.in_requests += 1
            line.short_requests += 1
            keep(line.cases, Evidence.of(one, "the answer to a damaged request"))

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        self.flush()
        for link in links:
            line = self._lines.get(link.name)
            if line is not None and link.is_whole:
                yield from _line_troubles(link.name, line, link.polls)


def _line_troubles(link: str, line: _DamagedLine, polls: Sequence[PollReport]) -> Iterator[Trouble]:
    doubles = [number for number, unit in line.units.items() if unit.seconds >= MIN_CASES]
    if not doubles:
        doubles = [number for number, unit in line.units.items() if _has_two_slaves(line, unit)]
    collisions = line.merged + line.interruptions
    merged = line.merged >= (MIN_MERGED_SHARE * line.damaged if doubles else MIN_MERGED)
    is_told = line.is_told and not doubles
    is_proved = is_told or (line.merged >= MIN_MERGED and merged)
    if is_proved or (collisions >= max(MIN_CASES, line.late) and not doubles):
        yield Trouble(
            code="LINE-TWO-MASTERS", link=link, count=max(collisions, 1), of=line.transactions,
            figures={"polls": _polls_of_two([one.poll for one in polls])},
            sureness=Sureness.CERTAIN if is_proved else Sureness.LIKELY,
            evidence=tuple(line.masters_cases),
        )  # fmt: skip
        return
    for number in doubles:
        unit = line.units[number]
        count = max(unit.seconds, unit.damaged, unit.after)
        yield Trouble(
            code="LINE-SAME-UNIT", link=link, unit=number, count=count,
            of=max(unit.asked, count), weight=count,
            victims=tuple(
                each for each, other in line.units.items() if other.answered or each == number
            ),
            figures={"how": _second_slave_text(unit), "other": _colliding_unit_text(unit, count)},
            sureness=Sureness.CERTAIN if unit.seconds >= MIN_CASES else Sureness.LIKELY,
            evidence=tuple(unit.cases or line.cases),
        )  # fmt: skip
    number = line.damaged
    if doubles or number < MIN_CASES:
        return
    units = line.units.values()
    short = line.short_requests + sum(unit.shorter for unit in units)
    known = line.in_requests + sum(unit.damaged for unit in units)
    is_short = known >= MIN_CASES and short >= MIN_SHORTER_SHARE * known
    where, worst = _place_of_damage(line)
    cases = [*line.cases, *(case for unit in units for case in unit.cases)]
    yield Trouble(
        code="LINE-LOST-BYTES" if is_short else "LINE-NOISE",
        link=link,
        unit=worst,
        count=number,
        of=max(line.transactions, number),
        weight=number,
        is_small=number < MIN_DAMAGED_SHARE * line.transactions,
        figures={"where": where, "percent": percent(min(number / line.transactions, 1))}
        if line.transactions
        else {"where": where, "percent": "all"},
        evidence=tuple(sorted(cases, key=lambda case: case.ts_ns)[:MAX_EVIDENCE]),
    )


def _polls_of_two(polls: Sequence[PollStatistics]) -> str:
    """Say which of two masters asks what, by the periods of their polls; empty if the polls have
    not exactly two periods. A period that is a multiple of the other one may be the same master's.
    """
    groups: list[tuple[int, list[PollStatistics]]] = []
    for poll in sorted(polls, key=lambda one: one.period.percentile(50)):
        period, usual_ns = poll.period, poll.period.percentile(50)
        near = period.count_at_least(round((1 - PERIOD_TOLERANCE) * usual_ns))
        near -= period.count_at_least(round((1 + PERIOD_TOLERANCE) * usual_ns))
        if period.count < MIN_PERIODS or near < MIN_EQUAL_PERIODS * period.count:
            continue
        if groups and usual_ns <= (1 + PERIOD_TOLERANCE) * groups[-1][0]:
            groups[-1][1].append(poll)
        else:
            groups.append((usual_ns, [poll]))
    if len(groups) != 2:
        return ""
    (first_ns, first), (second_ns, second) = groups
    times = second_ns / first_ns
    if abs(times - round(times)) <= PERIOD_TOLERANCE * times:
        return ""
    both = {one.key.unit for one in first} & {one.key.unit for one in second}
    return (
        f"; one asks {_asked_text(first, both)} every {_period_text(first_ns)}, "
        f"the other {_asked_text(second, both)} every {_period_text(second_ns)}"
    )


def _period_text(ns: int) -> str:
    """Write a period with two digits, as an adapter makes times coarse."""
    return duration(round(ns, 2 - len(str(ns))))


def _asked_text(polls: Sequence[PollStatistics], both: Collection[int]) -> str:
    """Name the units that one of two masters asks, with the registers of those that both ask."""
    in_order = sorted(polls, key=lambda one: (one.key.unit, one.number))
    names = [
        f"unit {one.key.unit} ({one.reference})" if one.key.unit in both else f"unit {one.key.unit}"
        for one in in_order
    ]
    different = [*dict.fromkeys(names)]
    more = len(different) - MOST_NAMED
    some = different[:MOST_NAMED] + ([f"{more} more"] if more > 0 else [])
    return " and ".join([", ".join(some[:-1]), some[-1]] if len(some) > 1 else some)


def _second_slave_text(unit: _DamagedUnit) -> str:
    """Say what shows that two slaves answer."""
    told = []
    if unit.seconds:
        told.append(f"{counted(unit.seconds, 'second answer', ',')} with other values")
    if unit.longer:
        told.append(f"{unit.longer:,} with more bytes than asked for")
    if unit.after:
        told.append(f"{unit.after:,} with damaged bytes right behind")
    return ", ".join(told) or f"{unit.damaged:,} damaged, those of other units are not"


def _colliding_unit_text(unit: _DamagedUnit, count: int) -> str:
    """Name the unit that is asked right before in most cases, whose second answer may be what
    collides.
    """
    before, number = unit.before.most_common(1)[0] if unit.before else (0, 0)
    is_likely = unit.seconds < MIN_CASES and number >= MIN_ASKED_BEFORE * count
    return f", or as unit {before}, which is asked right before it" if is_likely else ""


def _has_two_slaves(line: _DamagedLine, unit: _DamagedUnit) -> bool:
    """True if two slaves answer to a unit, though no whole second answer was heard."""
    others = [one for one in line.units.values() if one is not unit and one.answered]
    collided = unit.damaged + unit.after + unit.seconds
    if not others or collided < max(
        MIN_CASES, MIN_DAMAGED_REQUESTS * unit.asked, MIN_UNIT_SHARE * line.damaged
    ):
        return False
    if unit.after_late >= MAX_AFTER_LATE * collided:
        return False
    if unit.longer + unit.after + unit.seconds >= MIN_EXTRA_SHARE * collided:
        return True
    if unit.damaged < MIN_DAMAGED_ANSWERS * unit.asked:
        return False
    is_other = unit.shorter + unit.longer >= MIN_WRONG_ANSWERS * unit.damaged
    is_garbled = unit.garbled >= MIN_WRONG_ANSWERS * unit.damaged
    return is_garbled or (is_other and len(unit.lengths) >= MIN_LENGTHS)


def _place_of_damage(line: _DamagedLine) -> tuple[str, int | None]:
    """Return where most of the damage sits, and the unit if it is that of one."""
    by_unit = Counter({number: unit.damaged for number, unit in line.units.items()})
    answers, number = by_unit.total(), line.damaged
    if answers:
        unit, most = by_unit.most_common(1)[0]
        if most >= MIN_PLACE_SHARE * number and len(line.units) > 1:
            return f"in the answers of unit {unit}", unit
    if line.in_requests >= MIN_PLACE_SHARE * number:
        return "in the master's requests", None
    if answers >= MIN_PLACE_SHARE * number:
        return "in the answers of all units", None
    return "in requests and answers", None


def _is_second(first: NamedTransaction | None, one: NamedTransaction) -> bool:
    """True if `one` is another answer to the request of `first`: of the same form, soon after it,
    with other bytes.
    """
    if first is None or first.response_ns is None or one.response_ns is None:
        return False
    raw, other = first.response_raw or b"", one.response_raw or b""
    is_of_form = first.outcome is Outcome.OK and raw[:2] == other[:2] and len(raw) == len(other)
    return is_of_form and raw != other and one.response_ns - first.response_ns <= SECOND_NS


def _note_answer(
    unit: _DamagedUnit, request: NamedTransaction, answer: Sequence[WireEvent]
) -> None:
    """Note the pieces of the damaged answer to a request."""
    unit.damaged += 1
    keep(unit.cases, Evidence.of(request, answer[0].message))
    expected, came = _expected_answer_size(request), sum(len(event.raw) for event in answer)
    if expected is None:
        return
    unit.shorter += came < expected
    unit.longer += came > expected
    if len(unit.lengths) < MIN_LENGTHS:
        unit.lengths.add(came - expected)
    unit.garbled += not _has_ends(answer[0].raw, _expected_head(request, expected))


def _expected_head(request: NamedTransaction, expected: int) -> bytes:
    """Return the first bytes of the answer to a request; `expected` is the size of that answer."""
    head = bytes([request.unit, request.function])
    values = expected - _AROUND_VALUES
    return head + bytes([values]) if request.function in _READS and values < 256 else head


def _has_ends(raw: bytes, head: bytes) -> bool:
    """True if bytes begin as the answer does, or are its end: the CRC is right with the lost bytes
    of the head. So they do if a driver switches too early or too late.
    """
    lost = (head[:size] + raw for size in range(1, len(head) + 1))
    return raw.startswith(head[:2]) or any(crc(one) == 0 for one in lost)


def _request_of(raw: bytes, requests: Iterable[bytes]) -> bytes | None:
    """Return the request that bytes are a damaged copy of: with some bytes wrong, or with a run of
    bytes lost. None if there is none, and for writes, as their answers look alike.
    """
    for one in requests:
        if one[1] not in _READS:
            continue
        if len(raw) == len(one):
            if sum(
                mine == its for mine, its in zip(raw, one, strict=True)
            ) >= MIN_EQUAL_BYTES * len(one):
                return one
        elif LEAST_BYTES <= len(raw) < len(one):
            begin = _common_prefix_size(raw, one)
            if begin + _common_prefix_size(raw[::-1], one[::-1]) >= len(raw):
                return one
    return None


def _are_woven(raw: bytes, requests: Mapping[bytes, int]) -> bool:
    """True if bytes hold a known request, in order but not in one piece, among the bytes of another
    known request, or of the answer to one.
    """
    known = [one for one, times in requests.items() if times >= POLLED and one[1] in _READS]
    woven = [one for one in known if one not in raw and _is_among(one, raw)]
    if len(woven) != 1:
        return len(woven) > 1
    sizes = {len(woven[0]) + _answer_size(one) for one in known if one != woven[0]}
    return len(raw) in sizes


def _is_among(one: bytes, raw: bytes) -> bool:
    """True if all bytes of `one` are in `raw` in their order, perhaps with others between them."""
    rest = iter(raw)
    return all(byte in rest for byte in one)


def _answer_size(request: bytes) -> int:
    """The size in bytes of the answer to a read over RTU."""
    quantity = int.from_bytes(request[4:6])
    values = 2 * quantity if request[1] in (3, 4) else (quantity + 7) // 8
    return _AROUND_VALUES + values


def _common_prefix_size(one: bytes, other: bytes) -> int:
    """Return how many bytes at the beginning are the same."""
    return next(
        (at for at, (mine, its) in enumerate(zip(one, other, strict=False)) if mine != its),
        min(len(one), len(other)),
    )


def _expected_answer_size(one: NamedTransaction) -> int | None:
    """Return how many bytes the answer to a read over RTU should have; None if that is unknown."""
    if one.quantity is None:
        return None
    if one.function in (3, 4):
        return 5 + 2 * one.quantity
    if one.function in (1, 2):
        return 5 + (one.quantity + 7) // 8
    return _SHORTEST_REQUEST if one.function in (5, 6, 15, 16) else None
