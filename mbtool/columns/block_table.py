"""Makes a pyarrow table of the transactions in a block of packets, in the order in which packets
completed them.
"""

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
from mbtool.devices import NamedTransaction, Namer

if TYPE_CHECKING:
    from mbtool.columns.column_decoder import DecodedBlock


@dataclass(slots=True)
class TransactionBatch:
    """The transactions and events that were completed by the packets of a block."""

    table: pa.Table
    """All transactions, in the order in which packets completed them, with the columns of
    schema.py."""
    records: list[Record]
    """First the events and the transactions that the Decoder read packet by packet, in the order in
    which packets completed them; then the transactions of `made`. All these transactions are in
    `table`, too. The opening and closing events are missing for a connection that was read from
    arrays as a whole, from SYN to FIN."""
    made: list[NamedTransaction] = field(default_factory=list)
    """The transactions that were read from arrays but are not usual reads or writes
    (usual_rows.py), so that an object was made for each."""

    @property
    def row_count(self) -> int:
        """The number of transactions, for a progress bar."""
        return len(self.table)


class BlockTables:
    """Makes a pyarrow table of each block of a capture."""

    def __init__(self, namer: Namer | None = None) -> None:
        self._plain = PlainTables(namer or Namer())

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
