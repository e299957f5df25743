"""Cuts the results of a block into portions, so that the values of one fit into little memory."""

# A block has at most 8 MiB of a file (packet_block.py). These hold at most 2.8 million registers,
# but 41 million coils, and each value takes up to 50 bytes while rows are made of it. So only a
# block with many coils or discrete inputs is cut.

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mbtool.columns.column_decoder import DecodedBlock, result_sort_keys
from mbtool.columns.usual_rows import WRITE_COILS
from mbtool.modbus.functions import READ_BITS

if TYPE_CHECKING:
    from mbtool.columns.arrays import Int64s
    from mbtool.columns.plain_rows import PlainRows

MOST_VALUES = 3 * 1024 * 1024
"""A portion has at most this many registers and bits, plus those of its last transaction."""


def portions(decoded: DecodedBlock) -> Iterator[DecodedBlock]:
    """Yield the transactions and events of a block in parts, in the order in which packets
    completed them; the block itself if its values are few.

    The first part has the connections that were read as a whole (`passed`).
    """
    rows = decoded.plain
    cuts = [] if rows is None else _cuts(rows)
    if rows is None or not cuts:
        yield decoded
        return
    records = decoded.sorted_records()
    keys = [key for key, _ in records]
    ends = [bisect_left(keys, key) for key in result_sort_keys(rows.response[cuts]).tolist()]
    passed = decoded.passed
    for (begin, end), (first, last) in zip(
        pairwise((0, *cuts, len(rows.response))), pairwise((0, *ends, len(records))), strict=True
    ):
        yield replace(
            decoded, plain=rows.part(begin, end), records=records[first:last], passed=passed
        )
        passed = None


def _cuts(rows: PlainRows) -> list[int]:
    """Return the index of the first row of each portion but the first."""
    counts = _most_values(rows)
    before = np.cumsum(counts) - counts
    cuts: list[int] = (np.flatnonzero(np.diff(before // MOST_VALUES)) + 1).tolist()
    return cuts


def _most_values(rows: PlainRows) -> Int64s:
    """Return for each row how many registers or bits its ADUs can hold."""
    sizes = rows.request_size + rows.response_size
    return np.where(np.isin(rows.code, [*READ_BITS, WRITE_COILS]), 8 * sizes, sizes // 2)
