"""Counts the addresses, units, functions or registers that a master requests but does not poll."""

# A "target" is an address, unit, function or register that a rule about scans counts. A "scope" is
# the source, slave and unit within which targets are counted together. A master polls a target if
# it repeats the same request to it after a response, or repeats it MAX_ATTEMPTS times without one.
#
# To recognise a repeated request without storing all requests, one request to each target is
# remembered: number 1, then 2, 4, 8 and so on (Brent's cycle detection). So a master that sends
# several requests in turn is recognised as polling in the third turn at the latest. The opening of
# a connection counts as a request, but only until a real request comes: a scan may open a
# connection for each request.
#
# A master that polls looks like a scan if the capture ends before its second turn. So a target is
# ordinary if its slave answered as asked, and the caller states that the capture is too short to
# know whether the master polls the target. If more than half of the targets in a scope are
# ordinary, and they are at most `most_ordinary`, none of them is counted.
#
# Memory: MAX_TARGETS targets that are not known to be polled, and as many that are. If there are
# more, the oldest target not known to be polled is counted as never polled. For each of at most
# MAX_ENTRIES scopes (sliding_window.py): the times of recent cases (sliding_window.py), and as many
# targets as the rule's limit says. Each target has the packets of MAX_PACKETS requests.

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from mbtool.devices.checking.security_cases import Packets, SecurityCases
from mbtool.devices.checking.sliding_window import LruDict, SlidingWindow

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.checking.security_limits import SecurityLimit

R = TypeVar("R")

MAX_TARGETS = 8192
"""At most this many targets that are not known to be polled are kept, and as many that are."""
MAX_ATTEMPTS = 4
"""A master polls if it sends a request without a response this many times. Most masters stop after
three retries."""

MAX_PACKETS = 16

OPENED = 0
"""Stands for the opening of a connection in the place of a request's hash."""

_Scope = tuple[Hashable, ...]
_Target = tuple[_Scope, Hashable]


@dataclass(slots=True)
class Attempts:
    """The requests of a master to one target that it has not been found to poll.

    A target is an IP address, unit, function or register.
    """

    request: int
    """The hash of the remembered request to the target, by which a repetition is recognised.
    Request number 1 is remembered, then number 2, 4, 8 and so on in its place."""
    is_answered: bool
    """True if the remembered request has a response."""
    record: Any
    """The record of the first request."""
    at_ns: int
    """The time of the first request, in ns."""
    packets: Packets
    """The packets of the first request."""
    number: int = 1
    """The number of the master's requests to the target so far."""
    repeats: int = 0
    """Number of times that the remembered request was repeated."""
    is_answered_as_asked: bool = False
    """True if a response brought what was requested."""
    was_opened: bool = False
    """True if the capture has the opening of a connection to the target, an IP address, before the
    first request."""
    last_ns: int = 0
    """The time of the latest request, in ns."""
    reads_more: bool = False
    """True if a request asked for something else than the identification."""
    more: tuple[Packets, ...] = ()
    """The packets of the requests after the first one, at most MAX_PACKETS."""

    def is_poll(self, request: int, *, is_answered: bool) -> bool:
        """Take the master's next request to the target into account.

        `request` is the hash of the request, `is_answered` is True if it has a response. Returns
        True if the master is now known to poll, because it repeated a request.
        """
        if request == OPENED and self.request != OPENED:
            return False
        if self.request == OPENED and request != OPENED:
            self.number = 0  # This is the first request.
        self.number += 1
        if request != self.request:
            if self.number & (self.number - 1) == 0:
                self.request, self.is_answered, self.repeats = request, is_answered, 0
            return False
        if self.is_answered:
            return True
        self.repeats += 1
        self.is_answered = is_answered
        return self.repeats >= MAX_ATTEMPTS

    def polls_at(self, requests: list[int]) -> int | None:
        """Take the master's next requests to the target into account, all of them answered.

        Returns the index of the request with which the master is known to poll; None if it is not.
        """
        begin = 0
        while begin < len(requests):
            if self.request == OPENED:
                self.number, self.request = 0, requests[begin] + 1  # This is the first request.
            # The remembered request is replaced with the next one whose number is a power of two.
            end = begin + max((1 << self.number.bit_length()) - self.number, 1)
            some = requests[begin:end]
            found = self.request in some
            if found:
                some = some[: some.index(self.request) + 1]
            begin += len(some)
            self.number += len(some)
            if found:
                if self.is_answered or self.repeats + 1 >= MAX_ATTEMPTS:
                    return begin - 1
                self.repeats, self.is_answered = self.repeats + 1, True
            elif self.number & (self.number - 1) == 0:
                self.request, self.is_answered, self.repeats = some[-1], True, 0
        return None


class _UnpolledThings:
    """The targets in one scope (such as one source and one slave) that the source does not poll.

    A target is an IP address, unit, function or register. `window` counts them over time; `recent`
    has the last ones, for examples.
    """

    def __init__(self, limit: SecurityLimit) -> None:
        self.window = SlidingWindow(limit)
        self.recent: deque[Attempts] = deque(maxlen=limit.number)


class Unpolled(Generic[R]):
    """Counts for one rule the targets that masters request but do not poll, and adds them to
    `cases`.

    A target is an IP address, unit, function or register. A scope is the source, slave and unit
    within which targets are counted together; its first item is the source.
    """

    def __init__(
        self,
        code: str,
        describe: Callable[[R], tuple[str, Finding]],
        limit: SecurityLimit,
        cases: SecurityCases,
        *,
        most_ordinary: int | None = None,
    ) -> None:
        """`code` is that of the rule. `describe` is called with the record of the first request to
        a target, if it is a case. It returns the target as text, for an example in a message, and
        the finding to use if this is the first case of a scan. `most_ordinary` is the largest
        number of targets in a scope that can all be ordinary polling; None for any number.
        """
        self._code = code
        self._describe = describe
        self._cases = cases
        self._most_ordinary = most_ordinary
        self._attempts: OrderedDict[_Target, Attempts] = OrderedDict()
        self._polled: dict[_Target, None] = {}
        """The targets (IP addresses, units ...) that are known to be polled, the oldest first."""
        self._scans: LruDict[_Scope, _UnpolledThings] = LruDict(lambda: _UnpolledThings(limit))

    def is_polled(self, scope: _Scope, item: Hashable) -> bool:
        """True if `item`, an IP address, unit, function or register, is known to be polled.

        `scope` is the source, slave and unit to which the item belongs.
        """
        return (scope, item) in self._polled

    def set_polled(self, scope: _Scope, item: Hashable) -> None:
        """Remember that the master polls `item`, an IP address, unit, function or register, so that
        the item is not counted. `scope` is the source, slave and unit to which it belongs.
        """
        self._attempts.pop((scope, item), None)
        self._polled[scope, item] = None
        if len(self._polled) > MAX_TARGETS:
            del self._polled[next(iter(self._polled))]

    def note(
        self,
        scope: _Scope,
        item: Hashable,
        request: int,
        at_ns: int,
        make: Callable[[], R],
        *,
        is_answered: bool = False,
        is_answered_as_asked: bool = False,
        is_identification: bool = False,
        packets: Packets = (),
    ) -> bool:
        """Take a request to a target (an IP address, unit, function or register) into account.

        Returns True if the target is now known to be polled. `request` is the hash of the request,
        `at_ns` its time. `make` is called for the first request to a target, and makes its record.
        `is_answered` is True if the request has a response, `is_answered_as_asked` if that response
        brings what was requested, and is no exception, `is_identification` if it asks for the
        identification only. `packets` are those of the request and its response.
        """
        target = (scope, item)
        if target in self._polled:
            return True
        attempts = self._attempts.get(target)
        if attempts is None:
            attempts = self._attempts[target] = Attempts(
                request,
                is_answered,
                make(),
                at_ns,
                packets,
                is_answered_as_asked=is_answered_as_asked,
                was_opened=request == OPENED,
            )
            if len(self._attempts) > MAX_TARGETS:
                self._settle(*self._attempts.popitem(last=False))
        elif attempts.is_poll(request, is_answered=is_answered):
            self.set_polled(scope, item)
            return True
        else:
            attempts.is_answered_as_asked |= is_answered_as_asked
            if len(attempts.more) < MAX_PACKETS:
                attempts.more += (packets,)
        attempts.last_ns = max(attempts.last_ns, at_ns)
        attempts.reads_more |= request != OPENED and not is_identification
        return False

    def has_room(self, count: int) -> bool:
        """True if no target must be dropped for so many new ones."""
        return max(len(self._attempts), len(self._polled)) + count <= MAX_TARGETS

    def note_all(
        self,
        scope: _Scope,
        item: Hashable,
        run: QuietRun,
        places: Sequence[int],
        make: Callable[[int], R],
    ) -> int | None:
        """Take the requests of a run to a target into account: those at these places, sorted. The
        result is the same as if `note` was called for each; `make` gets the place of the first one.

        Returns the place of the request with which the target is known to be polled; None if it is
        not.
        """
        target = (scope, item)
        if not places or target in self._polled:
            return places[0] if places else None
        attempts, rows = self._attempts.get(target), run.rows
        at_ns = rows.request_ns
        begin = 0
        if attempts is None:
            first = places[0]
            self.note(
                scope,
                item,
                rows.asked[first],
                at_ns[first],
                lambda: make(first),
                is_answered=True,
                is_answered_as_asked=rows.exceptions[first] < 0,
                packets=run.packets(first),
            )
            attempts = self._attempts[target]
            begin = 1
        number = attempts.polls_at([rows.asked[place] for place in places[begin:]])
        end = None if number is None else begin + number
        some = places[begin:end]
        if some:
            attempts.is_answered_as_asked |= any(rows.exceptions[place] < 0 for place in some)
            room = MAX_PACKETS - len(attempts.more)
            attempts.more += tuple(run.packets(place) for place in some[:room])
            attempts.last_ns = max(attempts.last_ns, *(at_ns[place] for place in some))
            attempts.reads_more = True
        if end is None:
            return None
        self.set_polled(scope, item)
        return places[end]

    def close(
        self,
        is_too_short: Callable[[str, Attempts], bool] = lambda source, attempts: False,
    ) -> None:
        """Count all targets (IP addresses, units ...) that are not known to be polled.

        Call this method at the end of the capture. `is_too_short` tells of the requests of a source
        to a target whether the capture is too short to know whether the source polls it.
        """
        left, self._attempts = self._attempts, OrderedDict()
        all_targets, ordinary = Counter[_Scope](), Counter[_Scope]()
        for (scope, _), one in left.items():
            all_targets[scope] += 1
            ordinary[scope] += one.is_answered_as_asked and is_too_short(str(scope[0]), one)
        for target, one in sorted(left.items(), key=lambda item: item[1].at_ns):
            scope, most = target[0], self._most_ordinary
            is_plant = 2 * ordinary[scope] > all_targets[scope]
            if not is_plant or (most is not None and all_targets[scope] > most):
                self._settle(target, one)

    def _settle(self, target: _Target, attempts: Attempts) -> None:
        scope = target[0]
        scan = self._scans[scope]
        scan.recent.append(attempts)
        counted = scan.window.add(attempts.at_ns)
        if counted:
            new = [*islice(reversed(scan.recent), counted)][::-1]
            texts = (self._describe(one.record)[0] for one in scan.recent)
            packets = [each for one in new for each in (one.packets, *one.more)]
            first = new[0]
            source, make = str(scope[0]), lambda: self._describe(first.record)[1]
            self._cases.add(source, self._code, make, counted, texts, packets)
