"""Makes an object of each transaction that was read from arrays, for callers that cannot work on
arrays.
"""

# Measured: reading packets as arrays and making an object of each transaction takes about a third
# of the time that the Decoder needs for the same packets.

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.column_decoder import order_of
from mbtool.columns.plain_transactions import plain_transaction

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.decode.decoder import Record
    from mbtool.devices import Namer


def plain_records(decoded: DecodedBlock, namer: Namer) -> Iterator[Record]:
    """Yield the transactions and events of a block as objects, equal to those that the Decoder
    gives if it is fed all packets, and in the same order. `namer` adds the names to transactions.
    """
    records = decoded.sorted_records(with_passed=True)
    rows = decoded.plain
    if rows is None:
        yield from (record for _, record in records)
        return
    places = np.searchsorted(order_of(rows.response), [place for place, _ in records]).tolist()
    begin = 0
    for end, (_, record) in zip(places, records, strict=True):
        yield from _transactions(rows, begin, end, namer)
        yield record
        begin = end
    yield from _transactions(rows, begin, len(rows.response), namer)


def _transactions(rows: PlainRows, begin: int, end: int, namer: Namer) -> Iterator[Record]:
    for index in range(begin, end):
        yield namer.name(plain_transaction(rows, index))
