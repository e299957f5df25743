"""Reads files for commands that only count transactions, so that many can be passed as a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.workflows.shared.reading import Reading

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.decode.decoder import Record
    from mbtool.ledger.answered_run import AnsweredRun


class PartReading(Reading):
    """Reads files once, and yields transactions and events, perhaps many transactions as
    one batch.
    """

    def parts(self) -> Iterator[Record | AnsweredRun]:
        """Yield all transactions and events, one by one.

        A subclass may yield many answered requests together as one AnsweredRun.
        """
        return self.records()
