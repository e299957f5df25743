"""The data model of a device profile: what a vendor's manual says about a device."""

# The keys of a profile file (docs/devices.md) are the fields of these classes, one to one. The
# description of a field is shown in the JSON Schema (schema.py) and in messages about missing keys.
# Rules between several keys (areas that overlap, points outside their area) are checked in
# validation.py. loading.py reads files and merges a profile with the one that it extends.

from __future__ import annotations

from bisect import bisect_right
from enum import StrEnum
from functools import cached_property
from itertools import product
from typing import Annotated

import msgspec
from msgspec import Meta

from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.modbus.adu import Transport
from mbtool.modbus.functions import READ_LIMIT, exception_name
from mbtool.modbus.tables import Table

Address = Annotated[int, Meta(ge=0, le=0xFFFF)]
Word = Annotated[int, Meta(ge=0, le=0xFFFF)]
Quantity = Annotated[int, Meta(ge=1, le=0xFFFF)]
ExceptionCode = Annotated[int, Meta(ge=1, le=0xFF)]


def _about(description: str) -> Meta:
    """Describe a field of a profile, for the JSON Schema and for messages about missing keys."""
    return Meta(description=description)


Texts = dict[int, str]
"""Texts by number. The number is a value and the text its meaning, or the number is a bit and the
text its name."""

WORD_BITS = 16


class Radix(StrEnum):
    """The number system in which a vendor writes addresses, as in HR400001 or X1F."""

    DECIMAL = "decimal"
    HEX = "hex"
    OCTAL_DIGIT = "octal-digit"
    """The last digit is octal, those before it are decimal: M7, M10, ..., M97, M100."""

    def write(self, number: int) -> str:
        match self:
            case Radix.DECIMAL:
                return str(number)
            case Radix.HEX:
                return f"{number:X}"
            case Radix.OCTAL_DIGIT:
                return f"{number // 8 or ''}{number % 8}"

    def read(self, digits: str) -> int:
        """Read digits in this number system: the inverse of `write`.

        Raises ValueError if the digits are no number in this system.
        """
        valid = "0123456789ABCDEF" if self is Radix.HEX else "0123456789"
        last = "01234567" if self is Radix.OCTAL_DIGIT else valid
        if not digits or not set(digits) <= set(valid) or digits[-1] not in last:
            raise ValueError(f"{digits!r} is no {self} number")
        if self is not Radix.OCTAL_DIGIT:
            return int(digits, 16 if self is Radix.HEX else 10)
        return int(digits[:-1] or "0") * 8 + int(digits[-1])


class Access(StrEnum):
    """The access that a master has to an area or a point: read, write or both."""

    READ = "r"
    READ_WRITE = "rw"
    WRITE = "w"

    def allows(self, *, writing: bool) -> bool:
        return self is not (Access.READ if writing else Access.WRITE)


class BehaviourName(StrEnum):
    """A device family with behaviour that profile data cannot express.

    The embedded slave imitates the behaviour, and `check` has rules for it.
    """

    FA3 = "fa3"
    LT830 = "lt830"
    WAGO = "wago"


class _Part(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Base class of the parts of a profile. A key that is no field of the part is an error."""


class Area(_Part, frozen=True, kw_only=True):
    """A range of addresses of the device, and how its manual writes these addresses."""

    name: Annotated[str, _about("The manual's name for the area.")]
    table: Annotated[Table, _about("One of the four tables of the data model.")]
    first: Annotated[Address, _about("First address on the wire, 0-based.")]
    last: Annotated[Address, _about("Last address on the wire, inclusive.")]
    access: Annotated[Access, _about("What a master may do: read r, write w, both rw.")]
    prefix: Annotated[str, _about("Text before the number: HR in HR400001.")] = ""
    base: Annotated[
        int,
        Meta(ge=-0xFFFF, le=1_000_000),
        _about(
            "The manual's number for address 0: written number = base + address.\n\n"
            "Negative if the manual counts from 0 in an area that begins at a higher address."
        ),
    ] = 0
    radix: Annotated[Radix, _about("How the number is written.")] = Radix.DECIMAL
    width: Annotated[
        int, Meta(ge=0, le=8), _about("Least number of digits; shorter ones get zeros.")
    ] = 0
    suffix: Annotated[str, _about("Text behind the number: H in 0102H.")] = ""

    def reference(self, address: int) -> str:
        """Write an address in the vendor's notation: HR400001, 0102H, X1F."""
        return f"{self.prefix}{self.number(address)}{self.suffix}"

    def span(self, first: int, last: int) -> str:
        """Write the range from `first` to `last` (both included) in the vendor's notation:
        HR400001..400002, X0..XF, 0105H..010EH.

        The last address has no prefix unless it is hexadecimal: a hexadecimal number such as F
        could be read as a word without its prefix.
        """
        if last <= first:
            return self.reference(first)
        if self.radix is Radix.HEX:
            return f"{self.reference(first)}..{self.reference(last)}"
        return f"{self.reference(first)}..{self.number(last)}{self.suffix}"

    def number(self, address: int) -> str:
        return self.radix.write(self.base + address).rjust(self.width, "0")

    @property
    def notation(self) -> tuple[str, int, Radix, int, str]:
        """Prefix, base, radix, width and suffix: what decides how an address is written.

        Two areas write addresses in the same way if these are equal.
        """
        return self.prefix, self.base, self.radix, self.width, self.suffix

    def holds(self, table: Table, address: int, quantity: int = 1) -> bool:
        return self.table is table and self.first <= address and address + quantity - 1 <= self.last


class AnswerWord(_Part, frozen=True, kw_only=True):
    """The only data in the response to a vendor's own function: a 16-bit word.

    The manual gives the word a name, and may give a meaning to each of its values.
    """

    name: Annotated[str, _about("The name of the word.")]
    texts: Annotated[Texts, _about("The meaning of each value.")] = {}


class FunctionRule(_Part, frozen=True, kw_only=True):
    """The manual's rules for one function of the device: limits, responses, exceptions."""

    limit: Annotated[Quantity | None, _about("The largest quantity in the manual.")] = None
    write_limit: Annotated[
        Quantity | None, _about("Function 17: most registers written; `limit` is for reading.")
    ] = None
    ascii_limit: Annotated[
        Quantity | None, _about("The largest quantity in ASCII mode, if it differs.")
    ] = None
    data: Annotated[
        str | None, _about("Hexadecimal bytes that must follow the function code; more may follow.")
    ] = None
    title: Annotated[
        str | None,
        _about("The vendor's name for the function; decode shows that of the vendor's own only."),
    ] = None
    answer: Annotated[AnswerWord | None, _about("The response to the vendor's function.")] = None
    answers: Annotated[bool, _about("False if the device gives no response.")] = True
    echoes: Annotated[bool, _about("True if the response to it repeats the request.")] = False
    doubtful: Annotated[
        bool, _about("True if the limit is uncertain: a larger quantity is only a note.")
    ] = False
    value: Annotated[
        ExceptionCode | None,
        _about("For a wrong quantity, byte count or value, if the function differs."),
    ] = None
    documented: Annotated[
        list[ExceptionCode] | None,
        _about("Every exception code in the manual for this function, if they differ."),
    ] = None


class ExceptionCause(StrEnum):
    """The reason why a device refuses a request."""

    FUNCTION = "function"
    ADDRESS = "address"
    VALUE = "value"


class Exceptions(_Part, frozen=True, kw_only=True):
    """The exception codes with which the device refuses requests; they may differ from the
    standard's.
    """

    function: Annotated[ExceptionCode, _about("For a function that the device does not have.")] = 1
    address: Annotated[ExceptionCode, _about("For addresses outside its areas.")] = 2
    value: Annotated[ExceptionCode, _about("For a wrong quantity, byte count or value.")] = 3
    documented: Annotated[list[ExceptionCode], _about("Every exception code in the manual.")] = (
        msgspec.field(default_factory=lambda: [1, 2, 3])
    )
    causes: Annotated[
        list[ExceptionCause], _about("The wrongs of a request whose code the manual states.")
    ] = []
    texts: Annotated[Texts, _about("Meanings that differ from the standard's.")] = {}


class Timing(_Part, frozen=True, kw_only=True):
    """Lengths of silences in the manual that differ from the standard's, as text: 28bits, 5ms."""

    t1_5: Annotated[str | None, _about("The longest silence inside a frame.")] = None
    t3_5: Annotated[str | None, _about("The shortest silence between frames.")] = None
    request_interval: Annotated[
        str | None, _about("The shortest silence from a response to the next request.")
    ] = None


class Point(_Part, frozen=True, kw_only=True):
    """A value, or a series of values, that the manual names."""

    name: Annotated[
        str, _about("The name; in a series, {n} is the number and {reference} the reference.")
    ]
    table: Annotated[Table, _about("One of the four tables of the data model.")]
    address: Annotated[Address, _about("First address on the wire, 0-based.")]
    type: Annotated[PointType, _about("How the value is encoded in the registers or the bit.")] = (
        PointType.UINT16
    )
    count: Annotated[
        Quantity, _about("Points in the series; {n} in the name counts from `counted_from`.")
    ] = 1
    stride: Annotated[
        Quantity, _about("Addresses from one point to the next; by default, side by side.")
    ] = 1
    counted_from: Annotated[int, _about("The number {n} of the first point of the series.")] = 1
    length: Annotated[
        Annotated[int, Meta(ge=1, le=READ_LIMIT)] | None, _about("Registers of a string.")
    ] = None
    access: Annotated[
        Access | None, _about("What a master may do, if that is less than the area allows.")
    ] = None
    block: Annotated[
        Address | None, _about("The point exists only in reads that begin at this address.")
    ] = None
    word_order: Annotated[
        WordOrder, _about("Which register of a number of several comes first.")
    ] = WordOrder.HIGH_FIRST
    byte_order: Annotated[
        ByteOrder, _about("Which byte of each register comes first; the high one in the standard.")
    ] = ByteOrder.HIGH_FIRST
    unit: Annotated[str | None, _about("The unit of the value: degC, bar.")] = None
    scale: Annotated[float, _about("value = number in the register x `scale` + `offset`.")] = 1.0
    offset: Annotated[float, _about("Added after scaling.")] = 0.0
    scale_from: Annotated[
        str | None,
        _about(
            "The point that holds a power of ten, -10 to 10, by which the number is multiplied."
        ),
    ] = None
    units_from: Annotated[
        str | None,
        _about(
            "The beginning of the names of nibble fields whose number for this point's channel "
            "chooses its unit."
        ),
    ] = None
    units: Annotated[Texts, _about("The unit for each number of `units_from`.")] = {}
    after: Annotated[
        str | None, _about("Octets: the point with the octets before these, in one address.")
    ] = None
    no_value: Annotated[int | None, _about("The number in the register that means: no value.")] = (
        None
    )
    decimals: Annotated[
        Annotated[int, Meta(ge=0, le=15)] | None, _about("Decimal places; by default, as needed.")
    ] = None
    first_channel: Annotated[int, _about("The channel of the lowest bit or nibble.")] = 1
    channels: Annotated[
        Annotated[int, Meta(ge=1, le=16)] | None, _about("Channels of a field; by default, all.")
    ] = None
    channel: Annotated[str, _about("The word before the number of a field's channel.")] = "CH"
    texts: Annotated[
        Texts, _about("Meanings of numbers. A bit field shows only bits whose value has one.")
    ] = {}
    bits: Annotated[Texts, _about("The names of the bits of `flags`; 0 is the lowest bit.")] = {}
    default: Annotated[Word | None, _about("The content before the first write.")] = None
    minimum: Annotated[
        int | float | None, _about("The least value allowed, after `scale` and `offset`.")
    ] = None
    maximum: Annotated[
        int | float | None, _about("The largest value allowed, after `scale` and `offset`.")
    ] = None
    note: Annotated[str | None, _about("A sentence for readers.")] = None

    @property
    def words(self) -> int:
        """Number of addresses (registers or bits) that each of the `count` values takes."""
        return self.type.words or self.length or 1

    def allows(self, *, writing: bool) -> bool:
        """True if the key `access` of the point allows a master to write it, or to read it if
        `writing` is False.

        The area of the point may still forbid it.
        """
        return self.access is None or self.access.allows(writing=writing)

    @property
    def addresses(self) -> range:
        """The first address of each of the `count` values."""
        return range(self.address, self.address + self.count * self.stride, self.stride)

    @property
    def all_addresses(self) -> set[int]:
        """All addresses that the `count` values take."""
        return {at for first in self.addresses for at in range(first, first + self.words)}


class Profile(_Part, frozen=True, kw_only=True, dict=True):
    """A profile: all that a manual says about one device, or about one model of a family of
    devices.
    """

    name: Annotated[
        str, _about("The name for --device and the log: letters, digits, '-', '_' and '.'.")
    ]
    title: Annotated[str, _about("The device's full name, for readers.")]
    vendor: Annotated[str, _about("The company that makes the device.")]
    transports: Annotated[list[Transport], _about("The transports it supports.")]
    source: Annotated[str, _about("The manual, with its number and edition.")]
    areas: Annotated[list[Area], _about("The ranges of addresses that it has.")]
    functions: Annotated[
        dict[str, FunctionRule], _about("Its functions, by code in two hexadecimal digits.")
    ]
    exceptions: Annotated[Exceptions, _about("The exception codes that it gives.")] = msgspec.field(
        default_factory=Exceptions
    )
    timing: Annotated[Timing, _about("Silences in its manual that differ from the standard's.")] = (
        msgspec.field(default_factory=Timing)
    )
    points: Annotated[list[Point], _about("The values that its manual names.")] = []
    behaviour: Annotated[
        BehaviourName | None, _about("The family, if a profile cannot express all it does.")
    ] = None
    finding_prefix: Annotated[
        str | None, _about("Beginning of finding codes; by default, the name in capitals.")
    ] = None
    model_code: Annotated[
        Word | None, _about("What the device gives when a function asks for its model.")
    ] = None
    last_unit: Annotated[
        Annotated[int, Meta(ge=1, le=255)] | None, _about("Highest unit on a serial line.")
    ] = None
    complete_areas: Annotated[
        bool, _about("True if every address of its areas exists in every such device.")
    ] = False
    any_unit: Annotated[bool, _about("True if it responds to every unit number in Modbus/TCP.")] = (
        False
    )
    notes: Annotated[
        list[str], _about("Sentences for readers: assumptions, contradictions in the manual.")
    ] = []

    @property
    def has_rules(self) -> bool:
        """False if the profile only names points, and says nothing about areas and functions."""
        return bool(self.areas or self.functions)

    def rule(self, function: int) -> FunctionRule | None:
        """The rule for a function; None if the device does not have it."""
        return self.functions.get(f"{function:02X}")

    def value_exception(self, function: int) -> int:
        """The exception code with which the device refuses a request with this function because of
        a wrong quantity, byte count or value.
        """
        rule = self.rule(function)
        return self.exceptions.value if rule is None or rule.value is None else rule.value

    def documented_exceptions(self, function: int) -> list[int]:
        """Every exception code that the manual lists for a function."""
        rule = self.rule(function)
        if rule is None or rule.documented is None:
            return self.exceptions.documented
        return rule.documented

    def with_limits_of(self, transport: Transport) -> Profile:
        """The profile with the limits that hold for a transport. Only ASCII mode may have limits of
        its own.
        """
        ascii_rules = {
            code: msgspec.structs.replace(rule, limit=rule.ascii_limit)
            for code, rule in self.functions.items()
            if rule.ascii_limit is not None
        }
        if transport is not Transport.ASCII or not ascii_rules:
            return self
        return msgspec.structs.replace(self, functions=self.functions | ascii_rules)

    def exception_name(self, code: int) -> str:
        """The manual's name for an exception code; the standard's name if the manual has none."""
        return self.exceptions.texts.get(code) or exception_name(code)

    def area(
        self, table: Table, address: int, quantity: int = 1, *, writing: bool = False
    ) -> Area | None:
        """The area that contains all `quantity` addresses from `address` on; None if there is none.

        If one area is for reading and another for writing, `writing` chooses between them.
        """
        holding = [area for area in self.areas if area.holds(table, address, quantity)]
        for area in holding:
            if area.access.allows(writing=writing):
                return area
        return holding[0] if holding else None

    def allows(self, table: Table, span: range, *, writing: bool = False) -> bool:
        """True if a master may write all addresses of the range `span`, or read them if `writing`
        is False.

        The range may extend over several areas.
        """
        firsts, ends = self._allowed[table, writing]
        at = bisect_right(firsts, span.start) - 1
        return span.stop <= span.start or (at >= 0 and span.stop <= ends[at])

    def ranges(self, table: Table, *, writing: bool) -> list[tuple[int, int]]:
        """Return the ranges of addresses that a master may write, or read if `writing` is False:
        the first address, and the one behind the last.
        """
        return [*zip(*self._allowed[table, writing], strict=True)]

    @cached_property
    def _allowed(self) -> dict[tuple[Table, bool], tuple[list[int], list[int]]]:
        """For each table, and True for writing: the first addresses of the ranges that a master may
        read or write, and the addresses behind their last ones.
        """
        allowed = {}
        for table, writing in product(Table, (False, True)):
            firsts: list[int] = []
            ends: list[int] = []
            for first, end in sorted(
                (area.first, area.last + 1)
                for area in self.areas
                if area.table is table and area.access.allows(writing=writing)
            ):
                if ends and first <= ends[-1]:
                    ends[-1] = max(ends[-1], end)
                else:
                    firsts.append(first)
                    ends.append(end)
            allowed[table, writing] = firsts, ends
        return allowed

    @cached_property
    def notations(self) -> dict[tuple[Table, int, bool], Area | None]:
        """The areas that references.py has found: for a table, an address and True for writing, the
        area in whose notation the address is written; None for the neutral notation.
        """
        return {}

    @cached_property
    def point_spans(self) -> list[tuple[int, int, Point]]:
        """The first and the last address of each point, and the point. Here, a point in a block
        also has all addresses from the block's first one up to its own.
        """
        return [
            (
                point.address if point.block is None else point.block,
                point.addresses[-1] + point.words - 1,
                point,
            )
            for point in self.points
        ]

    @cached_property
    def has_blocks(self) -> bool:
        """True if it has registers that a master can only read from the first one of a block on."""
        return any(point.block is not None for point in self.points)
