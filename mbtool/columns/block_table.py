"""Makes one table of the transactions that a block's packets completed, in order."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from mbtool.columns.column_decoder import order_of
from mbtool.columns.plain_table import PlainTables
from mbtool.columns.row_table import row_table
from mbtool.core import WireEvent
from mbtool.decode.decoder import Record
from mbtool.devices import NamedTransaction

if TYPE_CHECKING:
    from mbtool.columns.column_decoder import DecodedBlock


@dataclass(slots=True)
class TransactionBatch:
    """The transactions and events that some packets completed."""

    table: pa.Table
    """All transactions, in order, with the columns of schema.py."""
    records: list[Record]
    """The events, in order, without the begins and ends of connections that were passed; and the
    transactions decoded one by one, which the table has too."""
    made: list[NamedTransaction] = field(default_factory=list)
    """The transactions of unusual form, of those read as arrays; `records` has them, too."""


class BlockTables:
    """Makes the tables of the blocks of a capture that has no device profiles."""

    def __init__(self) -> None:
        self._plain = PlainTables()

    def batch(self, decoded: DecodedBlock) -> TransactionBatch:
        records = decoded.sorted_records()
        rows = [one for _, one in records if not isinstance(one, WireEvent)]
        if decoded.plain is None:
            return TransactionBatch(row_table(rows), [one for _, one in records])
        plain, made = self._plain.table(decoded.plain)
        if rows:
            places = [place for place, one in records if not isinstance(one, WireEvent)]
            order = np.concatenate([order_of(decoded.plain.response), places])
            both = pa.concat_tables([plain, row_table(rows)])
            plain = both.take(pa.array(np.argsort(order, kind="stable")))
        return TransactionBatch(plain, [*(one for _, one in records), *made], made)
