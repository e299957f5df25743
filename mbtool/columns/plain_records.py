"""Makes an object of each transaction that was read from arrays, for callers that cannot work on
arrays.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.poll_runs import items_in_packet_order

if TYPE_CHECKING:
    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.columns.plain_transactions import PlainObjects
    from mbtool.decode.decoder import Record


def plain_records(decoded: DecodedBlock, objects: PlainObjects) -> Iterator[Record]:
    """Yield the transactions and events of a block as objects, equal to those that the Decoder
    gives if it is fed all packets, and in the same order.
    """
    records = decoded.sorted_records(with_passed=True)
    rows = decoded.plain
    if rows is None:
        yield from (record for _, record in records)
        return
    some, every = objects.of(rows).some, np.ones(len(rows.response), np.bool_)
    yield from items_in_packet_order(rows, every, records, some, some)
