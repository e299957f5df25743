"""Decides where a table shows link, master and unit: in headings, or in each row."""

# Each of the three is in the heading until it changes MANY_CHANGES times within FEW_ROWS rows; from
# then on each row has it. In a narrow table, addresses of one IPv4 network with 256 addresses are
# then shown by their last number: `.7` in the row, `10.0.0.*` in the heading. An address of another
# network is shown whole.

from __future__ import annotations

import re
from collections import deque
from typing import TYPE_CHECKING

from mbtool.core import WireEvent
from mbtool.views.table_options import TableColumn

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.devices import NamedTransaction

    Record = NamedTransaction | WireEvent
    Places = tuple[str, str, str]

MANY_CHANGES, FEW_ROWS = 3, 16
"""A link, master or unit that changes MANY_CHANGES times within FEW_ROWS rows gets a column, and
leaves the heading."""
PLACES = (TableColumn.LINK, TableColumn.MASTER, TableColumn.UNIT)
"""Link, master and unit are columns only if they change often; otherwise the heading has them."""
_IN_A_NETWORK = re.compile(r"(\d+\.\d+\.\d+)\.\d+(?::\d+)?")


class PlaceColumns:
    """Decides which of link, master and unit are columns: those that change often."""

    def __init__(self, *, is_narrow: bool = False) -> None:
        self.in_row: tuple[TableColumn, ...] = ()
        self._is_narrow = is_narrow
        self.networks: dict[TableColumn, str] = {}
        """The first three numbers of the addresses of a column, such as `10.0.0`."""
        self._last = ["", "", ""]
        self._count = 0
        self._changes: list[deque[int]] = [deque(maxlen=MANY_CHANGES) for _ in PLACES]
        """For each of link, master and unit: the numbers of the last rows in which it changed."""

    def decide(self, sample: Iterable[Places]) -> None:
        """Choose the columns for the first rows, before any of them is noted."""
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
        """Note the link, master and unit of the next row."""
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
        """The text of a link, master or unit in a row."""
        text = places[PLACES.index(column)]
        network = self.networks.get(column)
        if network is not None and text.startswith(f"{network}."):
            return text.removeprefix(network)
        return text

    def heading(self, record: NamedTransaction) -> str:
        """The heading's text: what the rows do not have of link, master and unit."""
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
        """Show the addresses of a column by their last number if all are of one network."""
        if self._is_narrow and (network := common_network(texts)) is not None:
            self.networks[column] = network


def common_network(texts: Iterable[str]) -> str | None:
    """The first three numbers of IPv4 addresses (`10.0.0`), or None if they are not of one network.

    Empty texts do not count.
    """
    found = [_IN_A_NETWORK.fullmatch(text) for text in texts if text]
    networks = {one and one[1] for one in found}
    return networks.pop() if len(networks) == 1 else None


def places_of(record: Record) -> Places:
    """The texts of link, master and unit; "" for those that an event does not have."""
    if isinstance(record, WireEvent):
        return record.link, "", ""
    return record.link, host_of(record.source), str(record.unit)


def host_of(address: str | None) -> str:
    """The host of an address with a port: fe80::1 of `[fe80::1]:502`; "" for None."""
    if address is None:
        return ""
    return address.rpartition(":")[0].strip("[]")
