"""Finds in a block of a capture when the registers and bits that a poll reads or writes changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbtool.ledger.answered_reads import ValueChanges

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.columns.arrays import Int64s
    from mbtool.columns.plain_rows import PlainRows
    from mbtool.columns.usual_values import UsualValues


class BlockValues:
    """The values that the reads or writes of one poll bring. Implements ReadValues."""

    def __init__(self, rows: PlainRows, usual: UsualValues, places: Int64s) -> None:
        self._rows = rows
        self._usual = usual
        self._places = places

    def last(self) -> list[int]:
        return self._usual.values_of(self._places[-1:])

    def words(self) -> bytes:
        return self._usual.response_values(self._places).numbers.tobytes()

    def changes(self, before: Sequence[int] | None, place: int) -> ValueChanges:
        values = self._usual.value_of(self._places, place)
        has_changed = np.ones(len(values), np.bool_)
        has_changed[1:] = values[1:] != values[:-1]
        has_changed[0] = before is None or values[0] != before[place]
        rows = self._places[has_changed]
        return ValueChanges(
            rows.tolist(), self._rows.response_ns[rows].tolist(), values[has_changed].tolist()
        )
