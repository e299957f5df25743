"""Reads the addresses in a register list, and decides how they are counted."""

# Ways in which a list writes addresses, and how each is read:
#
#   4x0012, HR12      the text before the number names the table; 4x0001 is address 0
#   0x0BB7, 0BB7H     hexadecimal: the address on the wire
#   40001, 300012     references, if every number of the list can be one and fits its table
#   12                the address on the wire, or a number counted from 1

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from mbtool.devices.importing.cells import MAX_DIGITS, is_nothing
from mbtool.devices.importing.options import AddressStyle, ImportReport
from mbtool.devices.model import Radix
from mbtool.modbus.tables import DIGIT_TABLES, Table

_PREFIX_TABLES = {
    "hr": Table.HOLDING_REGISTERS, "ir": Table.INPUT_REGISTERS, "di": Table.DISCRETE_INPUTS,
    "co": Table.COILS, "coil": Table.COILS,
    **{f"{digit}x": table for digit, table in DIGIT_TABLES.items()},
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class AddressCell:
    """An address as a cell of a register list writes it."""

    number: int
    prefix: str = ""
    suffix: str = ""
    radix: Radix = Radix.DECIMAL
    digits: int = 0
    """The number of digits in the cell, counting leading zeros."""
    bit: int | None = None
    """The bit of the register that the cell names, 3 in `40001.3`; None if it names none."""
    last: int | None = None
    """The last number of a range, 40004 in `40001-40004`; None if the cell has no range."""
    text: str = field(default="", compare=False)
    """The whole text of the cell."""

    @property
    def registers(self) -> int | None:
        """Number of registers in the range; None if the cell has no range."""
        return None if self.last is None else self.last - self.number + 1

    @property
    def table(self) -> Table | None:
        """The table that the text before the number names (HR, 4x); None if it names none."""
        return _PREFIX_TABLES.get(self.prefix.lower()) if self.is_decimal else None

    @property
    def notation(self) -> tuple[str, Radix, str]:
        return self.prefix, self.radix, self.suffix

    @property
    def is_decimal(self) -> bool:
        return self.radix is Radix.DECIMAL

    @property
    def counts_from_1_always(self) -> bool:
        """True if a table's digit and an x come before the number, as in 4x0001.

        Such numbers count from 1, even if other addresses in the list count from 0.
        """
        return self.is_decimal and self.prefix[:1].isdigit()


_BIT = r"(?:\s*(?:[.:]|\bbit\s*|\.b|\[)\s*(?:bit\s*)?(?P<bit>\d{1,2}|[A-Fa-f])\]?)?"
_LAST = r"(?:\s*(?:-|\u2013|\u2014|\.{2,3}|~|\u2026|\bto\b|\bbis\b)\s*(?P<last>(?:0[xX])?[0-9A-Fa-f]{1,8}?)[hH]?)?"  # noqa: E501
_HEX = re.compile(
    r"(?P<sign>0[xX]|16#|\$|&[hH]|#[xX]?)?(?P<number>[0-9A-Fa-f]{1,6})"
    rf"(?P<suffix>[hH])?{_LAST}{_BIT}"
)
_DECIMAL = re.compile(
    r"(?:(?P<prefix>[0134][xX]|[%A-Za-z][A-Za-z_ %]{0,11}?)\s*[:#-]?\s*)?"
    rf"(?P<number>\d{{1,{MAX_DIGITS}}}){_LAST}{_BIT}"
)


def read_addresses(
    cells: Sequence[str], heading: str, style: AddressStyle | None, report: ImportReport
) -> list[AddressCell | None]:
    """Read the cells of the address column. The result has an element per cell, None for a cell
    without an address.

    `heading` is the column's heading in lower case (columns.fold()). `style` is how the user says
    that numbers are counted; None if the user does not say it. Adds remarks on guesses to `report`.
    """
    is_hex = style is AddressStyle.HEXADECIMAL or (style is None and _is_bare_hex(cells, heading))
    in_front = any(re.match(r"\s*[134][xX]", cell) for cell in cells)
    addresses = [parse_address(one, bare_hex=is_hex, tables_in_front=in_front) for one in cells]
    known = [one for one in addresses if one is not None]
    if is_hex and style is None:
        report.tell(
            f"addresses are hexadecimal, as letters in them or the heading show: {known[0].text} "
            f"is address {known[0].number} on the wire (--addresses says otherwise)"
        )
    if any(one.prefix in ("0x", "0X") and one.is_decimal for one in known):
        report.tell("0x0001 and its like are coils, as other addresses begin with 4x or 3x")
    if known and all(one.bit == 0 and one.is_decimal for one in known):
        report.tell("addresses end in .0, which a spreadsheet adds, as all of them do")
        return [one and replace(one, bit=None) for one in addresses]
    return addresses


def _is_bare_hex(cells: Sequence[str], heading: str) -> bool:
    """True if the addresses in `cells` are hexadecimal numbers without a mark such as 0x or H:
    `0BB7`.

    `heading` is the column's heading in lower case.
    """
    there = [cell.strip() for cell in cells if not is_nothing(cell)]
    if not there or not all(re.fullmatch(r"[0-9A-Fa-f]{1,6}", one) for one in there):
        return False
    # A single letter before digits, as in D100, is probably a vendor's prefix, not a hexadecimal
    # digit. So look for a letter after a digit, or two letters.
    letters = any(re.search(r"\d[A-Fa-f]|[A-Fa-f]{2}", one) for one in there)
    return letters or bool(re.search(r"\bhex", heading))


def parse_address(
    text: str, *, bare_hex: bool = False, tables_in_front: bool = False
) -> AddressCell | None:
    """Read the address in a cell; None if the cell holds none.

    `bare_hex` is True if digits without a mark such as 0x or H are hexadecimal. `tables_in_front`
    is True if the column also has addresses like 4x0001; then 0x0001 is a coil, not hexadecimal.
    """
    text = " ".join(text.replace("\u00a0", " ").split()).removesuffix(".")
    if len(text) > 40:
        return None
    if re.fullmatch(r"\d{1,6}(?:, ?\d{1,6}){1,3}", text):
        numbers = [int(one) for one in text.split(",")]
        if numbers != list(range(numbers[0], numbers[0] + len(numbers))):
            return None
        text = f"{text.partition(',')[0]}-{numbers[-1]}"
    is_coil = tables_in_front and re.match(r"0[xX]", text)
    match = _HEX.fullmatch(text)
    if match and not is_coil and (bare_hex or match["sign"] or match["suffix"]):
        prefix, suffix = "0x" if match["sign"] else "", "H" if match["suffix"] else ""
        return _address(match, prefix, suffix, Radix.HEX)
    match = None if bare_hex else _DECIMAL.fullmatch(text)
    return match and _address(match, (match["prefix"] or "").strip(), "", Radix.DECIMAL)


def _address(match: re.Match[str], prefix: str, suffix: str, radix: Radix) -> AddressCell | None:
    bit, first = match["bit"], match["number"]
    last = (match["last"] or "").upper().removeprefix("0X")
    try:
        number = int(first, 16) if radix is Radix.HEX else int(first)
        # The last number of a range may be shortened: `40001-2` is 40001 to 40002. So try two
        # numbers: the one in the cell, and the same with the leading digits of the first number.
        whole = first[: max(len(first) - len(last), 0)] + last
        ends = [int(one, 16) if radix is Radix.HEX else int(one) for one in (last, whole) if last]
    except ValueError:
        return None
    end = next((one for one in ends if number <= one <= number + 255), None)
    if ends and end is None:
        return None
    of_bit = None if bit is None else int(bit, 16 if bit.isalpha() else 10)
    return AddressCell(number, prefix, suffix, radix, len(first), of_bit, end, match[0])


def decide_style(
    addresses: Sequence[tuple[AddressCell, Table | None]], heading: str
) -> tuple[AddressStyle, str]:
    """Decide how the decimal numbers of a list are counted. Returns the style and a reason as text.

    Each address comes with the table that its row names, or None. `heading` is the heading of the
    address column in lower case (columns.fold()).
    """
    numbers = [address.number for address, _ in addresses]
    least, most = min(numbers), max(numbers)
    if all(_can_be_reference(address, table) for address, table in addresses):
        span = f"every one of {least}..{most}" if most > least else f"{least}"
        return AddressStyle.REFERENCES, f"{span} can be one"
    if re.search(r"\b(?:0|zero) ?based|\bpdu\b|\bprotocol\b|\bwire\b", heading):
        return AddressStyle.ZERO_BASED, "the heading says so"
    if least == 0:
        return AddressStyle.ZERO_BASED, "one of them is 0"
    if re.search(r"\b(?:1|one) ?based", heading):
        return AddressStyle.ONE_BASED, "the heading says so"
    if least == 1:
        return AddressStyle.ONE_BASED, "the least is 1"
    return AddressStyle.ZERO_BASED, "nothing says otherwise"


def _can_be_reference(address: AddressCell, table: Table | None) -> bool:
    implied = reference_table(address.number, address.digits)
    named = {one for one in (table, address.table) if one is not None}
    is_letters_only = bool(address.prefix) and address.table is None
    return implied is not None and named <= {implied} and not is_letters_only


def reference_table(number: int, digits: int) -> Table | None:
    """Return the table that the first digit of a five- or six-digit reference names: 40001, 300012.

    `digits` is the number of digits with which the list writes `number`. None if `number` is no
    such reference.
    """
    if digits not in (5, 6):
        return None
    leading, rest = divmod(number, 10 ** (digits - 1))
    return DIGIT_TABLES.get(str(leading)) if 1 <= rest <= 1 << 16 else None


def table_and_base(address: AddressCell, style: AddressStyle) -> tuple[Table | None, int]:
    """Return the table that an address names (None if it names none), and the number that the list
    writes for address 0 on the wire, such as 40001.

    `style` says how decimal numbers are counted. If they are references, raises ValueError for an
    address that is no reference.
    """
    if not address.is_decimal:
        return None, 0
    if address.counts_from_1_always:
        return address.table, 1
    if style is not AddressStyle.REFERENCES:
        return address.table, int(style is AddressStyle.ONE_BASED)
    # Spreadsheets remove leading zeros: the reference 00001 becomes 1. So read a number of fewer
    # than five digits as one of five.
    digits = max(address.digits, 5)
    table = reference_table(address.number, digits)
    if table is None:
        raise ValueError("is no reference, as 1, 10001, 30001 and 400001 are")
    return table, address.number // 10 ** (digits - 1) * 10 ** (digits - 1) + 1
