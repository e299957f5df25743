"""What each kind of trouble is found by: a sense, which takes all records in order."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.core import WireEvent
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.answered_run import AnsweredRun
    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.troubles.trouble import Trouble


class Sense:
    """Takes the records of a capture, as a decoder returns them, and finds troubles of some kinds.

    It counts nothing that the account (the room ledger) counts: `troubles` gets that. Its memory is
    bounded; each module states its bound. It may be asked at any time, and goes on afterwards.
    """

    def begin_capture(self) -> None:
        """Note that the next record belongs to another capture, perhaps of another day."""

    def transaction(self, one: NamedTransaction) -> None:
        """Take the next transaction."""

    def event(self, event: WireEvent) -> None:
        """Take the next event."""

    def run(self, run: AnsweredRun) -> None:
        """Take many answered requests of a network together. By default, nothing is to be seen in
        them.
        """

    def troubles(self, links: Sequence[LinkReport]) -> Iterable[Trouble]:
        """Return the troubles so far; `links` has the account of each link."""
        return ()
