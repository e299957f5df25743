"""Compares how requests to a slave ended with what a profile predicts."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from mbtool.devices.block_reads import can_be_read
from mbtool.devices.references import write_reference
from mbtool.modbus.functions import (
    FUNCTIONS,
    READ_WRITE_REGISTERS,
    WRITE_LIMIT_17H,
    ExceptionCode,
    function_name,
)

if TYPE_CHECKING:
    from mbtool.devices.model import Profile
    from mbtool.devices.observed_slave import ObservedRequest, ObservedSlave, Replies

_REFUSALS = frozenset(
    (
        ExceptionCode.ILLEGAL_FUNCTION,
        ExceptionCode.ILLEGAL_DATA_ADDRESS,
        ExceptionCode.ILLEGAL_DATA_VALUE,
    )
)


class PredictedRequest(NamedTuple):
    """A request that a slave accepted or refused, and what the profile predicts for it."""

    profile: Profile
    request: ObservedRequest
    exceptions: frozenset[int]
    """The exception codes with which the slave answered it."""
    is_accepted: bool
    is_predicted: bool
    """True if the profile predicts that the slave accepts it."""
    rule: str
    """The reason of the prediction in words, such as `its manual has no such address`."""
    other: str
    """The exception codes as text if the slave refused the request as predicted, but for another
    reason; else empty."""

    @property
    def is_against(self) -> bool:
        """True if the request ended otherwise than the profile predicts."""
        return self.is_accepted is not self.is_predicted or bool(self.other)

    @property
    def reference(self) -> str:
        """The function and the addresses of the request in the profile's notation."""
        return _request_text(self.profile, self.request)

    @property
    def end(self) -> str:
        if self.is_accepted:
            return "answered"
        return f"refused with exception {self.other}" if self.other else "refused"

    @property
    def contradiction(self) -> str:
        """A sentence on a request that is against the profile: what was asked, with the addresses
        on the wire and in the profile's notation, what came, and what the profile says.
        """
        text = f"{_wire_text(self.profile, self.request)} was {self.end}"
        if self.is_accepted:
            return f"{text}, but {self.rule}"
        if not self.other:
            return f"{text} with exception {_codes(self.exceptions)}, but {self.rule}"
        codes = self.profile.exceptions
        has_function = self.profile.rule(self.request.function) is not None
        right = {codes.address, codes.value} if has_function else {codes.function}
        return f"{text}, but {self.rule}, which is exception {_codes(right)}"


class MatchCounts(NamedTuple):
    """The numbers of different requests to a slave by how they ended, compared with a profile."""

    explained: int
    """The number of requests that ended as the profile predicts."""
    contradicted: int
    refused: int
    """The number of requests in `explained` that the slave refused."""


class _Group(NamedTuple):
    """Different requests to a slave with one function that ended alike."""

    request: ObservedRequest
    """One of them, as an example."""
    replies: Replies
    """The replies to that one."""
    spans: list[tuple[int, int, int]]
    """The first address, the address behind the last one, and the quantity of each, sorted; empty
    for requests without addresses."""
    number: int
    """The number of requests."""


class GroupedRequests:
    """The different requests to a slave, grouped so that many can be compared at once."""

    def __init__(self, slave: ObservedSlave) -> None:
        found: dict[tuple[object, ...], list[tuple[ObservedRequest, Replies]]] = {}
        for request, replies in slave.requests.items():
            end = replies.ok > 0 or tuple(sorted(replies.exceptions))
            key = request.function, request.writes, request.table, request.address is None, end
            found.setdefault(key, []).append((request, replies))
        self._groups = [
            _Group(
                *some[0],
                sorted(
                    (one.address, one.span.stop, one.quantity)
                    for one, _ in some
                    if one.table is not None and one.address is not None
                ),
                len(some),
            )
            for some in found.values()
        ]

    def compare(self, profile: Profile) -> MatchCounts:
        """Count how the requests ended, as `compare_with_profile` compares each."""
        explained = contradicted = refused = 0
        for one in self._groups:
            limit = _limit(profile, one.request.function, writes=one.request.writes)
            allowed = _count_allowed(profile, one, limit.most)
            for is_predicted, number in ((True, allowed), (False, one.number - allowed)):
                if not number:
                    continue
                accepts, other = _ended(profile, one.request, one.replies, is_predicted)
                if accepts is None:
                    continue
                is_against = accepts is not is_predicted or bool(other)
                contradicted += number * is_against
                explained += number * (not is_against)
                refused += number * (not is_against and not accepts)
        return MatchCounts(explained, contradicted, refused)


def _count_allowed(profile: Profile, group: _Group, most: int) -> int:
    """Return the number of requests that the profile predicts to be accepted; `most` is the
    greatest quantity of their function.
    """
    if not group.spans or not most:
        return group.number if most else 0
    table, writes = group.request.table, group.request.writes
    assert table is not None
    allowed = [
        (first, stop)
        for begin, end in profile.ranges(table, writing=writes)
        for first, stop, quantity in group.spans[
            bisect_left(group.spans, (begin,)) : bisect_left(group.spans, (end,))
        ]
        if stop <= end and 1 <= quantity <= most
    ]
    if writes or not profile.has_blocks:
        return len(allowed)
    return sum(can_be_read(profile, table, range(*span)) for span in allowed)


def compare_with_profile(slave: ObservedSlave, profile: Profile) -> Iterator[PredictedRequest]:
    """Compare each different request to a slave with a profile; one that tells nothing is left
    out.
    """
    limits: dict[tuple[int, bool], _Limit] = {}
    for request, replies in slave.requests.items():
        function, writes = request.function, request.writes
        limit = limits.get((function, writes))
        if limit is None:
            limit = limits[function, writes] = _limit(profile, function, writes=writes)
        rule, is_predicted = _predict(profile, request, limit)
        is_accepted, other = _ended(profile, request, replies, is_predicted)
        if is_accepted is not None:
            yield PredictedRequest(
                profile,
                request,
                frozenset(replies.exceptions),
                is_accepted,
                is_predicted,
                rule,
                other,
            )


def _ended(
    profile: Profile, request: ObservedRequest, replies: Replies, is_predicted: bool
) -> tuple[bool | None, str]:
    """Return `_observed`, and the text of `_other_refusal` if the slave refused the request as
    predicted.
    """
    is_accepted = _observed(profile, request, replies, is_predicted=is_predicted)
    is_refusal = is_accepted is False and not is_predicted
    return is_accepted, _other_refusal(profile, request, replies) if is_refusal else ""


def _observed(
    profile: Profile, request: ObservedRequest, replies: Replies, *, is_predicted: bool
) -> bool | None:
    """Return True if the slave accepts a request, False if it refuses it, None if its replies show
    neither for certain.

    `is_predicted` is True if the profile predicts that the slave accepts it.
    """
    if replies.ok or not replies.exceptions:
        return True if replies.ok else None
    codes = profile.exceptions
    refusals = _REFUSALS | {codes.function, codes.address, codes.value}
    refused = refusals.intersection(replies.exceptions)
    if request.function == READ_WRITE_REGISTERS:
        refused &= {codes.function}
    elif request.writes and is_predicted and codes.value not in (codes.function, codes.address):
        refused -= {codes.value}
    return False if refused else None


def _other_refusal(profile: Profile, request: ObservedRequest, replies: Replies) -> str:
    """Return the exception codes in `replies` as text, such as `01 and 02`, if they contradict the
    profile's reason for a refusal; otherwise an empty text.

    The profile's reason is either the function, or the addresses and the quantity.
    """
    no_function = profile.exceptions.function
    others = {profile.exceptions.address, profile.exceptions.value} - {no_function}
    given = set(replies.exceptions)
    if profile.rule(request.function) is None:
        is_other = no_function not in given
    else:
        is_other = no_function in given and not given & others
    return " and ".join(f"{code:02X}" for code in sorted(given)) if is_other and others else ""


class _Limit(NamedTuple):
    """The greatest quantity of a function by a profile, with the reasons in words."""

    most: int
    """The largest quantity that the device takes; 0 if the device does not have the function."""
    text: str
    """The sentence that the device has the function, or has not."""
    text_beyond: str
    """The reason for which a larger quantity is refused."""


def _limit(profile: Profile, function: int, *, writes: bool) -> _Limit:
    rule = profile.rule(function)
    if rule is None:
        return _Limit(0, f"its manual has no function {function:02X}", "")
    known = FUNCTIONS.get(function)
    if function == READ_WRITE_REGISTERS and writes:
        most = rule.write_limit or WRITE_LIMIT_17H
    else:
        most = rule.limit or (1 if known is None else known.limit)
    return _Limit(most, f"its manual has function {function:02X}", f"its manual's limit is {most}")


def _predict(profile: Profile, request: ObservedRequest, limit: _Limit) -> tuple[str, bool]:
    """Predict what a device with the profile does with a request, whose function has this limit.

    Returns the reason in words (`its manual's limit is 100`), and True if the device accepts the
    request, False if it refuses it.
    """
    table, address = request.table, request.address
    if not limit.most or table is None or address is None:
        return limit.text, limit.most > 0
    if not 1 <= request.quantity <= limit.most:
        return limit.text_beyond, False
    span = request.span
    if request.writes:
        verb, is_allowed = "write", profile.allows(table, span, writing=True)
    else:
        verb, is_allowed = "read", can_be_read(profile, table, span)
    if is_allowed:
        return "its manual has that address", True
    if profile.allows(table, span):
        return f"by its manual one cannot {verb} there", False
    return "its manual has no such address", False


def _request_text(profile: Profile, request: ObservedRequest) -> str:
    function, table, address = request.function, request.table, request.address
    if table is None or address is None:
        return f"{function:02X} {function_name(function)}"
    where = write_reference(profile, table, address, request.quantity, writing=request.writes)
    return f"{function:02X} {where}"


def _wire_text(profile: Profile, request: ObservedRequest) -> str:
    """Return a request with its addresses on the wire: `02 read discrete 200 (XC8)`."""
    function, table, address = request.function, request.table, request.address
    if table is None or address is None:
        return _request_text(profile, request)
    verb = "write" if request.writes else "read"
    wire = write_reference(None, table, address, request.quantity)
    own = write_reference(profile, table, address, request.quantity, writing=request.writes)
    return f"{function:02X} {verb} {wire}{'' if own == wire else f' ({own})'}"


def _codes(codes: Iterable[int]) -> str:
    return " or ".join(f"{code:02X}" for code in sorted(codes))
