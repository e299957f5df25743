"""What is true of a simulated capture, and which part of it can be known from the packets."""

# Two ADUs with the same bytes in the same packets cannot be told apart, so they are one kind,
# named by the number of the first of them. Records are compared with the truth by kind.
#
# Not everything can be known: where a master with a constant id has two equal requests open and
# the slave drops one of them, either can be the dropped one. A reading of a connection gives each
# response a request: one that was sent before it, that its segment acknowledges, whose shape it
# has; in the order of the requests, since a slave with one id has no other way to answer. A
# reading costs 1 for each request without a response and 1 for each response that is later than
# the master's timeout. A pair is decidable if it is the true one and all readings of the least
# cost have it. What the capture lacks still counts: TCP tells that there is a hole and how long
# it is, so a lost ADU fits whatever has its length.

from __future__ import annotations

import math
from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from tests.adversary.plant import BIT_READS, READ_FUNCTIONS, Answer, Ask

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tests.adversary.plant import Talk
    from tests.adversary.tcp import Seen, Segment

EXCEPTION_SIZE = 9
HELD_BACK_NS = 5_000_000_000
"""A decoder may time an ADU by the segment that filled a hole before it, up to this much later."""


class Truth:
    """Which response answers which request, and where each is in the capture."""

    def __init__(
        self, talk: Talk, seen: list[Seen], timeouts: dict[int, int], reordering: set[int]
    ) -> None:
        """Take what was said and what the capture has of it.

        Timeouts are those of the masters in ns, by connection. On the connections of `reordering`
        slaves answer out of order.
        """
        self.asks = talk.asks
        self.answers = talk.answers
        self._seen = seen
        self._by_packet: defaultdict[tuple[bytes, int], set[tuple[int, int]]] = defaultdict(set)
        """For bytes and a packet's time: how unlikely it is that they end there, and the kind."""
        self._by_raw: defaultdict[tuple[bytes, bool], list[tuple[int, int]]] = defaultdict(list)
        """For bytes and True for requests: when each kind was complete, and the kind."""
        self.kinds: dict[Ask | Answer, int] = {}
        """The kind of each ADU that is wholly in the capture."""
        self.candidates: defaultdict[int, set[int]] = defaultdict(set)
        """For each kind of undecidable responses: the kinds of requests that it may answer."""
        self.unsure: set[int] = set()
        """Kinds of requests and responses of which no more can be known."""
        self.sizes: Counter[int] = Counter()
        """How many ADUs are of a kind."""
        self._find_kinds()
        for connection, timeout_ns in timeouts.items():
            self._find_undecidable(connection, timeout_ns, by_id=connection in reordering)
        self._find_ends_without_evidence()

    @property
    def is_complete(self) -> bool:
        """True if the capture has every ADU."""
        return len(self.kinds) == len(self.asks) + len(self.answers)

    def pairs(self) -> Counter[tuple[int, int]]:
        """How often a request of one kind has a response of another kind, both in the capture."""
        return Counter(
            (self.kinds[one.ask], self.kinds[one])
            for one in self.answers
            if one in self.kinds and one.ask in self.kinds
        )

    def unanswered(self) -> Counter[int]:
        """The requests in the capture, by kind, that the slave never answered."""
        return Counter(
            self.kinds[one] for one in self.asks if one.answer is None and one in self.kinds
        )

    def kinds_at(self, raw: bytes, ts_ns: int) -> list[int]:
        """The kinds of ADUs that a packet may complete, the likely ones first.

        First come those whose last hole the packet fills, then those that it has a part of.
        """
        return [kind for _, kind in sorted(self._by_packet.get((raw, ts_ns), ()))]

    def kind_before(
        self, raw: bytes, ts_ns: int, *, is_ask: bool, taken: Counter[int]
    ) -> int | None:
        """The first kind that was complete shortly before this time and is not taken."""
        for complete_ns, kind in self._by_raw[raw, is_ask]:
            if ts_ns - HELD_BACK_NS <= complete_ns <= ts_ns and not taken[kind]:
                return kind
        return None

    def complete_ns(self, adu: Ask | Answer) -> int:
        """When the capture first has all bytes of an ADU."""
        kind = self.kinds[adu]
        times = self._by_raw[adu.raw, isinstance(adu, Ask)]
        return next(time_ns for time_ns, one in times if one == kind)

    def _find_kinds(self) -> None:
        parts: defaultdict[tuple[int, bool], list[tuple[int, int, int]]] = defaultdict(list)
        for one in self._seen:
            segment = one.segment
            if segment.payload:
                end = segment.offset + len(segment.payload)
                parts[segment.connection, segment.from_master].append(
                    (segment.offset, end, one.ts_ns)
                )
        numbers: dict[tuple[bytes, tuple[int, ...]], int] = {}
        adus: list[Ask | Answer] = [*self.asks, *self.answers]
        for number, adu in enumerate(adus):
            is_ask = isinstance(adu, Ask)
            stream = parts[_connection_of(adu), is_ask]
            touching = sorted(one for one in stream if one[0] < adu.end and one[1] > adu.offset)
            if not _covers(touching, adu.offset, adu.end):
                continue
            times = tuple(sorted(part[2] for part in touching))
            kind = numbers.setdefault((adu.raw, times), number)
            self.kinds[adu] = kind
            self.sizes[kind] += 1
            self._by_raw[adu.raw, is_ask].append((_complete_ns(touching, adu), kind))
            for _, end, ts_ns in touching:
                self._by_packet[adu.raw, ts_ns].add((1 if end >= adu.end else 2, kind))
            self._by_packet[adu.raw, _in_order_ns(stream, adu.end)].add((0, kind))

    def _find_undecidable(self, connection: int, timeout_ns: int, *, by_id: bool) -> None:
        asks = [one for one in self.asks if one.connection == connection]
        answers = [one for one in self.answers if one.ask.connection == connection]
        ids = {one.raw[:2] for one in asks} if by_id else {b""}
        for group in ids:
            self._compare_readings(
                sorted((one for one in asks if one.raw.startswith(group)), key=lambda one: one.end),
                sorted(
                    (one for one in answers if one.raw.startswith(group)), key=lambda one: one.end
                ),
                timeout_ns,
            )

    def _compare_readings(self, asks: list[Ask], answers: list[Answer], timeout_ns: int) -> None:
        costs = [[self._cost(ask, answer, timeout_ns) for answer in answers] for ask in asks]
        before = _least(costs, len(answers))
        behind = _least([row[::-1] for row in costs[::-1]], len(answers))
        rows, columns = len(asks), len(answers)
        least = before[rows][columns]
        for column, answer in enumerate(answers):
            possible = {
                row
                for row in range(rows)
                if before[row][column]
                + costs[row][column]
                + behind[rows - 1 - row][columns - 1 - column]
                <= least
            }
            true_row = asks.index(answer.ask)
            if possible == {true_row}:
                continue
            doubtful = {*(asks[row] for row in possible), answer.ask}
            self.unsure.update(self.kinds[one] for one in (*doubtful, answer) if one in self.kinds)
            if answer in self.kinds:
                self.candidates[self.kinds[answer]].update(
                    self.kinds[one] for one in doubtful if one in self.kinds
                )

    def _cost(self, ask: Ask, answer: Answer, timeout_ns: int) -> float:
        if answer.acknowledged < ask.end or answer.sent_ns < ask.sent_ns:
            return math.inf
        if not self._fits(ask, answer):
            return math.inf
        return 1 if answer.sent_ns - ask.sent_ns > timeout_ns else 0

    def _fits(self, ask: Ask, answer: Answer) -> bool:
        if ask not in self.kinds:
            return True
        if answer not in self.kinds:
            return len(answer.raw) in (EXCEPTION_SIZE, _size_of_answer(ask.raw))
        return answer_fits(ask.raw, answer.raw)

    def _find_ends_without_evidence(self) -> None:
        """Mark ADUs whose other half is missing where no segment tells that it ever was."""
        for answer in self.answers:
            ask = answer.ask
            if ask in self.kinds and answer not in self.kinds and not self._is_told(answer):
                self.unsure.add(self.kinds[ask])
            if answer in self.kinds and ask not in self.kinds and not self._has_room_for(ask):
                self.unsure.add(self.kinds[answer])

    def _is_told(self, answer: Answer) -> bool:
        """True if a segment of the capture tells that the bytes of a response were sent."""
        return any(
            segment.acknowledged >= answer.end
            if segment.from_master
            else segment.offset + len(segment.payload) >= answer.end
            for segment in self._segments(answer.ask.connection)
        )

    def _has_room_for(self, ask: Ask) -> bool:
        """True if an earlier segment of the capture tells where the request began."""
        return any(
            segment.offset <= ask.offset
            if segment.from_master
            else segment.acknowledged <= ask.offset
            for segment in self._segments(ask.connection)
        )

    def _segments(self, connection: int) -> Iterable[Segment]:
        return (one.segment for one in self._seen if one.segment.connection == connection)


def answer_fits(request: bytes, response: bytes) -> bool:
    """True if a response has the id, unit, function and shape that a request asks for."""
    if request[:2] != response[:2] or request[6] != response[6]:
        return False
    if request[7] != response[7] & 0x7F:
        return False
    if response[7] & 0x80:
        return len(response) == EXCEPTION_SIZE
    if request[7] in READ_FUNCTIONS:
        return len(response) == _size_of_answer(request)
    return response[8:12] == request[8:12]


def _size_of_answer(request: bytes) -> int:
    if request[7] in READ_FUNCTIONS:
        quantity = int.from_bytes(request[10:12])
        return 9 + ((quantity + 7) // 8 if request[7] in BIT_READS else 2 * quantity)
    return 12


def _covers(parts: list[tuple[int, int, int]], start: int, end: int) -> bool:
    """True if sorted parts have all bytes from start to end."""
    for part_start, part_end, _ in parts:
        if part_start > start:
            return False
        start = max(start, part_end)
    return start >= end


def _complete_ns(parts: list[tuple[int, int, int]], adu: Ask | Answer) -> int:
    """When the capture first has all bytes of an ADU that sorted parts cover."""
    return next(
        ts_ns
        for ts_ns in sorted(part[2] for part in parts)
        if _covers([part for part in parts if part[2] <= ts_ns], adu.offset, adu.end)
    )


def _in_order_ns(parts: list[tuple[int, int, int]], end: int) -> int:
    """When the capture first has all that it ever has of a stream up to an end."""
    first: dict[int, int] = {}
    for start, _, ts_ns in parts:
        if start < end:
            first[start] = min(ts_ns, first.get(start, ts_ns))
    return max(first.values())


def _connection_of(adu: Ask | Answer) -> int:
    return adu.connection if isinstance(adu, Ask) else adu.ask.connection


def _least(costs: list[list[float]], columns: int) -> list[list[float]]:
    """The least cost of each number of first rows and columns; columns take rows in order."""
    table = [[0.0] + [math.inf] * columns]
    for row in costs:
        last = table[-1]
        table.append(
            [last[0] + 1] + [min(last[n + 1] + 1, last[n] + row[n]) for n in range(columns)]
        )
    return table
