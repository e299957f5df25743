"""Computes the statistics of live links, and the troubles that they show."""

# Files are read as for `check` (check.py). The option --where selects transactions. Events are
# always counted, because the counts of connections come from them.

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat, WireEvent
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.ledger.account import Account
from mbtool.troubles.judge import Judge, Judgement

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.devices.assignment import Assignments
    from mbtool.query.where import Where

ORDERED_AFTER_NS = 5_000_000_000
"""Live transactions wait for this time (ns) before they are sorted by the time of their requests. A
decoder does not wait longer for a response. So no transaction with an earlier request can come
after this time."""


class LiveStatistics:
    """Computes the statistics of live links, from the transactions that the user's filter accepts,
    and judges all that was heard.
    """

    def __init__(
        self,
        format_of: Callable[[str], SerialFormat | None],
        wanted: Where | None = None,
        devices: Assignments | None = None,
    ) -> None:
        self._wanted = wanted
        self.account = Account(format_of)
        context = CaptureContext(line_of=format_of)
        if devices is not None:
            context = CaptureContext(devices, format_of)
        self._judge = Judge(self.account, context)

    def add(self, record: Record) -> None:
        is_wanted = isinstance(record, WireEvent) or self._wanted is None or self._wanted(record)
        self._judge.count(record, is_wanted=is_wanted)
        for finding in self._judge.check(record):
            if is_wanted:
                self._judge.note(finding)

    def advance(self, now_ns: int) -> None:
        """Take the transactions whose requests are more than ORDERED_AFTER_NS before `now_ns` (UTC
        ns), in order of time, and count them in the periods, retries and poll cycles.
        """
        self.account.settle(now_ns - ORDERED_AFTER_NS)

    def close(self) -> None:
        """Take all transactions that wait, and the findings that come at the end."""
        for finding in self._judge.end_capture():
            self._judge.note(finding)
        self.account.settle()

    def judgement(self) -> Judgement:
        return self._judge.judgement()
