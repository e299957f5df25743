"""A device profile: what a vendor's manual says, as data."""

# The TOML of docs/devices.md maps one to one onto these types: a file's keys are the fields. Checks
# that one field alone cannot show (areas that overlap, points outside their area) are in
# validation.py; reading a file, and one file that extends another, in loading.py.

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import msgspec

from mbtool.modbus.adu import Transport
from mbtool.modbus.functions import READ_LIMIT, exception_name
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
    OCTAL_DIGIT = "octal-digit"
    """The last digit counts to 7, those before it are decimal: M7, M10, ..., M97, M100."""

    def write(self, number: int) -> str:
        match self:
            case Radix.DECIMAL:
                return str(number)
            case Radix.HEX:
                return f"{number:X}"
            case Radix.OCTAL_DIGIT:
                return f"{number // 8 or ''}{number % 8}"

    def read(self, digits: str) -> int:
        """The number that `digits` stand for. Raises ValueError."""
        valid = "0123456789ABCDEF" if self is Radix.HEX else "0123456789"
        last = "01234567" if self is Radix.OCTAL_DIGIT else valid
        if not digits or not set(digits) <= set(valid) or digits[-1] not in last:
            raise ValueError(f"{digits!r} is no {self} number")
        if self is not Radix.OCTAL_DIGIT:
            return int(digits, 16 if self is Radix.HEX else 10)
        return int(digits[:-1] or "0") * 8 + int(digits[-1])


class Access(StrEnum):
    """What a master may do with an area or a point."""

    READ = "r"
    READ_WRITE = "rw"
    WRITE = "w"

    def allows(self, *, writing: bool) -> bool:
        return self is not (Access.READ if writing else Access.WRITE)


class BehaviourName(StrEnum):
    """What a family of devices does beyond its data, as the embedded slave and `check` know it."""

    FA3 = "fa3"
    LT830 = "lt830"
    WAGO = "wago"


class _Part(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A part of a profile; an unknown key is an error."""


class Area(_Part, frozen=True, kw_only=True):
    """A range of addresses that the device has, and how its manual writes them."""

    name: str
    """The manual's name for it."""
    table: Table
    """Which of the four tables of the data model."""
    first: Address
    """Its first address on the wire, 0-based."""
    last: Address
    """Its last address, included."""
    access: Access
    """What a master may do with it: r, w or rw."""
    prefix: str = ""
    """What stands before the number of a reference: HR in HR400001."""
    base: Annotated[int, msgspec.Meta(ge=-0xFFFF, le=1_000_000)] = 0
    """The number that the manual gives to address 0: reference = base + address.

    Negative where the area begins above 0 and its numbers do not.
    """
    radix: Radix = Radix.DECIMAL
    """How the number is written."""
    width: Annotated[int, msgspec.Meta(ge=0, le=8)] = 0
    """Digits of the reference, padded with zeros."""
    suffix: str = ""
    """What stands behind the number: H in 0102H."""

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
        return self.radix.write(self.base + address).rjust(self.width, "0")

    @property
    def notation(self) -> tuple[str, int, Radix, int, str]:
        """What makes two areas write their addresses alike."""
        return self.prefix, self.base, self.radix, self.width, self.suffix

    def holds(self, table: Table, address: int, quantity: int = 1) -> bool:
        return self.table is table and self.first <= address and address + quantity - 1 <= self.last


class AnswerWord(_Part, frozen=True, kw_only=True):
    """The 16-bit word that is all the data of the answer to a function of the maker's own."""

    name: str
    """What the word is called."""
    texts: Texts = {}
    """What a value means, by the value."""


class FunctionRule(_Part, frozen=True, kw_only=True):
    """A function that the device has."""

    limit: Quantity | None = None
    """The largest quantity, where the manual states one."""
    write_limit: Quantity | None = None
    """How many registers function 17 writes at most, where the manual states it; `limit` is how
    many it reads."""
    ascii_limit: Quantity | None = None
    """The largest quantity in ASCII mode, where the manual states another one for it."""
    data: str | None = None
    """What stands behind the function code of a request, where the manual fixes it, in hexadecimal
    digits; more may follow."""
    title: str | None = None
    """The maker's name for a function of his own."""
    answer: AnswerWord | None = None
    """What a function of the maker's own gives back."""
    answers: bool = True
    """False where the device carries the function out and stays silent."""


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
    texts: Texts = {}
    """What a code means, where the manual says it otherwise than the standard."""


class Timing(_Part, frozen=True, kw_only=True):
    """Silences that the manual asks for, where it gives others than the standard: 28bits, 5ms."""

    t1_5: str | None = None
    """The longest silence inside a frame."""
    t3_5: str | None = None
    """The shortest silence between frames."""
    request_interval: str | None = None
    """What a master leaves at least from an answer to its next request."""


class PointType(StrEnum):
    """How a point's value stands in its registers or bits."""

    BIT = "bit"
    UINT16 = "uint16"
    INT16 = "int16"
    BCD16 = "bcd16"
    """Four decimal digits, each in four bits."""
    HEX16 = "hex16"
    """A code that its manual writes in hexadecimal."""
    OCTETS = "octets"
    """Two octets of an IP address, the earlier one in the high byte."""
    UINT32 = "uint32"
    INT32 = "int32"
    BCD32 = "bcd32"
    FLOAT32 = "float32"
    UINT64 = "uint64"
    INT64 = "int64"
    FLOAT64 = "float64"
    STRING = "string"
    """Two characters in each register, the earlier one in the high byte."""
    FLAGS = "flags"
    """A register whose bits have names."""
    BIT_FIELD = "bit-field"
    """A register with one bit for each channel."""
    NIBBLE_FIELD = "nibble-field"
    """A register with four bits for each channel."""

    @property
    def words(self) -> int:
        """How many addresses a value takes; 0 for a string, whose point says it."""
        return 0 if self is PointType.STRING else _WORDS.get(self, 1)

    @property
    def channel_bits(self) -> int:
        """How many bits of the register each channel has; 0 where it is no field."""
        return {PointType.BIT_FIELD: 1, PointType.NIBBLE_FIELD: 4}.get(self, 0)

    @property
    def whole_numbers(self) -> range | None:
        """The whole numbers that it can hold; None where it holds other things."""
        return _RANGES.get(self)

    @property
    def is_number(self) -> bool:
        """Whether its value is a quantity, which can have a scale and a unit."""
        return self in _RANGES or self in (PointType.FLOAT32, PointType.FLOAT64)


_WORDS = {
    PointType.UINT32: 2,
    PointType.INT32: 2,
    PointType.BCD32: 2,
    PointType.FLOAT32: 2,
    PointType.UINT64: 4,
    PointType.INT64: 4,
    PointType.FLOAT64: 4,
}
_RANGES = {
    PointType.UINT16: range(1 << 16),
    PointType.INT16: range(-(1 << 15), 1 << 15),
    PointType.BCD16: range(10**4),
    PointType.UINT32: range(1 << 32),
    PointType.INT32: range(-(1 << 31), 1 << 31),
    PointType.BCD32: range(10**8),
    PointType.UINT64: range(1 << 64),
    PointType.INT64: range(-(1 << 63), 1 << 63),
}


class WordOrder(StrEnum):
    """Which register of a value of several comes first."""

    HIGH_FIRST = "high-first"
    LOW_FIRST = "low-first"


class ByteOrder(StrEnum):
    """Which byte of a register comes first; the standard says the high one."""

    HIGH_FIRST = "high-first"
    LOW_FIRST = "low-first"


class Point(_Part, frozen=True, kw_only=True):
    """A value that the manual names."""

    name: str
    """Its name; {n} stands for the number, {reference} for the reference, of one of several."""
    table: Table
    """Which of the four tables of the data model."""
    address: Address
    """Its first address on the wire, 0-based."""
    type: PointType = PointType.UINT16
    """How its value stands in the registers or the bit."""
    count: Quantity = 1
    """How many such points follow one another; {n} in the name counts them from `counted_from`."""
    stride: Quantity = 1
    """From one of them to the next, in addresses; absent in a file: as many as each takes."""
    counted_from: int = 1
    """The number {n} of the first of them."""
    length: Annotated[int, msgspec.Meta(ge=1, le=READ_LIMIT)] | None = None
    """How many registers a string takes."""
    access: Access | None = None
    """What a master may do with it, where that is less than with its area."""
    block: Address | None = None
    """Where a read must begin to find it: it is a part of a block of registers which is read from
    that address alone, and whose other addresses stand for other things where a read begins there.
    """
    word_order: WordOrder = WordOrder.HIGH_FIRST
    """Which register of a number of several comes first."""
    byte_order: ByteOrder = ByteOrder.HIGH_FIRST
    """Which byte of each register comes first; the standard says the high one."""
    unit: str | None = None
    """What the value is counted in: degC, bar."""
    scale: float = 1.0
    """The value is the register's number times this, plus `offset`."""
    offset: float = 0.0
    """What is added once the number is scaled."""
    decimals: Annotated[int, msgspec.Meta(ge=0, le=15)] | None = None
    """Digits behind the point where it is written; absent: as many as it has."""
    first_channel: int = 1
    """The channel of the lowest bit or nibble of a field."""
    channels: Annotated[int, msgspec.Meta(ge=1, le=16)] | None = None
    """How many channels a field has; absent: as many as fit, 16 or 4."""
    channel: str = "CH"
    """What a field's channel is called, before its number."""
    texts: Texts = {}
    """What a number means. A bit field speaks of the bits whose value has a text, no others."""
    bits: Texts = {}
    """The names of the bits of `flags`, 0 for the lowest."""
    default: Word | None = None
    """What stands in its register or bit before anyone writes it."""
    minimum: int | float | None = None
    """The least value that the manual allows, after `scale` and `offset`."""
    maximum: int | float | None = None
    """The largest value that the manual allows, after `scale` and `offset`."""
    note: str | None = None
    """A sentence for readers."""

    @property
    def words(self) -> int:
        """How many addresses each of the `count` points takes."""
        return self.type.words or self.length or 1

    def allows(self, *, writing: bool) -> bool:
        """Whether it is a value for writing or for reading, if its area lets a master do that."""
        return self.access is None or self.access.allows(writing=writing)

    @property
    def addresses(self) -> range:
        """Where each of the `count` points begins."""
        return range(self.address, self.address + self.count * self.stride, self.stride)


class Profile(_Part, frozen=True, kw_only=True):
    """One device, or one model of a family."""

    name: str
    """What --device and the log call it: letters, digits, '-', '_' and '.'."""
    title: str
    """What it is, for readers."""
    vendor: str
    """Who makes it."""
    transports: list[Transport]
    """The kinds of line that it is on."""
    source: str
    """The manual, with its number and edition."""
    areas: list[Area]
    """The ranges of addresses that it has."""
    functions: dict[str, FunctionRule]
    """The functions that it has, by their code in two hexadecimal digits."""
    exceptions: Exceptions = msgspec.field(default_factory=Exceptions)
    """Which exception code it gives for what."""
    timing: Timing = msgspec.field(default_factory=Timing)
    """The silences that its manual asks for."""
    points: list[Point] = []
    """The values that its manual names."""
    behaviour: BehaviourName | None = None
    """The name of what data cannot say: fa3, lt830 or wago."""
    finding_prefix: str | None = None
    """What the codes of broken rules begin with; absent: the name in capitals."""
    model_code: Word | None = None
    """What the device calls itself, where a function of the maker's asks for it."""
    last_unit: Annotated[int, msgspec.Meta(ge=1, le=255)] | None = None
    """The highest unit that it can be on a serial line, where the manual states it."""
    any_unit: bool = False
    """The device answers whatever unit a Modbus/TCP request names."""
    notes: list[str] = []
    """Sentences for readers: what is assumed, where the manual contradicts itself."""

    def rule(self, function: int) -> FunctionRule | None:
        """The rule of a function that the device has, else None."""
        return self.functions.get(f"{function:02X}")

    def in_mode(self, transport: Transport) -> Profile:
        """The profile as it holds on a transport: in ASCII mode with the limits of that mode."""
        own = {
            code: msgspec.structs.replace(rule, limit=rule.ascii_limit)
            for code, rule in self.functions.items()
            if rule.ascii_limit is not None
        }
        if transport is not Transport.ASCII or not own:
            return self
        return msgspec.structs.replace(self, functions=self.functions | own)

    def exception_name(self, code: int) -> str:
        """What an exception code means on this device, else in the standard."""
        return self.exceptions.texts.get(code) or exception_name(code)

    def area(
        self, table: Table, address: int, quantity: int = 1, *, writing: bool = False
    ) -> Area | None:
        """The area that holds all of a range, else None.

        Where what is read and what is written are two areas, `writing` says which is meant.
        """
        holding = [area for area in self.areas if area.holds(table, address, quantity)]
        for area in holding:
            if area.access.allows(writing=writing):
                return area
        return holding[0] if holding else None

    def allows(self, table: Table, span: range, *, writing: bool = False) -> bool:
        """Whether a master may reach all of a range; it may run from one area into the next."""
        at = span.start
        while at < span.stop:
            area = self.area(table, at, writing=writing)
            if area is None or not area.access.allows(writing=writing):
                return False
            at = area.last + 1
        return True
