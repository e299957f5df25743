"""A device profile: what a vendor's manual says, as data."""

# The TOML of docs/devices.md maps one to one onto these types: a file's keys are the fields. Checks
# that one field alone cannot show (areas that overlap, points outside their area) are in
# validation.py; reading a file, and one file that extends another, in loading.py.

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import msgspec

from mbtool.modbus.adu import Transport
from mbtool.modbus.tables import Table

Address = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
Word = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
Quantity = Annotated[int, msgspec.Meta(ge=1, le=0xFFFF)]
ExceptionCode = Annotated[int, msgspec.Meta(ge=1, le=0xFF)]
Texts = dict[int, str]
"""What a value means, by the value."""

WORD_BITS = 16


class Radix(StrEnum):
    """How the vendor writes the number in a reference."""

    DECIMAL = "decimal"
    HEX = "hex"


class Access(StrEnum):
    """What a master may do with an area."""

    READ = "r"
    READ_WRITE = "rw"


class _Part(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A part of a profile; an unknown key is an error."""


class Area(_Part, frozen=True, kw_only=True):
    """A range of addresses that the device has, and how its manual writes them."""

    name: str
    table: Table
    first: Address
    last: Address
    access: Access
    prefix: str = ""
    base: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 0
    """The number that the manual gives to address 0: reference = base + address."""
    radix: Radix = Radix.DECIMAL
    width: Annotated[int, msgspec.Meta(ge=0, le=8)] = 0
    """Digits of the reference, padded with zeros."""
    suffix: str = ""

    def reference(self, address: int) -> str:
        """Write an address the vendor's way: HR400001, 0102H, X1F."""
        return f"{self.prefix}{self.number(address)}{self.suffix}"

    def span(self, first: int, last: int) -> str:
        """Write a range the vendor's way: HR400001..400002, X0..XF, 0105H..010EH.

        A decimal number stands alone at the end; a hexadecimal one keeps its prefix, since F could
        be a word.
        """
        if last <= first:
            return self.reference(first)
        if self.radix is Radix.HEX:
            return f"{self.reference(first)}..{self.reference(last)}"
        return f"{self.reference(first)}..{self.number(last)}{self.suffix}"

    def number(self, address: int) -> str:
        number = self.base + address
        digits = f"{number:X}" if self.radix is Radix.HEX else str(number)
        return digits.rjust(self.width, "0")

    @property
    def notation(self) -> tuple[str, int, Radix, int, str]:
        """What makes two areas write their addresses alike."""
        return self.prefix, self.base, self.radix, self.width, self.suffix

    def holds(self, table: Table, address: int, quantity: int = 1) -> bool:
        return self.table is table and self.first <= address and address + quantity - 1 <= self.last


class AnswerWord(_Part, frozen=True, kw_only=True):
    """The 16-bit word that is all the data of the answer to a function of the maker's own."""

    name: str
    texts: Texts = {}


class FunctionRule(_Part, frozen=True, kw_only=True):
    """A function that the device has."""

    limit: Quantity | None = None
    """The largest quantity, where the manual states one."""
    title: str | None = None
    """The maker's name for a function of his own."""
    answer: AnswerWord | None = None
    """What a function of the maker's own gives back."""


class Exceptions(_Part, frozen=True, kw_only=True):
    """Which exception code the device gives for what (its manual's codes, not the standard's)."""

    function: ExceptionCode = 1
    """A function it lacks."""
    address: ExceptionCode = 2
    """An address, or address + quantity, outside its areas."""
    value: ExceptionCode = 3
    """A quantity, byte count or value that is not allowed."""
    documented: list[ExceptionCode] = msgspec.field(default_factory=lambda: [1, 2, 3])
    """Every code that the manual lists."""


class Timing(_Part, frozen=True, kw_only=True):
    """Silences on a serial line, where the manual gives others than the standard: 28bits, 5ms."""

    t1_5: str | None = None
    """The longest silence inside a frame."""
    t3_5: str | None = None
    """The shortest silence between frames."""


class PointType(StrEnum):
    """How a point's value stands in its registers or bits."""

    BIT = "bit"
    UINT16 = "uint16"
    INT16 = "int16"
    HEX16 = "hex16"
    """A code that its manual writes in hexadecimal."""
    OCTETS = "octets"
    """Two octets of an IP address, the earlier one in the high byte."""
    UINT32 = "uint32"
    INT32 = "int32"
    FLOAT32 = "float32"
    BIT_FIELD = "bit-field"
    """A register with one bit for each channel."""
    NIBBLE_FIELD = "nibble-field"
    """A register with four bits for each channel."""

    @property
    def words(self) -> int:
        """How many addresses a value takes."""
        return 2 if self in (PointType.UINT32, PointType.INT32, PointType.FLOAT32) else 1

    @property
    def channel_bits(self) -> int:
        """How many bits of the register each channel has; 0 where it is no field."""
        return {PointType.BIT_FIELD: 1, PointType.NIBBLE_FIELD: 4}.get(self, 0)


class WordOrder(StrEnum):
    """Which register of a 32-bit value comes first."""

    HIGH_FIRST = "high-first"
    LOW_FIRST = "low-first"


class Point(_Part, frozen=True, kw_only=True):
    """A value that the manual names."""

    name: str
    """With {n} for the number, or {reference}, where `count` makes several of one."""
    table: Table
    address: Address
    type: PointType = PointType.UINT16
    count: Quantity = 1
    """How many such points follow one another; {n} in the name counts them from `counted_from`."""
    stride: Quantity = 1
    """From one of them to the next, in addresses."""
    counted_from: int = 1
    word_order: WordOrder = WordOrder.HIGH_FIRST
    unit: str | None = None
    scale: float = 1.0
    """The value is the register's number times this."""
    first_channel: int = 1
    """The channel of the lowest bit or nibble of a field."""
    channels: Annotated[int, msgspec.Meta(ge=1, le=16)] | None = None
    """How many channels a field has; absent: as many as fit, 16 or 4."""
    channel: str = "CH"
    """What a field's channel is called, before its number."""
    texts: Texts = {}
    """What a value means. A bit field speaks of the bits whose value has a text, no others."""
    default: Word | None = None
    """What the device holds before anyone writes it."""
    minimum: int | None = None
    maximum: int | None = None
    note: str | None = None

    @property
    def addresses(self) -> range:
        """Where each of the `count` points begins."""
        return range(self.address, self.address + self.count * self.stride, self.stride)


class Profile(_Part, frozen=True, kw_only=True):
    """One device, or one model of a family."""

    name: str
    title: str
    vendor: str
    transports: list[Transport]
    source: str
    """The manual."""
    areas: list[Area]
    functions: dict[str, FunctionRule]
    """By function code in two hexadecimal digits."""
    exceptions: Exceptions = msgspec.field(default_factory=Exceptions)
    timing: Timing = msgspec.field(default_factory=Timing)
    points: list[Point] = []
    behaviour: str | None = None
    """The name of what data cannot say, in slave/behaviours.py."""
    finding_prefix: str | None = None
    """What the codes of broken rules begin with; absent: the name in capitals."""
    model_code: Word | None = None
    any_unit: bool = False
    """The device answers whatever unit a Modbus/TCP request names."""
    notes: list[str] = []

    def rule(self, function: int) -> FunctionRule | None:
        """The rule of a function that the device has, else None."""
        return self.functions.get(f"{function:02X}")

    def area(self, table: Table, address: int, quantity: int = 1) -> Area | None:
        """The area that holds all of a range, else None."""
        for area in self.areas:
            if area.holds(table, address, quantity):
                return area
        return None

    def allows(self, table: Table, span: range, *, writing: bool = False) -> bool:
        """Whether a master may reach all of a range; it may run from one area into the next."""
        at = span.start
        while at < span.stop:
            area = self.area(table, at)
            if area is None or (writing and area.access is Access.READ):
                return False
            at = area.last + 1
        return True
