"""Notes from when to when a unit was asked, and from when to when its requests failed."""

from __future__ import annotations

from typing import NamedTuple

from mbtool.ledger.unit_bins import UnitBins
from mbtool.modbus import Outcome


class FailureSpan(NamedTuple):
    """The first and the last failed request of one kind to a unit; times in ns since 1970."""

    first_ns: int
    last_ns: int


class UnitTimes:
    """The times (UTC ns) of the requests to one unit, and of those that failed."""

    __slots__ = (
        "answered_ns",
        "bins",
        "first_ns",
        "last_ns",
        "missing",
        "refused",
        "silent",
        "silent_since_ns",
    )

    def __init__(self, first_ns: int) -> None:
        self.bins = UnitBins()
        self.first_ns = self.last_ns = first_ns
        self.answered_ns = first_ns - 1
        """The time of the last answer; a time before the first request if there was none."""
        self.silent = 0
        """The number of requests since `silent_since_ns` that were not answered."""
        self.silent_since_ns = first_ns - 1
        """The time of the first unanswered request after an answered one. The unit is silent until
        now if that is later than `answered_ns`."""
        self.missing: FailureSpan | None = None
        """The requests without an answer, or whose answer had a wrong CRC or LRC."""
        self.refused: FailureSpan | None = None
        """The requests with an exception as response."""

    def note_failure(self, outcome: Outcome, at_ns: int) -> None:
        """Note that a request sent at `at_ns` had this outcome."""
        if outcome is Outcome.NO_ANSWER:
            self.missing = _with(self.missing, at_ns)
            if at_ns > self.answered_ns:
                self._note_silence(at_ns)
        elif outcome is Outcome.EXCEPTION:
            self.refused = _with(self.refused, at_ns)

    def note_answers(self, begin_ns: int, end_ns: int) -> None:
        """Note that several requests, the first of them sent at `begin_ns`, were answered until
        `end_ns`. The caller counts them in `bins`.
        """
        self.first_ns = min(self.first_ns, begin_ns)
        self.last_ns = max(self.last_ns, end_ns)
        self.answered_ns = max(self.answered_ns, end_ns)

    def _note_silence(self, at_ns: int) -> None:
        if self.silent_since_ns <= self.answered_ns:
            self.silent, self.silent_since_ns = 0, at_ns
        self.silent += 1


def _with(span: FailureSpan | None, at_ns: int) -> FailureSpan:
    """Return the time of failures so that it has one at `at_ns`, too."""
    if span is None:
        return FailureSpan(at_ns, at_ns)
    return FailureSpan(min(span.first_ns, at_ns), max(span.last_ns, at_ns))
