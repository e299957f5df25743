"""The base classes of senses: a sense takes all records and finds some kinds of troubles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from mbtool.core import EventKind, WireEvent

if TYPE_CHECKING:
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.troubles.trouble import Trouble

HOLD_NS = 6_000_000_000
"""A record waits until one comes that began at least this long (ns) after it. Decoders wait less
than this for the response to a request on a serial line."""
MAX_HELD = 2000
"""At most this many records wait; beyond it, the oldest one is taken at once."""
MAX_LINKS = 1024
"""A sense keeps figures of at most this many links; it ignores further ones."""

DAMAGE = frozenset((EventKind.SKIPPED, EventKind.BAD_CHECK))
"""The kinds of events for bytes on a serial line that are no frame with a correct CRC or LRC."""


class Sense:
    """Takes the records of a capture, as a decoder returns them, and finds troubles of some kinds.

    It counts nothing that the account (ledger/account.py) counts: `troubles` gets these figures.
    Its memory is bounded; each module states its bound. `troubles` may be called at any time.
    """

    def begin_capture(self) -> None:
        """Note that the next record belongs to another capture, perhaps of another day."""

    def transaction(self, one: NamedTransaction) -> None:
        """Take the next transaction."""

    def event(self, event: WireEvent) -> None:
        """Take the next event."""

    def run(self, run: QuietRun) -> None:
        """Take many answered requests of a network together. By default, nothing is to be seen in
        them.
        """

    def troubles(self, links: Sequence[LinkReport]) -> Iterable[Trouble]:
        """Return the troubles so far; `links` has the account of each link."""
        return ()


class SortedSense(Sense):
    """A sense that takes the records of serial lines in the order of their times.

    A decoder returns a request without an answer late, after requests that were sent later. So each
    record waits until one comes that began HOLD_NS later, or until troubles are asked for. At most
    MAX_HELD records wait.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, NamedTransaction | WireEvent]] = []
        self._number = 0

    def transaction(self, one: NamedTransaction) -> None:
        if one.transport.is_serial:
            self._hold(one.start_ns, one)

    def event(self, event: WireEvent) -> None:
        if not event.source and not event.destination:
            self._hold(event.ts_ns, event)

    def begin_capture(self) -> None:
        self.flush()

    def flush(self) -> None:
        """Take all records that wait."""
        while self._waiting:
            self._take(heappop(self._waiting)[2])

    def take_transaction(self, one: NamedTransaction) -> None:
        """Take the next transaction of a serial line, in the order of time."""

    def take_event(self, event: WireEvent) -> None:
        """Take the next event of a serial line, in the order of time."""

    def _hold(self, at_ns: int, record: NamedTransaction | WireEvent) -> None:
        self._number += 1
        heappush(self._waiting, (at_ns, self._number, record))
        while self._waiting[0][0] < at_ns - HOLD_NS or len(self._waiting) > MAX_HELD:
            self._take(heappop(self._waiting)[2])

    def _take(self, record: NamedTransaction | WireEvent) -> None:
        if isinstance(record, WireEvent):
            self.take_event(record)
        else:
            self.take_transaction(record)


def is_text(raw: bytes) -> bool:
    """True if bytes are readable text, as of another protocol."""
    return all(0x20 <= byte < 0x7F or byte in (0x0A, 0x0D, 0x02, 0x03) for byte in raw)
