"""Compares two captures by meaning: what was asked, what was answered, how soon."""

# Ids, order and times are not compared. For each slave, by unit and if need be by link:
#
#     slave     it is in one capture only
#     request   it was asked for something in one capture only
#     outcome   a request ended in a way that it never did in the other capture; no answer is a
#               matter of degree, so there it is the share that must differ
#     value     a register or bit had a value that it did not have in the other capture. Neighbours
#               that change in both captures are one difference
#     latency   the latencies of equal requests differ by more than chance; of one slave and
#               function that is one difference, told by the request for which it is greatest
#
# What chance would do is judged at ALPHA for a whole comparison: divided by how many tests there
# are (Bonferroni). A latency must also be of medium size (significance.py), since with thousands of
# polls the smallest shift is beyond chance.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from mbtool.core.wording import counted
from mbtool.devices import Difference, Side, Span
from mbtool.devices import DifferenceKind as Kind
from mbtool.replay.significance import Shift, rank_sum, same_share
from mbtool.replay.traffic import NO_ANSWER, Held, RequestKey, ValueKey
from mbtool.replay.wording import DeviceWording, function_text, held_text, latency_side

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from mbtool.devices import Profile
from mbtool.replay.traffic import Asked, SlaveKey, SlaveTraffic, Traffic

ALPHA = 0.01


@dataclass(frozen=True, slots=True)
class Ignored:
    """What is not compared."""

    spans: Sequence[Span] = ()
    """Registers whose values may differ."""
    latency: bool = False

    def has(self, place: ValueKey) -> bool:
        return any(span.table is place.table and place.address in span for span in self.spans)


def differences(
    a: Traffic, b: Traffic, profiles: Mapping[str, Profile], ignored: Ignored
) -> list[Difference]:
    """All differences, slave by slave; `profiles` by name, for the words."""
    links = a.links_of_units() | b.links_of_units()  # The greater of the two.
    alone = frozenset(unit for unit, count in links.items() if count == 1)
    here, there = a.slaves(alone), b.slaves(alone)
    tests = _tests(here, there)
    found: list[Difference] = []
    for key in sorted(here.keys() | there.keys(), key=lambda key: (key.unit, key.link or "")):
        one, other = here.get(key), there.get(key)
        if one is None or other is None:
            found.append(_only_slave(key, one, other))
            continue
        device = one.device or other.device
        words = DeviceWording(profiles.get(device) if device is not None else None)
        compared = _Compared(key, one, other, words, ignored, ALPHA / max(tests, 1))
        found += compared.differences()
    return found


def _tests(here: Mapping[SlaveKey, SlaveTraffic], there: Mapping[SlaveKey, SlaveTraffic]) -> int:
    """How many tests are made: two for each request that both captures have."""
    return sum(
        2 * len(here[key].asked.keys() & there[key].asked.keys())
        for key in here.keys() & there.keys()
    )


def _only_slave(key: SlaveKey, one: SlaveTraffic | None, other: SlaveTraffic | None) -> Difference:
    return Difference(
        kind=Kind.SLAVE,
        unit=key.unit,
        link=key.link,
        what="slave",
        a=_transactions(one.count if one is not None else 0),
        b=_transactions(other.count if other is not None else 0),
    )


class _Compared:
    """One slave, as two captures have it."""

    def __init__(
        self,
        key: SlaveKey,
        a: SlaveTraffic,
        b: SlaveTraffic,
        words: DeviceWording,
        ignored: Ignored,
        alpha: float,
    ) -> None:
        self._key = key
        self._a = a
        self._b = b
        self._words = words
        self._ignored = ignored
        self._alpha = alpha
        self._both = sorted(a.asked.keys() & b.asked.keys())

    def differences(self) -> Iterator[Difference]:
        yield from self._requests()
        for ask in self._both:
            yield from self._outcomes(ask)
        yield from self._values()
        if not self._ignored.latency:
            yield from self._latencies()

    def _requests(self) -> Iterator[Difference]:
        for ask in sorted(self._a.asked.keys() ^ self._b.asked.keys()):
            here, there = self._a.asked.get(ask), self._b.asked.get(ask)
            yield self._about(
                ask,
                Kind.REQUEST,
                _transactions(here.count if here is not None else 0),
                _transactions(there.count if there is not None else 0),
            )

    def _outcomes(self, ask: RequestKey) -> Iterator[Difference]:
        here, there = self._a.asked[ask], self._b.asked[ask]
        labels = (here.outcomes.keys() ^ there.outcomes.keys()) - {NO_ANSWER}
        p = same_share(here.outcomes[NO_ANSWER], here.count, there.outcomes[NO_ANSWER], there.count)
        if labels or p < self._alpha:
            yield self._about(
                ask,
                Kind.OUTCOME,
                Side(text=_outcomes_text(here), count=here.count),
                Side(text=_outcomes_text(there), count=there.count),
                None if labels else p,
            )

    def _values(self) -> Iterator[Difference]:
        places = [
            place
            for place in sorted(self._a.registers.keys() & self._b.registers.keys())
            if not self._ignored.has(place)
            and not _is_same(self._a.registers[place], self._b.registers[place])
        ]
        for run in _runs(places, self._changes):
            first = run[0]
            if len(run) == 1:
                here, there = self._a.registers[first], self._b.registers[first]
                name, texts = self._words.of(first)
                a = Side(text=held_text(here, texts), values=list(here.values))
                b = Side(text=held_text(there, texts), values=list(there.values))
            else:
                name = None
                a = Side(text=_together(run, self._a.registers))
                b = Side(text=_together(run, self._b.registers))
            yield Difference(
                kind=Kind.VALUE,
                unit=self._key.unit,
                link=self._key.link,
                reference=self._words.reference(first.table, first.address, len(run)),
                name=name,
                what="written" if first.is_written else "read",
                a=a,
                b=b,
            )

    def _changes(self, place: ValueKey) -> bool:
        """Whether it changes in both captures, so that its neighbours may be told with it."""
        return min(len(side.registers[place].values) for side in (self._a, self._b)) > 1

    def _latencies(self) -> Iterator[Difference]:
        for _, asks in groupby(self._both, key=lambda ask: ask.function):
            shifted = [
                (shift, ask)
                for ask in asks
                for shift in (self._shift(ask),)
                if shift.p < self._alpha and shift.is_medium
            ]
            if not shifted:
                continue
            shift, ask = max(shifted, key=lambda one: abs(one[0].exceeds - 0.5))
            yield self._about(
                ask,
                Kind.LATENCY,
                latency_side(self._a.asked[ask].latencies),
                latency_side(self._b.asked[ask].latencies),
                shift.p,
                len(shifted) - 1,
            )

    def _shift(self, ask: RequestKey) -> Shift:
        return rank_sum(self._a.asked[ask].latencies.values, self._b.asked[ask].latencies.values)

    def _about(
        self, ask: RequestKey, kind: Kind, a: Side, b: Side, p: float | None = None, alike: int = 0
    ) -> Difference:
        asked = self._a.asked.get(ask) or self._b.asked[ask]
        return Difference(
            kind=kind,
            unit=self._key.unit,
            link=self._key.link,
            function=ask.function,
            reference=asked.reference or None,
            what=function_text(ask.function, asked.function_name, ask.sub_function),
            a=a,
            b=b,
            p=p,
            alike=alike,
        )


def _is_same(a: Held, b: Held) -> bool:
    bounds = (a.least, a.greatest) == (b.least, b.greatest)
    return a.values.keys() == b.values.keys() or (bounds and not (a.is_all and b.is_all))


def _runs(
    places: Iterable[ValueKey], is_together: Callable[[ValueKey], bool]
) -> Iterator[list[ValueKey]]:
    """Neighbours of which all hold that; each other place alone."""
    run: list[ValueKey] = []
    for place in places:
        follows = bool(run) and is_together(run[-1]) and is_together(place)
        if follows and place == run[-1]._replace(address=run[-1].address + 1):
            run.append(place)
            continue
        if run:
            yield run
        run = [place]
    if run:
        yield run


def _transactions(count: int) -> Side:
    return Side(text=counted(count, "transaction", ",") if count else "", count=count)


def _outcomes_text(asked: Asked) -> str:
    return ", ".join(
        label if count == asked.count else f"{label} {count:,} of {asked.count:,}"
        for label, count in sorted(asked.outcomes.items(), key=lambda one: (-one[1], one[0]))
    )


def _together(run: Sequence[ValueKey], registers: Mapping[ValueKey, Held]) -> str:
    held = [registers[place] for place in run]
    values = sum(len(one.values) for one in held)
    least, greatest = min(one.least for one in held), max(one.greatest for one in held)
    return f"{least}..{greatest}, {values} values"
