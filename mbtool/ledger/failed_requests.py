"""Counts requests without a good answer, for `mbtool check`: most of them break no rule."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.modbus import Outcome
from mbtool.modbus.damaged_answers import DamagedAnswers

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

_FAILED = (Outcome.NO_ANSWER, Outcome.EXCEPTION, Outcome.MALFORMED)


class FailedRequests:
    """Counts requests that got no answer, a damaged or malformed one, or an exception."""

    def __init__(self) -> None:
        self._counts = dict.fromkeys(_FAILED, 0)
        self._damaged = DamagedAnswers()
        self.damaged = 0
        """The number of requests without a valid answer whose answer came damaged (wrong CRC or
        LRC). They are counted as unanswered, too."""

    def note(self, record: NamedTransaction | WireEvent) -> None:
        """Take the next transaction or event. Answered requests may be left out."""
        if isinstance(record, WireEvent):
            self._damaged.note(record)
        elif record.outcome in _FAILED:
            self._counts[record.outcome] += 1
            self.damaged += self._damaged.has(record)

    def count(self, outcome: Outcome) -> int:
        return self._counts[outcome]

    def counts(self) -> dict[str, int]:
        """Return the counts by the names that the JSON of `stats` has for them."""
        return {
            "no_answer": self.count(Outcome.NO_ANSWER),
            "wrong_crc": self.damaged,
            "exception": self.count(Outcome.EXCEPTION),
            "malformed": self.count(Outcome.MALFORMED),
        }
