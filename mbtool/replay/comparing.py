"""Compares two captures by meaning: requests, outcomes, values and latencies."""

# Transaction ids, the order of requests and times are not compared. For each slave, identified by
# unit and, if needed, by link, these differences are reported:
#
#     slave     the slave is in one capture only
#     request   a request is in one capture only
#     outcome   a request had an outcome that it never had in the other capture. Missing responses
#               occur in most captures, so they are a difference only if their share of the requests
#               differs significantly
#     value     a register or bit had a value that it did not have in the other capture. Adjacent
#               registers that change in both captures are one difference
#     latency   the latencies of equal requests differ significantly. Requests of one slave and
#               function are one difference if their medians changed by about the same factor
#               (ALIKE): it shows the times of the request that changed most, and names all requests
#
# For the address of each slave, one more kind of difference is reported:
#
#     connection   a TCP connection was refused, or was ended by the slave or by a reset, in one
#                  capture only. If both captures have the same number of connections, they are
#                  compared one by one. Otherwise a kind of ending is a difference if it is in one
#                  capture only, or if its share of the connections differs significantly. A capture
#                  may begin later and end earlier than the other. So connections that the master
#                  closed, that were open before the capture, or that were open at its end, are one
#                  kind
#
# The significance level of a whole comparison is ALPHA; each test gets ALPHA divided by the number
# of tests (Bonferroni). A shift of latencies must also be of medium size at least (see the tests
# below), because with thousands of polls even a tiny shift is significant.

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from mbtool.core.moments import counted
from mbtool.devices import Difference, Profile, Side, Span
from mbtool.devices import DifferenceKind as Kind
from mbtool.modbus.response import ConnectionEnding
from mbtool.replay.traffic import (
    NO_ANSWER,
    ObservedValues,
    RequestKey,
    RequestTraffic,
    SlaveKey,
    SlaveTraffic,
    Traffic,
    ValueKey,
)
from mbtool.replay.wording import DeviceWording, function_text, latency_side, values_text

if TYPE_CHECKING:
    from mbtool.replay.connections import RecordedConnection

# The code below tests whether two samples differ significantly: a rank test and a test of two
# shares.
#
# Latencies have long tails and clusters at a timer's ticks, so no distribution is assumed:
#
#     rank_sum    the Mann-Whitney U test with correction for ties, in its normal approximation. It
#                 needs MIN_VALUES values on each side; with fewer the approximation is too rough,
#                 and p is 1.
#     share_p_value  Fisher's exact test, two-sided, for k of n against l of m.
#
# With many values even a tiny shift is significant. So `rank_sum` also gives the probability that
# a random value of sample b exceeds a random value of sample a (Vargha and Delaney's A): 0.5 means
# no shift; at least 0.64, or at most 0.36, is at least a medium shift on their scale.
#
# Cost: rank_sum sorts all values; share_p_value sums at most k + l terms.

ALPHA = 0.01
"""The significance level of a whole comparison. Each of its tests gets ALPHA, divided by the number
of tests (Bonferroni)."""
MIN_VALUES = 8
MEDIUM = 0.14
"""The shift between samples a and b is at least of medium size if `Shift.exceeds` differs from 0.5
by at least this."""

_ROUNDING = 1e-9
"""In Fisher's test, an outcome counts as at most as likely as the observed one if its log
probability is at most this much higher, which allows for rounding errors."""


@dataclass(frozen=True, slots=True)
class Shift:
    """The result of a rank test that compares the samples a and b."""

    p: float
    """The p-value: the probability of a difference at least as great as the one found, if both
    samples come from the same distribution."""
    exceeds: float
    """The probability that a random value of b is greater than a random one of a. A pair of equal
    values counts half."""

    @property
    def is_medium(self) -> bool:
        return abs(self.exceeds - 0.5) >= MEDIUM


def rank_sum(a: Sequence[float], b: Sequence[float]) -> Shift:
    """Test whether the values of b tend to be greater or smaller than those of a.

    With fewer than MIN_VALUES values on one side, the result is no difference (p = 1).
    """
    if min(len(a), len(b)) < MIN_VALUES:
        return Shift(1.0, 0.5)
    both = sorted([(value, 0) for value in a] + [(value, 1) for value in b])
    ranks_of_b, ties, before = 0.0, 0, 0
    for _, equal in groupby(both, key=lambda one: one[0]):
        members = [of_b for _, of_b in equal]
        count = len(members)
        ranks_of_b += (before + (count + 1) / 2) * sum(members)
        ties += count**3 - count
        before += count
    n, m = len(a), len(b)
    u = ranks_of_b - m * (m + 1) / 2
    variance = n * m / 12 * (n + m + 1 - ties / ((n + m) * (n + m - 1)))
    if variance <= 0:  # All values are equal.
        return Shift(1.0, 0.5)
    z = max(abs(u - n * m / 2) - 0.5, 0.0) / math.sqrt(variance)
    return Shift(math.erfc(z / math.sqrt(2)), u / (n * m))


def share_p_value(k: int, n: int, other_k: int, other_n: int) -> float:
    """Test whether two shares differ: k of n, and other_k of other_n. Returns the p-value.

    The p-value is the probability of a difference at least as great, if the true shares are equal.
    """
    hits, lowest = k + other_k, max(0, k + other_k - other_n)
    logs = [_log_chance(each, n, hits, n + other_n) for each in range(lowest, min(hits, n) + 1)]
    here = logs[k - lowest] + _ROUNDING
    return min(1.0, sum(math.exp(each) for each in logs if each <= here))


def _log_chance(k: int, n: int, hits: int, whole: int) -> float:
    """The natural logarithm of the probability that exactly k of the first n items are chosen, if
    `hits` of `whole` items are chosen at random.
    """
    return _log_choices(n, k) + _log_choices(whole - n, hits - k) - _log_choices(whole, hits)


def _log_choices(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


_IN_ORDER, _RESET = "opened, not ended by the slave", "opened, reset"
ALIKE = 1.25
"""Latency changes of several requests are reported as one difference if their factors (new median
divided by old) are alike: the greater factor is at most ALIKE times the smaller."""


@dataclass(frozen=True, slots=True)
class Ignored:
    """The parts of two captures that the user wants to leave out of their comparison."""

    spans: Sequence[Span] = ()
    """Registers and bits whose values are not compared."""
    latency: bool = False
    """True if latencies shall not be compared."""


def differences(
    a: Traffic, b: Traffic, profiles: Mapping[str, Profile], ignored: Ignored
) -> list[Difference]:
    """Return all differences between captures `a` and `b`, slave by slave.

    `profiles` are the device profiles by name; they give the names and the notation of registers.
    `ignored` says what is not compared.
    """
    links = a.links_of_units() | b.links_of_units()  # The greater number of links, by unit.
    unique = frozenset(unit for unit, count in links.items() if count == 1)
    slaves_a, slaves_b = a.slaves(unique), b.slaves(unique)
    tests = _count_tests(slaves_a, slaves_b)
    found: list[Difference] = []
    for key in sorted(
        slaves_a.keys() | slaves_b.keys(), key=lambda key: (key.unit, key.link or "")
    ):
        one, other = slaves_a.get(key), slaves_b.get(key)
        if one is None or other is None:
            if (a if one is None else b).has_all_slaves:  # Otherwise it may have been left out.
                found.append(_only_slave(key, one, other))
            continue
        wording = DeviceWording.of_device(one.device or other.device, profiles)
        comparison = _SlaveComparison(key, one, other, wording, ignored, ALPHA / max(tests, 1))
        found += comparison.differences()
    return [*found, *_connection_differences(a.connections(), b.connections())]


def _connection_differences(
    a: Mapping[str, Sequence[RecordedConnection]], b: Mapping[str, Sequence[RecordedConnection]]
) -> Iterator[Difference]:
    """Compare the connections to the slaves; the keys are the names of their links."""
    pairs = [(link, link) for link in a.keys() & b.keys()]
    # If each capture has only one slave, it is taken for the same one, even if its address differs.
    if len(a) == len(b) == 1:
        pairs = [(next(iter(a)), next(iter(b)))]
    for link, other in sorted(pairs):
        is_known = all(one.end is None or one.is_end_known for one in (*a[link], *b[other]))
        kinds = [
            [_kind_text(one, is_known=is_known) for one in ones] for ones in (a[link], b[other])
        ]
        several = link if len(pairs) > 1 else None
        if len(kinds[0]) == len(kinds[1]):
            yield from _differences_one_by_one(several, *kinds)
        else:
            yield from _differences_by_kind(several, *kinds)


def _kind_text(one: RecordedConnection, *, is_known: bool) -> str:
    """The kind of a connection in words. With `is_known` False, it does not say who ended it, since
    one of the captures does not.
    """
    if not one.is_open:
        return one.beginning.value
    if one.ending is None or (one.ended_by == "master" and one.ending is ConnectionEnding.CLOSE):
        return _IN_ORDER if is_known or not one.is_reset else _RESET
    return one.text if is_known else (_RESET if one.is_reset else _IN_ORDER)


def _differences_one_by_one(
    link: str | None, a: Sequence[str], b: Sequence[str]
) -> Iterator[Difference]:
    if Counter(a) == Counter(b):
        return
    for number, (one, other) in enumerate(zip(a, b, strict=True), 1):
        if one != other:
            yield Difference(
                kind=Kind.CONNECTION,
                link=link,
                what=f"connection {number}",
                a=Side(text=one),
                b=Side(text=other),
            )


def _differences_by_kind(
    link: str | None, a: Sequence[str], b: Sequence[str]
) -> Iterator[Difference]:
    counts = Counter(a), Counter(b)
    kinds = sorted((counts[0].keys() | counts[1].keys()) - {_IN_ORDER})
    for kind in kinds:
        one, other = counts[0][kind], counts[1][kind]
        p = share_p_value(one, len(a), other, len(b))
        if not (one and other) or p < ALPHA / len(kinds):
            first = (a if kind in a else b).index(kind) + 1
            yield Difference(
                kind=Kind.CONNECTION,
                link=link,
                what=f"connection {first}",
                a=Side(text=_share_text(kind, one, len(a)), count=one),
                b=Side(text=_share_text(kind, other, len(b)), count=other),
            )


def _share_text(kind: str, count: int, whole: int) -> str:
    return f"{kind}: {count:,} of {counted(whole, 'connection', ',')}"


def _count_tests(a: Mapping[SlaveKey, SlaveTraffic], b: Mapping[SlaveKey, SlaveTraffic]) -> int:
    """The number of statistical tests: for each request that both captures have, one for the share
    of missing responses and one for the latencies. `a` and `b` hold the slaves of the two captures.
    """
    return sum(
        2 * len(a[key].requests.keys() & b[key].requests.keys()) for key in a.keys() & b.keys()
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


@dataclass(frozen=True, slots=True)
class _LatencyShift:
    """A significant change of the latencies of one request from capture `a` to capture `b`.
    `is_slower` is True if they became longer.
    """

    request: RequestKey
    p: float
    is_slower: bool
    a: Side
    b: Side

    @property
    def factor(self) -> float:
        """The median latency of the slower capture divided by that of the faster one: at least 1.

        Medians below 1 ns count as 1 ns: in some captures a response has the time of its request.
        """
        before, after = (max(side.median_ns or 0, 1) for side in (self.a, self.b))
        return after / before if self.is_slower else before / after

    def is_like(self, other: _LatencyShift) -> bool:
        """True if both latencies became longer, or both shorter, and the greater factor is at most
        ALIKE times the smaller.
        """
        factors = sorted((self.factor, other.factor))
        return self.is_slower == other.is_slower and factors[1] <= factors[0] * ALIKE


class _SlaveComparison:
    """Compares the requests, values and latencies of one slave in two captures."""

    def __init__(
        self,
        key: SlaveKey,
        a: SlaveTraffic,
        b: SlaveTraffic,
        wording: DeviceWording,
        ignored: Ignored,
        alpha: float,
    ) -> None:
        """Prepare to compare the traffic `a` and `b` of one slave, each from one capture.

        `alpha` is the significance level of each statistical test; `ignored` says what is not
        compared.
        """
        self._key = key
        self._a = a
        self._b = b
        self._wording = wording
        self._ignored = ignored
        self._alpha = alpha
        self._in_both = sorted(a.requests.keys() & b.requests.keys())

    def differences(self) -> Iterator[Difference]:
        yield from self._requests()
        for request in self._in_both:
            yield from self._outcomes(request)
        yield from self._values()
        if not self._ignored.latency:
            yield from self._latencies()

    def _requests(self) -> Iterator[Difference]:
        for request in sorted(self._a.requests.keys() ^ self._b.requests.keys()):
            one, other = self._a.requests.get(request), self._b.requests.get(request)
            if not (self._a if one is None else self._b).has_all_requests:
                continue  # It may have been left out.
            yield self._difference(
                request,
                Kind.REQUEST,
                _transactions(one.count if one is not None else 0),
                _transactions(other.count if other is not None else 0),
            )

    def _outcomes(self, request: RequestKey) -> Iterator[Difference]:
        one, other = self._a.requests[request], self._b.requests[request]
        labels = (one.outcomes.keys() ^ other.outcomes.keys()) - {NO_ANSWER}
        p = share_p_value(
            one.outcomes[NO_ANSWER], one.count, other.outcomes[NO_ANSWER], other.count
        )
        if labels or p < self._alpha:
            yield self._difference(
                request,
                Kind.OUTCOME,
                Side(text=_outcomes_text(one), count=one.count),
                Side(text=_outcomes_text(other), count=other.count),
                None if labels else p,
            )

    def _values(self) -> Iterator[Difference]:
        keys = [
            key
            for key in sorted(self._a.registers.keys() & self._b.registers.keys())
            if not key.is_in(self._ignored.spans)
            and not _is_same(self._a.registers[key], self._b.registers[key])
        ]
        for run in _runs(keys, self._changes_in_both):
            first = run[0]
            if len(run) == 1:
                one, other = self._a.registers[first], self._b.registers[first]
                name, point = self._wording.of(first)
                a = Side(text=values_text(one, point), values=list(one.values))
                b = Side(text=values_text(other, point), values=list(other.values))
            else:
                name = None
                a = Side(text=_run_text(run, self._a.registers))
                b = Side(text=_run_text(run, self._b.registers))
            yield Difference(
                kind=Kind.VALUE,
                unit=self._key.unit,
                link=self._key.link,
                reference=self._wording.reference(first.table, first.address, len(run)),
                name=name,
                what="written" if first.is_written else "read",
                a=a,
                b=b,
            )

    def _changes_in_both(self, key: ValueKey) -> bool:
        """True if a register had more than one value in each of the two captures."""
        return min(len(side.registers[key].values) for side in (self._a, self._b)) > 1

    def _latencies(self) -> Iterator[Difference]:
        for _, requests in groupby(self._in_both, key=lambda key: (key.function, key.sub_function)):
            shifts = [shift for key in requests for shift in self._shift(key)]
            for first, *others in _groups_alike(shifts):
                named = [_name(one.request, self._a.requests[one.request]) for one in others]
                yield self._difference(
                    first.request, Kind.LATENCY, first.a, first.b, first.p, filter(None, named)
                )

    def _shift(self, request: RequestKey) -> Iterator[_LatencyShift]:
        """Yield one _LatencyShift if the latencies of a request changed significantly from capture
        a to capture b, and by at least a medium shift; else nothing.
        """
        a, b = (side.requests[request].latencies for side in (self._a, self._b))
        shift = rank_sum(a.values, b.values)
        if shift.p < self._alpha and shift.is_medium:
            is_slower = shift.exceeds > 0.5
            yield _LatencyShift(request, shift.p, is_slower, latency_side(a), latency_side(b))

    def _difference(
        self,
        key: RequestKey,
        kind: Kind,
        a: Side,
        b: Side,
        p: float | None = None,
        alike: Iterable[str] = (),
    ) -> Difference:
        """Make the Difference of a request; `a` and `b` show what each capture has.

        `p` is the p-value of the statistical test that found it, None if no test was needed.
        `alike` names other requests that differ in the same way.
        """
        request = self._a.requests.get(key) or self._b.requests[key]
        return Difference(
            kind=kind,
            unit=self._key.unit,
            link=self._key.link,
            function=key.function,
            reference=_name(key, request),
            what=function_text(key.function, request.function_name, key.sub_function),
            a=a,
            b=b,
            p=p,
            alike=list(alike),
        )


def _groups_alike(shifts: Iterable[_LatencyShift]) -> Iterator[list[_LatencyShift]]:
    """Group the latency changes that `is_like` finds alike: first those that became slower, and of
    these the largest factor first.
    """
    group: list[_LatencyShift] = []
    for shift in sorted(shifts, key=lambda one: (one.is_slower, one.factor), reverse=True):
        if group and not shift.is_like(group[0]):
            yield group
            group = []
        group.append(shift)
    if group:
        yield group


def _name(key: RequestKey, request: RequestTraffic) -> str | None:
    """The addresses of a request as text, in the notation of the device if known; None for a
    request without addresses.
    """
    return request.reference or (f"address {key.address}" if key.address >= 0 else None)


def _is_same(a: ObservedValues, b: ObservedValues) -> bool:
    """True if a register had the same set of values in both captures.

    If it had more than MAX_VALUES values in one of them, only the least and the greatest value are
    compared.
    """
    bounds = (a.least, a.greatest) == (b.least, b.greatest)
    return a.values.keys() == b.values.keys() or (bounds and not (a.is_all and b.is_all))


def _runs(
    keys: Iterable[ValueKey], can_join: Callable[[ValueKey], bool]
) -> Iterator[list[ValueKey]]:
    """Group the registers in `keys`, which are sorted.

    Registers with consecutive addresses form one group if `can_join` is true for each of them; any
    other register is a group of its own.
    """
    run: list[ValueKey] = []
    for key in keys:
        joins = bool(run) and can_join(run[-1]) and can_join(key)
        if joins and key == run[-1]._replace(address=run[-1].address + 1):
            run.append(key)
            continue
        if run:
            yield run
        run = [key]
    if run:
        yield run


def _transactions(count: int) -> Side:
    return Side(text=counted(count, "transaction", ",") if count else "", count=count)


def _outcomes_text(request: RequestTraffic) -> str:
    return ", ".join(
        label if count == request.count else f"{label} {count:,} of {request.count:,}"
        for label, count in sorted(request.outcomes.items(), key=lambda one: (-one[1], one[0]))
    )


def _run_text(run: Sequence[ValueKey], registers: Mapping[ValueKey, ObservedValues]) -> str:
    observed = [registers[key] for key in run]
    values = sum(len(one.values) for one in observed)
    least, greatest = min(one.least for one in observed), max(one.greatest for one in observed)
    return f"{least}..{greatest}, {values} values"
