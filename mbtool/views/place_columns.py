"""Decides where a table shows link, master and unit: in its headings, or in each row."""

# Link, master and unit are shown in the heading at first. When one of them changes MANY_CHANGES
# times within FEW_ROWS rows, each later row has it as a column. In a narrow table, a column with
# addresses of one IPv4 /24 network shows only the last number: `.7` in the row, `10.0.0.*` in the
# heading. It shows addresses of other networks whole.

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.core.moments import host_of
from mbtool.views.table_options import TableColumn

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

    Record = NamedTransaction | WireEvent
    Places = tuple[str, str, str]

MANY_CHANGES, FEW_ROWS = 3, 16
"""A link, master or unit that changes MANY_CHANGES times within FEW_ROWS rows becomes a column, and
is no longer in the heading."""
PLACES = (TableColumn.LINK, TableColumn.MASTER, TableColumn.UNIT)
"""Link, master and unit become columns only if they change often; until then the heading has
them."""
_IN_A_NETWORK = re.compile(r"(\d+\.\d+\.\d+)\.\d+(?::\d+)?")


class PlaceColumns:
    """Decides which of link, master and unit are columns of a table: those that change often."""

    def __init__(self, *, is_narrow: bool = False) -> None:
        self.in_row: tuple[TableColumn, ...] = ()
        self._is_narrow = is_narrow
        self.networks: dict[TableColumn, str] = {}
        """The first three numbers of the IPv4 addresses in a shortened column, such as `10.0.0`."""
        self._last = ["", "", ""]
        self._count = 0
        self._changes: list[deque[int]] = [deque(maxlen=MANY_CHANGES) for _ in PLACES]
        """For each of link, master and unit: the last MANY_CHANGES rows that differed in it from
        the row before, by their number from 1."""

    def decide(self, sample: Iterable[Places]) -> None:
        """Choose which of link, master and unit are columns at the begin of a table.

        `sample` has link, master and unit of the first rows, which are examined before any is
        printed.
        """
        trial = PlaceColumns()
        seen: list[set[str]] = [set() for _ in PLACES]
        for places in sample:
            trial.note(places)
            for texts, text in zip(seen, places, strict=True):
                texts.add(text)
        self.in_row = trial.in_row
        for column, texts in zip(PLACES, seen, strict=True):
            if column in self.in_row:
                self._shorten(column, texts)

    def note(self, places: Places) -> None:
        """Note the link, master and unit of the next row.

        One of them becomes a column from this row on if it now changes often (MANY_CHANGES).
        """
        self._count += 1
        for index, text in enumerate(places):
            last = self._last[index]
            if not text or text == last:
                continue
            self._last[index] = text
            changes = self._changes[index]
            changes.append(self._count)
            is_often = len(changes) == MANY_CHANGES and self._count - changes[0] < FEW_ROWS
            column = PLACES[index]
            if is_often and column not in self.in_row:
                self.in_row = tuple(one for one in PLACES if one in self.in_row or one is column)
                self._shorten(column, (last, text))

    def cell(self, column: TableColumn, places: Places) -> str:
        """Return the text of the link, master or unit in a row.

        In a shortened column it is the last number of the address, such as `.7`.
        """
        text = places[PLACES.index(column)]
        network = self.networks.get(column)
        if network is not None and text.startswith(f"{network}."):
            return text.removeprefix(network)
        return text

    def heading(self, record: NamedTransaction) -> str:
        """Return the heading of the next rows, beginning with `record`.

        It has link, master and unit, except those that are columns. For a shortened column it has
        the part that all addresses share: `master 10.0.0.*`.
        """
        link, master, unit = self._last
        parts = []
        if TableColumn.LINK not in self.in_row:
            parts.append(f"{record.transport} {link}")
        elif TableColumn.LINK in self.networks:
            parts.append(f"link {self.networks[TableColumn.LINK]}.*")
        if master and TableColumn.MASTER not in self.in_row:
            parts.append(f"master {master}")
        elif TableColumn.MASTER in self.networks:
            parts.append(f"master {self.networks[TableColumn.MASTER]}.*")
        if unit and TableColumn.UNIT not in self.in_row:
            parts.append(f"unit {unit} {record.device or ''}".rstrip())
        return ", ".join(parts)

    def _shorten(self, column: TableColumn, texts: Iterable[str]) -> None:
        """If the table is narrow and all addresses of a column are in one IPv4 network (their first
        three numbers are equal), show only the last number of each.
        """
        if self._is_narrow and (network := common_network(texts)) is not None:
            self.networks[column] = network


def common_network(texts: Iterable[str]) -> str | None:
    """Return the first three numbers that IPv4 addresses share (`10.0.0`); None if they differ.

    Empty texts are ignored; a text that is no IPv4 address gives None, too.
    """
    found = [_IN_A_NETWORK.fullmatch(text) for text in texts if text]
    networks = {one and one[1] for one in found}
    return networks.pop() if len(networks) == 1 else None


def places_of(record: Record) -> Places:
    """Return link, master and unit as texts. An event has no master and unit: both are ""."""
    if isinstance(record, WireEvent):
        return record.link, "", ""
    return record.link, host_of(record.source), str(record.unit)
