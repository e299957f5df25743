"""Counts requests by outcome, and collects the latencies of their responses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.ledger.distribution import Distribution
from mbtool.modbus import Outcome, Verdict, exception_name
from mbtool.modbus.functions import ExceptionCode

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

MAX_EXCEPTIONS = 256
"""The most exception codes that are counted separately: all that are possible, as a code is one
byte."""
_STANDARD_NAMES = {int(code): exception_name(code) for code in ExceptionCode}

_NONE: dict[int, int] = {}
_NO_NAMES: dict[int, str] = {}
"""Shared by tallies without exceptions, as there are many; they stay empty."""


class RequestTally:
    """The number of outcomes, and the latencies, of a group of transactions: those of a poll, a
    function, a unit or a link.

    A transaction whose request or response is missing from the capture has an outcome of its own
    (NOT_CAPTURED), so that it does not count against the device.
    """

    __slots__ = (
        "ambiguous",
        "ambiguously_unanswered",
        "damaged",
        "exception_names",
        "exceptions",
        "latency",
        "outcomes",
        "request_bytes",
        "requests",
        "response_bytes",
        "retries",
        "unsolicited_exceptions",
    )

    def __init__(self) -> None:
        self.outcomes: dict[Outcome, int] = {}
        self.requests = 0
        """The number of transactions whose request is in the capture."""
        self.exceptions: dict[int, int] = _NONE
        """The number of requests answered with an exception response; the key is the exception
        code."""
        self.exception_names: dict[int, str] = _NO_NAMES
        """The name of each exception code: the standard's, as the manuals of several devices may
        call a code otherwise. A code that the standard lacks has the name of its first response."""
        self.unsolicited_exceptions = 0
        """The number of exception responses without a request; these are not in `exceptions`."""
        self.ambiguous = 0
        """The number of ambiguous transactions: the recording does not decide what they are. The
        other counts have them as what they most likely are."""
        self.ambiguously_unanswered = 0
        """The number of ambiguous transactions with no response, perhaps because the request was
        itself a response."""
        self.damaged = 0
        """The number of requests without a valid response, because the response that came had a
        wrong CRC or LRC. They are counted as unanswered, too."""
        self.retries = 0
        """The number of requests that are retries: they repeat an equal request which got no
        response."""
        self.latency = Distribution()
        """The latencies (ns): the times from the end of a request to the start of its response."""
        self.request_bytes = 0
        """The number of bytes of all request ADUs, as captured."""
        self.response_bytes = 0

    def add(self, transaction: NamedTransaction) -> None:
        request, response = transaction.request_raw or b"", transaction.response_raw or b""
        self.count_alike(transaction, 1, len(request), len(response))
        if transaction.latency_ns is not None:
            self.latency.add(transaction.latency_ns)

    def count_alike(
        self, transaction: NamedTransaction, number: int, request_bytes: int, response_bytes: int
    ) -> None:
        """Count `number` transactions like `transaction`, whose requests and responses have so many
        bytes together. The caller adds the latencies.
        """
        outcome = transaction.outcome
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + number
        if transaction.request_ns is not None:
            self.requests += number
        code = transaction.exception
        if code is not None and outcome is Outcome.UNSOLICITED:
            self.unsolicited_exceptions += number
        elif code is not None and outcome is Outcome.EXCEPTION:
            self._count_exception(code, transaction.exception_name or "", number)
        if transaction.verdicts and Verdict.AMBIGUOUS in transaction.verdicts:
            self.ambiguous += number
            if outcome is Outcome.NO_ANSWER:
                self.ambiguously_unanswered += number
        if transaction.retries > 0:
            self.retries += number
        self.request_bytes += request_bytes
        self.response_bytes += response_bytes

    def _count_exception(self, code: int, name: str, number: int) -> None:
        if self.exceptions is _NONE:  # Most tallies have none.
            self.exceptions, self.exception_names = {}, {}
        if code in self.exceptions or len(self.exceptions) < MAX_EXCEPTIONS:
            self.exceptions[code] = self.exceptions.get(code, 0) + number
            self.exception_names.setdefault(code, _STANDARD_NAMES.get(code, name))

    def merge(self, other: RequestTally) -> None:
        """Add the counts and latencies of another tally to this one."""
        for outcome, count in other.outcomes.items():
            self.outcomes[outcome] = self.outcomes.get(outcome, 0) + count
        for code, count in other.exceptions.items():
            self._count_exception(code, other.exception_names[code], count)
        self.requests += other.requests
        self.unsolicited_exceptions += other.unsolicited_exceptions
        self.ambiguous += other.ambiguous
        self.ambiguously_unanswered += other.ambiguously_unanswered
        self.damaged += other.damaged
        self.retries += other.retries
        self.latency.merge(other.latency)
        self.request_bytes += other.request_bytes
        self.response_bytes += other.response_bytes

    @property
    def transactions(self) -> int:
        return sum(self.outcomes.values())

    @property
    def wire_bytes(self) -> int:
        """The number of bytes of all request and response ADUs, as captured."""
        return self.request_bytes + self.response_bytes

    def count(self, outcome: Outcome) -> int:
        return self.outcomes.get(outcome, 0)

    @property
    def is_of_broadcasts(self) -> bool:
        """True if there are only broadcasts, which no unit answers."""
        return self.count(Outcome.BROADCAST) == self.transactions

    @property
    def unanswered(self) -> int:
        """The number of requests that got no response, or none with a right checksum."""
        return self.count(Outcome.NO_ANSWER)

    @property
    def surely_unanswered(self) -> int:
        """The number of requests of `unanswered` that are not ambiguous."""
        return self.unanswered - self.ambiguously_unanswered

    @property
    def not_in_time(self) -> int:
        """The number of requests that got no response before their master gave them up."""
        return self.count(Outcome.NO_ANSWER) + self.count(Outcome.LATE)


def merged(tallies: list[RequestTally]) -> RequestTally:
    """Return a new tally with the counts and latencies of all `tallies` added up."""
    result = RequestTally()
    for one in tallies:
        result.merge(one)
    return result
