"""Reads the rows of a register list: each value with its type, scale, unit and rights."""

# Every cell that cannot be read is a complaint with its row and column; the row goes on, so that
# all that is wrong is told at once. What a whole column means is found before its rows are read:
# whether a gain of 10 divides, and whether a size counts registers, bytes or bits.

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, TypeVar

from mbtool.devices.importing.addresses import Written
from mbtool.devices.importing.cells import (
    CellAccess,
    Factor,
    is_nothing,
    parse_access,
    parse_factor,
    parse_number,
    parse_range,
    parse_table,
    parse_texts,
    parse_unit,
)
from mbtool.devices.importing.columns import Column, Meaning
from mbtool.devices.importing.spellings import Order, TypeSpelling, parse_order, parse_type
from mbtool.devices.model import Access, PointType
from mbtool.modbus.functions import READ_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices.importing.columns import Sheet

T = TypeVar("T")

MAX_COMPLAINTS = 100
"""How many complaints are kept; the others are counted."""

MAX_NAME = 120
_SHOWN = 40


class Scaling(StrEnum):
    """What the numbers of a column of factors are for."""

    MULTIPLY = "multiply"
    DIVIDE = "divide"


class Complaints:
    """What is wrong with the cells of a list."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._kept: list[tuple[int, str]] = []
        self.count = 0

    def add(self, row: int, column: Column | None, text: str, problem: str) -> None:
        self.count += 1
        if len(self._kept) < MAX_COMPLAINTS:
            where = f', column "{column.heading}"' if column is not None else ""
            shown = " ".join(text.split())
            shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
            self._kept.append((row, f"{self._file}: row {row}{where}: {shown!r} {problem}"))

    @property
    def lines(self) -> list[str]:
        """In the order of the rows."""
        return [line for _, line in sorted(self._kept, key=lambda each: each[0])]


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One row of the list."""

    row: int
    name: str
    written: Written
    other: Written | None
    """What a second column of addresses has."""
    reach: CellAccess | None
    kind: TypeSpelling | None
    """None where the list gives no type."""
    registers: int | None
    order: Order | None
    access: Access | None
    unit: str | None
    scale: float
    offset: float
    decimals: int | None
    minimum: float | None
    maximum: float | None
    default: float | None
    texts: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def note(self) -> str | None:
        return "; ".join(dict.fromkeys(self.notes)) or None


class RowReader:
    """Reads the cells of one sheet."""

    def __init__(self, sheet: Sheet, complaints: Complaints, scaling: Scaling | None) -> None:
        self._sheet = sheet
        self._complaints = complaints
        self._factor_column = next(
            (
                column
                for meaning in (Meaning.SCALE, Meaning.GAIN, Meaning.DIVISOR)
                for column in sheet.all(meaning)
            ),
            None,
        )
        self.remarks: list[str] = []
        self.unread: list[int] = []
        """Rows whose range or values are prose, which becomes a note."""
        self._names = {self._name(row) for row in sheet.body} - {""}
        self._scaling = scaling or self._find_scaling()
        self._size_of = self._find_size()
        if scaling is not None and self._factor_column is None:
            self.remarks.append("--scaling: the list has no column of factors")

    def item(
        self,
        number: int,
        row: Sequence[str],
        written: Written,
        other: Written | None,
        section: CellAccess | None,
    ) -> Item:
        """Read the row behind its address."""
        registers = self._registers(number, row)
        kind = self._kind(number, row, registers)
        unit_factor, unit = parse_unit(self._of(row, Meaning.UNIT))
        scale, decimals = self._scale(number, row, kind, unit_factor)
        texts, prose = self._texts(row)
        low, high, range_note = self._limits(number, row, texts)
        if prose or range_note:
            self.unread.append(number)
        factor = self._factor(row)
        scaled_by = f"scaled by the power of ten in {factor}" if factor in self._names else ""
        notes = (self._note(row), prose, range_note, scaled_by)
        bit = self._number(number, row, Meaning.BIT)
        if bit is not None and written.bit is None:
            written = replace(written, bit=int(bit))
        return Item(
            row=number,
            name=self._name(row),
            written=written,
            other=other,
            reach=self._read(number, row, Meaning.TABLE, parse_table, _TABLE_WANTED) or section,
            kind=kind,
            registers=registers,
            order=self._order(number, row) or (kind.order if kind is not None else None),
            access=self._access(number, row),
            unit=unit,
            scale=scale,
            offset=self._number(number, row, Meaning.OFFSET) or 0.0,
            decimals=decimals,
            minimum=low,
            maximum=high,
            default=self._plain_number(row, Meaning.DEFAULT),
            texts=texts,
            notes=tuple(note for note in notes if note),
        )

    def is_reserved(self, row: Sequence[str]) -> bool:
        """Whether it only says that there is nothing."""
        return self._name(row).lower().strip("().- ") in _RESERVED

    def _of(self, row: Sequence[str], meaning: Meaning) -> str:
        return _cell(row, self._sheet.column(meaning))

    def _factor(self, row: Sequence[str]) -> str:
        return _cell(row, self._factor_column)

    def _name(self, row: Sequence[str]) -> str:
        columns = [*self._sheet.all(Meaning.NAME), *self._sheet.all(Meaning.DESCRIPTION)]
        names = [name for column in columns if not is_nothing(name := column.of(row))]
        # Braces stand for numbers in a profile.
        name = " ".join(names[0].split()) if names else ""
        return name.replace("{", "(").replace("}", ")")[:MAX_NAME].strip()

    def _note(self, row: Sequence[str]) -> str:
        name = self._name(row)
        columns = [*self._sheet.all(Meaning.NAME), *self._sheet.all(Meaning.DESCRIPTION)]
        texts = [" ".join(column.of(row).split()) for column in columns]
        return "; ".join(text for text in texts if not is_nothing(text) and text != name)

    def _read(
        self,
        number: int,
        row: Sequence[str],
        meaning: Meaning,
        parse: Callable[[str], T | None],
        wanted: str,
    ) -> T | None:
        """A cell that may be empty, or must be one that `parse` knows."""
        column = self._sheet.column(meaning)
        text = _cell(row, column)
        if is_nothing(text):
            return None
        value = parse(text)
        if value is None:
            self._complaints.add(number, column, text, wanted)
        return value

    def _number(self, number: int, row: Sequence[str], meaning: Meaning) -> float | None:
        return self._read(number, row, meaning, parse_number, "is no number")

    def _plain_number(self, row: Sequence[str], meaning: Meaning) -> float | None:
        return parse_number(self._of(row, meaning))

    def _registers(self, number: int, row: Sequence[str]) -> int | None:
        size = self._number(number, row, Meaning.LENGTH)
        if size is None:
            return None
        registers = -(-size // self._size_of)
        if not 1 <= registers <= READ_LIMIT:
            column = self._sheet.column(Meaning.LENGTH)
            problem = f"is no size; 1 to {READ_LIMIT} registers are"
            self._complaints.add(number, column, self._of(row, Meaning.LENGTH), problem)
            return None
        return int(registers)

    def _kind(self, number: int, row: Sequence[str], registers: int | None) -> TypeSpelling | None:
        return self._read(
            number, row, Meaning.TYPE, lambda text: parse_type(text, registers), _TYPE_WANTED
        )

    def _order(self, number: int, row: Sequence[str]) -> Order | None:
        column = self._sheet.column(Meaning.ORDER)
        if column is None:
            return None
        is_swap, of_words = "swap" in column.hint, "word" in column.hint

        def parse(text: str) -> Order | None:
            order = parse_order(f"{text} swap") if is_swap else None
            order = order or parse_order(text)
            # "Little" in a column of word orders says nothing about bytes.
            return (order[0], type(order[1]).HIGH_FIRST) if order and of_words else order

        return self._read(number, row, Meaning.ORDER, parse, _ORDER_WANTED)

    def _access(self, number: int, row: Sequence[str]) -> Access | None:
        column = self._sheet.column(Meaning.ACCESS)

        def parse(text: str) -> Access | None:
            if column is not None and column.hint.startswith("writ"):
                answer = _ANSWERS.get(text.lower())
                if answer is not None:
                    return Access.READ_WRITE if answer else Access.READ
            return parse_access(text)

        return self._read(number, row, Meaning.ACCESS, parse, _ACCESS_WANTED)

    def _scale(
        self, number: int, row: Sequence[str], kind: TypeSpelling | None, unit_factor: float | None
    ) -> tuple[float, int | None]:
        places = self._number(number, row, Meaning.DECIMALS)
        decimals = int(places) if places is not None and 0 <= places <= 15 else None
        text = self._factor(row)
        if self._factor_column is None or is_nothing(text):
            is_float = kind is not None and kind.type in (PointType.FLOAT32, PointType.FLOAT64)
            if decimals and not is_float and unit_factor is None:
                return 10.0**-decimals, decimals
            return (unit_factor or 1.0), decimals
        factor = parse_factor(text)
        if factor is None and text in self._names:
            return 1.0, decimals  # SunSpec: another register holds the power of ten.
        if factor is None:
            self._complaints.add(number, self._factor_column, text, _SCALE_WANTED)
            return 1.0, decimals
        scale = self._applied(factor)
        if not math.isfinite(scale) or scale == 0:
            self._complaints.add(number, self._factor_column, text, _SCALE_WANTED)
            return 1.0, decimals
        return scale, decimals

    def _applied(self, factor: Factor) -> float:
        divides = self._scaling is Scaling.DIVIDE and not factor.multiplies
        return 1 / factor.number if factor.divides or divides else float(factor.number)

    def _texts(self, row: Sequence[str]) -> tuple[Mapping[int, str], str]:
        text = self._of(row, Meaning.TEXTS)
        if is_nothing(text):
            # "0=off, 1=on" may stand in a column of ranges; one alone is as likely a limit.
            pairs = parse_texts(self._of(row, Meaning.RANGE)) or {}
            return (pairs if len(pairs) > 1 else {}), ""
        texts = parse_texts(text)
        return (texts, "") if texts is not None else ({}, " ".join(text.split()))

    def _limits(
        self, number: int, row: Sequence[str], texts: Mapping[int, str]
    ) -> tuple[float | None, float | None, str | None]:
        low = self._plain_number(row, Meaning.MINIMUM)
        high = self._plain_number(row, Meaning.MAXIMUM)
        text = self._of(row, Meaning.RANGE)
        if not is_nothing(text):
            span = parse_range(text)
            if span is None and texts and parse_texts(text) == texts:
                return low, high, None
            if span is None:
                return low, high, f"range: {' '.join(text.split())}"
            low, high = span
        if low is not None and high is not None and low > high:
            self._complaints.add(
                number, self._sheet.column(Meaning.MINIMUM), f"{low}", f"is more than {high}"
            )
            return None, None, None
        return low, high, None

    def _find_scaling(self) -> Scaling:
        column = self._factor_column
        if column is None:
            return Scaling.MULTIPLY
        factors = [parse_factor(column.of(row)) for row in self._sheet.body]
        bare = [one.number for one in factors if one and not one.divides and not one.multiplies]
        if column.meaning is Meaning.DIVISOR:
            scaling, why = Scaling.DIVIDE, "its heading says so"
        elif any(word in column.hint for word in _MULTIPLIERS) or all(one == 1 for one in bare):
            scaling, why = Scaling.MULTIPLY, "its heading says so"
        elif min(map(abs, bare)) < 1:
            scaling, why = Scaling.MULTIPLY, "some of them are less than 1"
        else:
            scaling, why = Scaling.DIVIDE, "none of them is less than 1"
        if any(one != 1 for one in bare):
            verb = "divided by" if scaling is Scaling.DIVIDE else "multiplied by"
            self.remarks.append(
                f'column "{column.heading}": a register\'s number is {verb} what stands there, '
                f"since {why} (--scaling says otherwise)"
            )
        return scaling

    def _find_size(self) -> int:
        """What a size is divided by to give registers: 1, or 2 for bytes, or 16 for bits."""
        column = self._sheet.column(Meaning.LENGTH)
        if column is None:
            return 1
        if any(word in column.hint for word in ("byte", "char")):
            return 2
        votes: Counter[int] = Counter()
        sizes = set()
        for row in self._sheet.body:
            size = parse_number(column.of(row))
            kind = parse_type(self._of(row, Meaning.TYPE))
            sizes.add(size)
            if size and kind is not None and kind.type.words > 1 and size % kind.type.words == 0:
                votes[int(size // kind.type.words)] += 1
        if votes:
            ((ratio, _),) = votes.most_common(1)
        else:
            known = sizes - {None}
            ratio = 16 if known and known <= {8, 16, 32, 64} else 1
        if ratio not in (2, 16):
            return 1
        what = "bytes" if ratio == 2 else "bits"
        self.remarks.append(f'column "{column.heading}" counts {what}, as its types show')
        return ratio


def _cell(row: Sequence[str], column: Column | None) -> str:
    return column.of(row) if column is not None else ""


_MULTIPLIERS = ("multipl", "factor", "faktor", "facteur", "resolution", "coefficient", "lsb",
                "accuracy", "precision", "step", "auflosung", "conversion")  # fmt: skip
_ANSWERS = {
    "yes": True, "y": True, "true": True, "1": True, "x": True, "ja": True, "oui": True,
    "no": False, "n": False, "false": False, "0": False, "nein": False, "non": False,
}  # fmt: skip
_RESERVED = frozenset(
    ("reserved", "reserve", "spare", "not used", "unused", "future use", "for future use",
     "reserved for future use", "reserviert", "frei", "nicht belegt", "réservé", "pad", "padding")
)  # fmt: skip
_TYPE_WANTED = "is no type; UINT16, INT32, FLOAT32, BCD, BOOL, STRING[16] and their like are"
_ORDER_WANTED = "is no order; ABCD, CDAB, BADC, DCBA, big-endian word swap and their like are"
_ACCESS_WANTED = "is no access; R, W and RW and their like are"
_TABLE_WANTED = "names no table; holding register, 4x, HR, 03, FC04, coil and their like do"
_SCALE_WANTED = "is no factor; 0.1, /10, x0.1 and their like are"
