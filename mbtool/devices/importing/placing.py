"""Gives each row of a register list its table, its address on the wire and its notation."""

# A row's table is what its number says (4x0001, HR1, 40001), else its own column or the heading
# above it, else what the user says; where none of them tells, registers are holding registers, and
# a yes or no is a coil. What number and row say must agree.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices.importing.addresses import (
    ColumnPair,
    Counting,
    Numbering,
    Written,
    decide,
    difference_of,
    numbering,
    pair,
)
from mbtool.devices.importing.layout import Notation, PlacedRow
from mbtool.devices.importing.rows import Scaling
from mbtool.devices.model import Access, Radix
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.devices.importing.columns import Column
    from mbtool.devices.importing.rows import Complaints, Item


_READ_WRITE = 0x17


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """What the user knows better than the list tells."""

    counting: Counting | None = None
    table: Table | None = None
    scaling: Scaling | None = None


class Placer:
    """Places the rows of one list."""

    def __init__(
        self,
        items: Sequence[Item],
        column: Column,
        options: ImportOptions,
        complaints: Complaints,
    ) -> None:
        self._items = items
        self._column = column
        self._options = options
        self._complaints = complaints
        self._widths = _widths(items)
        self._guessed: set[Table] = set()
        self.remarks: list[str] = []
        self._pairing = self._pair()
        self._plain = self._counting(
            [one for one in items if not _has_letters(one.written) and _is_decimal(one.written)]
        )
        self._lettered = self._counting(
            [one for one in items if _has_letters(one.written) and _is_decimal(one.written)]
        )

    def place_all(self) -> list[PlacedRow]:
        """The rows that have a place; the others are complaints."""
        placed = [one for item in self._items if (one := self._place(item)) is not None]
        self.remarks += [
            f"rows that name no table are taken as {table} (--table says otherwise)"
            for table in sorted(self._guessed)
        ]
        if any(one.access is Access.READ_WRITE and _says_no_access(one.item) for one in placed):
            self.remarks.append("what the list does not call read-only is taken as read and write")
        return placed

    def _pair(self) -> ColumnPair | None:
        numbers = [
            (item.written.number, item.other.number)
            for item in self._items
            if item.other is not None
        ]
        if self._options.counting is not None:
            return None
        pairing = pair(numbers)
        if pairing is not None:
            first = next(item for item in self._items if item.other is not None)
            assert first.other is not None
            wire, shown = _in_order(first.written, first.other, pairing)
            self.remarks.append(
                f"two columns have addresses: {shown.number} in the one is "
                f"{wire.number} in the other, so address {wire.number - pairing.base} on the wire"
            )
        elif any(first != second for first, second in numbers):
            self.remarks.append(
                f'the addresses are those of "{self._column.heading}"; the other column of '
                "numbers does not go with it, and is not used"
            )
        return pairing

    def _counting(self, items: Sequence[Item]) -> Counting:
        """How the decimal numbers of one kind count."""
        loose = [item for item in items if self._pairing is None or item.other is None]
        if not loose or _has_table(loose[0].written):
            return Counting.ZERO_BASED
        numbers = [(item.written, self._said_table(item)) for item in loose]
        counting, why = decide(numbers, self._column.hint, self._options.counting)
        if counting is Counting.REFERENCES and loose[0].written.prefix:
            counting = Counting.ZERO_BASED
        first = loose[0].written
        address = first.number - numbering(first, counting, None).base
        if self._pairing is None:
            self.remarks.append(
                f'the numbers of "{self._column.heading}" are {counting}, since {why}: '
                f"{first.prefix}{first.number} is address {address} on the wire "
                "(--addresses says otherwise)"
            )
        return counting

    def _said_table(self, item: Item) -> Table | None:
        return item.reach.table if item.reach is not None else self._options.table

    def _place(self, item: Item) -> PlacedRow | None:
        shown, address, how = self._address(item)
        if not 0 <= address <= 0xFFFF:
            problem = f"would be address {address} on the wire; addresses are 0 to 65535"
            self._complain(item, problem)
            return None
        said = self._said_table(item)
        if how.table is not None and said is not None and how.table is not said:
            self._complain(item, f"is in {how.table} by its number, but in {said} by its row")
            return None
        table = how.table or said or self._guess(item)
        if not table.is_writable and item.access not in (None, Access.READ):
            self._complain(
                item, f"is in {table}, which cannot be written, but its row says {item.access}"
            )
            return None
        notation = self._notation(shown, address)
        return PlacedRow(item, table, address, notation, item.access or _usual_access(item, table))

    def _complain(self, item: Item, problem: str) -> None:
        written = item.written
        text = f"{written.prefix}{written.radix.write(written.number)}{written.suffix}"
        self._complaints.add(item.row, self._column, text, problem)

    def _address(self, item: Item) -> tuple[Written, int, Numbering]:
        """How the vendor writes it, the address on the wire, and what its number says."""
        said, pairing = self._said_table(item), self._pairing
        if pairing is None or item.other is None:
            counting = self._lettered if _has_letters(item.written) else self._plain
            how = numbering(item.written, counting, said)
            return item.written, item.written.number - how.base, how
        if difference_of(item.written.number, item.other.number) != pairing.difference:
            self._complain(item, f"and {item.other.number} do not go together as in other rows")
        wire, shown = _in_order(item.written, item.other, pairing)
        is_reference = shown.digits in (5, 6) and shown.number - wire.number >= 9_999
        counting = Counting.REFERENCES if is_reference else Counting.ZERO_BASED
        return shown, wire.number - pairing.base, numbering(shown, counting, said)

    def _notation(self, shown: Written, address: int) -> Notation:
        base = shown.number - address
        if not -0xFFFF <= base <= 1_000_000:
            return "", 0, Radix.DECIMAL, 0, ""
        return shown.prefix, base, shown.radix, self._widths.get(shown.notation, 0), shown.suffix

    def _guess(self, item: Item) -> Table:
        table = Table.HOLDING_REGISTERS
        if item.kind is not None and item.kind.is_switch and item.written.bit is None:
            table = Table.DISCRETE_INPUTS if item.access is Access.READ else Table.COILS
        self._guessed.add(table)
        return table


def _in_order(first: Written, second: Written, pairing: ColumnPair) -> tuple[Written, Written]:
    """The wire's, and the vendor's."""
    return (first, second) if pairing.wire_is_first else (second, first)


def _is_decimal(written: Written) -> bool:
    return written.radix is Radix.DECIMAL


def _has_letters(written: Written) -> bool:
    return bool(written.prefix) and _is_decimal(written)


def _has_table(written: Written) -> bool:
    """4x0001 counts from 1, whatever the others do."""
    return written.prefix[:1].isdigit()


def _says_no_access(item: Item) -> bool:
    return item.access is None and (item.reach is None or not item.reach.functions)


def _usual_access(item: Item, table: Table) -> Access:
    """What a row may be used for that does not say it: by its functions, else its table."""
    functions = item.reach.functions if item.reach is not None else ()
    if not table.is_writable:
        return Access.READ
    reads = not functions or any(
        not FUNCTIONS[code].writes or code == _READ_WRITE for code in functions
    )
    writes = not functions or any(FUNCTIONS[code].writes for code in functions)
    if reads and writes:
        return Access.READ_WRITE
    return Access.READ if reads else Access.WRITE


def _widths(items: Iterable[Item]) -> dict[tuple[str, str, Radix], int]:
    """How many digits each notation has, where all of a list have as many."""
    digits: dict[tuple[str, str, Radix], set[int]] = {}
    for item in items:
        for written in (item.written, item.other):
            if written is not None:
                digits.setdefault(written.notation, set()).add(written.digits)
    return {
        notation: widths.pop()
        for notation, widths in digits.items()
        if len(widths) == 1 and (notation[0] or notation[1] or notation[2] is Radix.HEX)
    }
