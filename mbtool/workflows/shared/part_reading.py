"""Reads files so that many answered requests may come at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.workflows.shared.reading import Reading

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.decode.decoder import Record
    from mbtool.overview.answered_run import AnsweredRun


class PartReading(Reading):
    """Reads files once, and yields what is counted."""

    def parts(self) -> Iterator[Record | AnsweredRun]:
        """Yield all transactions and events; many answered requests may come as one run."""
        return self.records()
