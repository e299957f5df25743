"""What the addresses of a register list mean: on the wire, counted from 1, or as references."""

# A cell is read into a Written: its number, the letters around it, and a bit. What the number means
# is decided for all of a list at once, from its data, and said aloud:
#
#   4x0012, HR12      the table stands in front; 4x0001 is address 0
#   0x0BB7, 0BB7H     hexadecimal: the address on the wire
#   40001, 300012     references, where every number of the list can be one and fits its table
#   12                on the wire, or counted from 1: where the heading says so, or the least is 1
#
# Where two columns have numbers (Schneider: an address and a register, which is one more) the
# smaller is the wire's, and the other is how the vendor writes it.

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from mbtool.devices.importing.cells import MAX_DIGITS
from mbtool.devices.model import Radix
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


class Counting(StrEnum):
    """What the numbers of a list are."""

    ZERO_BASED = "zero-based"
    ONE_BASED = "one-based"
    REFERENCES = "references"


@dataclass(frozen=True, slots=True)
class Written:
    """An address as a cell has it."""

    number: int
    prefix: str = ""
    suffix: str = ""
    radix: Radix = Radix.DECIMAL
    digits: int = 0
    """How many were written, where zeros fill them up."""
    bit: int | None = None
    last: int | None = None
    """Where the cell names a range."""

    @property
    def notation(self) -> tuple[str, str, Radix]:
        return self.prefix, self.suffix, self.radix


@dataclass(frozen=True, slots=True)
class Numbering:
    """How the numbers of one notation become addresses."""

    table: Table | None
    base: int
    """The number of address 0."""


_PREFIX_TABLES = {
    "hr": Table.HOLDING_REGISTERS, "ir": Table.INPUT_REGISTERS, "di": Table.DISCRETE_INPUTS,
    "4x": Table.HOLDING_REGISTERS, "3x": Table.INPUT_REGISTERS, "1x": Table.DISCRETE_INPUTS,
    "0x": Table.COILS, "co": Table.COILS, "coil": Table.COILS,
}  # fmt: skip
_REFERENCE_TABLES = {
    0: Table.COILS, 1: Table.DISCRETE_INPUTS, 3: Table.INPUT_REGISTERS, 4: Table.HOLDING_REGISTERS,
}  # fmt: skip

_BIT = r"(?:\s*(?:[.:]|\bbit\s*|\.b|\[)\s*(?:bit\s*)?(?P<bit>\d{1,2}|[A-Fa-f])\]?)?"
_LAST = r"(?:\s*(?:-|\u2013|\u2014|\.{2,3}|~|\u2026|\bto\b)\s*(?P<last>[0-9A-Fa-fxX]{1,10}?)[hH]?)?"
_HEX = re.compile(rf"(?:0[xX]|16#|\$|&[hH]|#[xX]?)(?P<number>[0-9A-Fa-f]{{1,6}}){_LAST}{_BIT}")
_HEX_H = re.compile(rf"(?P<number>[0-9A-Fa-f]{{1,6}})[hH]{_LAST}{_BIT}")
_BARE_HEX = re.compile(rf"(?P<number>[0-9A-Fa-f]{{1,6}}){_LAST}{_BIT}")
_DECIMAL = re.compile(rf"(?P<number>\d{{1,{MAX_DIGITS}}}){_LAST}{_BIT}")
_LETTERS = re.compile(
    rf"(?P<prefix>[0134][xX]|[%A-Za-z][A-Za-z_ %]{{0,11}}?)\s*[:#-]?\s*"
    rf"(?P<number>\d{{1,{MAX_DIGITS}}}){_LAST}{_BIT}"
)


def has_tables_in_front(cells: Iterable[str]) -> bool:
    """Whether a list writes 4x0001: then its 0x0001 is a coil, and no hexadecimal number."""
    return any(re.match(r"\s*[134][xX]", cell) for cell in cells)


def is_bare_hex(cells: Iterable[str]) -> bool:
    """Whether a list writes 0BB7 without a sign that it is hexadecimal."""
    found = False
    for cell in cells:
        text = cell.strip()
        if not re.fullmatch(r"[0-9A-Fa-f]{1,6}", text):
            return False
        # One letter alone in front of digits is more likely a name: D100.
        found = found or bool(re.search(r"\d[A-Fa-f]|[A-Fa-f]{2}", text))
    return found


def parse_address(
    text: str, *, bare_hex: bool = False, tables_in_front: bool = False
) -> Written | None:
    """Read a cell; the flags are those of the whole column. None for what is no address."""
    text = " ".join(text.replace("\u00a0", " ").split()).removesuffix(".")
    if len(text) > 40:
        return None
    listed = re.fullmatch(r"\d{1,6}(?:, ?\d{1,6}){1,3}", text)
    if listed:
        numbers = [int(one) for one in text.split(",")]
        if numbers != list(range(numbers[0], numbers[0] + len(numbers))):
            return None
        text = f"{text.partition(',')[0]}-{numbers[-1]}"
    if bare_hex:
        return _hexadecimal(_BARE_HEX.fullmatch(text), "", "")
    if not (tables_in_front and re.match(r"0[xX]", text)):
        match = _HEX.fullmatch(text)
        if match:
            return _hexadecimal(match, "0x", "")
        match = _HEX_H.fullmatch(text)
        if match:
            return _hexadecimal(match, "", "H")
    match = _DECIMAL.fullmatch(text)
    if match:
        return _decimal(match, "")
    match = _LETTERS.fullmatch(text)
    return _decimal(match, match["prefix"].strip()) if match else None


def _hexadecimal(match: re.Match[str] | None, prefix: str, suffix: str) -> Written | None:
    if match is None:
        return None
    last = re.sub(r"^0[xX]", "", match["last"]) if match["last"] else None
    if last is not None and not re.fullmatch("[0-9A-Fa-f]+", last):
        return None
    return _written(
        match,
        number=int(match["number"], 16),
        prefix=prefix,
        suffix=suffix,
        radix=Radix.HEX,
        last=int(last, 16) if last else None,
    )


def _decimal(match: re.Match[str], prefix: str) -> Written | None:
    last = match["last"]
    if last is not None and not last.isdecimal():
        return None
    number = int(match["number"])
    end = int(last) if last else None
    if end is not None and end < number and len(str(last)) < len(match["number"]):
        # 40001-2: the end has only the digits that differ.
        end = int(match["number"][: -len(str(last))] + str(last))
    return _written(match, number=number, prefix=prefix, suffix="", radix=Radix.DECIMAL, last=end)


def _written(match: re.Match[str], **fields: object) -> Written | None:
    bit = match["bit"]
    number = None if bit is None else int(bit, 16 if bit.isalpha() else 10)
    written = Written(digits=len(match["number"]), bit=number, **fields)  # type: ignore[arg-type]
    if written.last is not None and not written.number <= written.last <= written.number + 255:
        return None
    return written


def without_false_bits(addresses: Sequence[Written | None]) -> list[Written | None]:
    """40001.0 is a spreadsheet's 40001 where every number of the column ends so."""
    known = [one for one in addresses if one is not None]
    if known and all(one.bit == 0 and one.radix is Radix.DECIMAL for one in known):
        return [one if one is None else replace(one, bit=None) for one in addresses]
    return list(addresses)


def decide(
    addresses: Sequence[tuple[Written, Table | None]],
    hint: str,
    counting: Counting | None,
) -> tuple[Counting, str]:
    """What plain decimal numbers are, and why; `hint` is the heading, in lower case."""
    numbers = [written.number for written, _ in addresses]
    least, most = min(numbers), max(numbers)
    if counting is not None:
        return counting, "you said so"
    if all(_is_reference(written, table) for written, table in addresses):
        return Counting.REFERENCES, f"every one of {least}..{most} can be a reference"
    if re.search(r"\b(?:0|zero) ?based|\bpdu\b|\bprotocol\b|\bwire\b", hint):
        return Counting.ZERO_BASED, "the heading says so"
    if least == 0:
        return Counting.ZERO_BASED, "one of them is 0"
    if re.search(r"\b(?:1|one) ?based", hint):
        return Counting.ONE_BASED, "the heading says so"
    if least == 1:
        return Counting.ONE_BASED, "the least is 1"
    return Counting.ZERO_BASED, "nothing says otherwise"


def _is_reference(written: Written, table: Table | None) -> bool:
    implied = reference_table(written.number, written.digits)
    return implied is not None and table in (None, implied)


def reference_table(number: int, digits: int) -> Table | None:
    """The table of a reference of five or six digits: 40001, 300012, 00001."""
    if digits not in (5, 6):
        return None
    leading, rest = divmod(number, 10 ** (digits - 1))
    if not 1 <= rest <= 1 << 16:
        return None
    return _REFERENCE_TABLES.get(leading)


def numbering(written: Written, counting: Counting, table: Table | None) -> Numbering:
    """How the notation of one address counts; `counting` is that of plain decimal numbers."""
    in_front = (
        _PREFIX_TABLES.get(written.prefix.lower()) if written.radix is Radix.DECIMAL else None
    )
    if written.prefix[:1].isdigit() and written.radix is Radix.DECIMAL:
        return Numbering(in_front, 1)
    if written.radix is Radix.HEX:
        return Numbering(in_front or table, 0)
    if counting is Counting.REFERENCES and not written.prefix:
        digits = max(written.digits, 5)
        implied = reference_table(written.number, digits) or table
        leading = written.number // 10 ** (digits - 1)
        return Numbering(implied, leading * 10 ** (digits - 1) + 1)
    return Numbering(in_front or table, int(counting is Counting.ONE_BASED))


@dataclass(frozen=True, slots=True)
class ColumnPair:
    """What two columns of addresses say together."""

    base: int
    """The wire's number of address 0: 0, or 1 where it counts from 1."""
    wire_is_first: bool
    difference: int
    """The second number less the first, without the ten thousands that stand for a table."""


def pair(numbers: Sequence[tuple[int, int]]) -> ColumnPair | None:
    """How two columns of numbers belong together; None where they do not, or are the same."""
    if not numbers or all(first == second for first, second in numbers):
        return None
    differences = Counter(difference_of(*each) for each in numbers)
    ((difference, count),) = differences.most_common(1)
    if 2 * count <= len(numbers) or abs(difference) > 1:
        return None
    # 40001 beside 0, or 1 more: the smaller is the wire's. 40001 beside 1: both count from 1.
    smaller_first = sum(first < second for first, second in numbers)
    return ColumnPair(int(difference == 0), 2 * smaller_first > len(numbers), difference)


def difference_of(first: int, second: int) -> int:
    """How far two numbers are apart but for their tables: -4999 to 5000."""
    return (second - first + 4_999) % 10_000 - 4_999
