"""The user's options for the import of a register list: facts that the import need not guess."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from mbtool.core.errors import UsageError
from mbtool.devices.importing.columns import SYNONYMS, Meaning
from mbtool.devices.point_types import WordOrder
from mbtool.modbus.tables import Table

# The class below collects the messages of an import for the user: guesses, and rows that cannot be
# read.

MAX_PROBLEMS = 100
"""At most this many problems get a line of their own. One more line names the rows of all
others."""

_SHOWN = 40
"""A message about a problem shows at most this many characters of the cell."""


class ImportReport:
    """The remarks on one register list, and the problems of its rows, for the user."""

    def __init__(self) -> None:
        self._remarks: dict[str, list[int]] = {}
        self._problems: dict[str, set[int]] = {}
        self.bad_rows: set[int] = set()

    def tell(self, remark: str, row: int | None = None) -> None:
        """Add a remark on the row with the number `row`, or on the whole list if `row` is None.

        Equal remarks on several rows become one remark with the numbers of all these rows.
        """
        self._remarks.setdefault(remark, []).extend(() if row is None else (row,))

    def add_problem(self, row: int, heading: str | None, text: str, problem: str) -> None:
        """Add a problem with a row. The profile lacks this row.

        `problem` says what is wrong with the cell `text` in the column `heading`; `heading` is None
        if the problem concerns no single column.
        """
        self.bad_rows.add(row)
        shown = " ".join(text.split())
        shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
        where = f', column "{heading}"' if heading is not None else ""
        self._problems.setdefault(f"{where}: {shown!r} {problem}", set()).add(row)

    @property
    def remarks(self) -> list[str]:
        return [f"{_rows(rows)}: {one}" if rows else one for one, rows in self._remarks.items()]

    @property
    def problem_lines(self) -> list[str]:
        """Lines about the problems, in the order of the rows. The number of each row with a problem
        is in one of them.
        """
        known = sorted(self._problems.items(), key=lambda one: min(one[1]))
        lines = [f"{_rows(rows)}{problem}" for problem, rows in known[:MAX_PROBLEMS]]
        others = set[int]().union(*(rows for _, rows in known[MAX_PROBLEMS:]))
        return [*lines, f"{_rows(others)}: other problems like these"] if others else lines


def _rows(numbers: Iterable[int]) -> str:
    """Write the numbers of rows: `row 2`, or `rows 2, 5-8`."""
    runs: list[list[int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    parts = [str(first) if first == last else f"{first}-{last}" for first, last in runs]
    return f"row{'s' if parts != [str(runs[0][0])] else ''} {', '.join(parts)}"


class AddressStyle(StrEnum):
    """The way in which the numbers in the column of addresses are counted."""

    ZERO_BASED = "zero-based"
    """Addresses on the wire, counted from 0."""
    ONE_BASED = "one-based"
    """Numbers counted from 1, one more than the address on the wire."""
    REFERENCES = "references"
    """Numbers like 40001 or 300012: the first digit stands for the table, the others count from
    1."""
    HEXADECIMAL = "hexadecimal"
    """Addresses on the wire in hexadecimal, without a mark such as 0x or H."""


class Scaling(StrEnum):
    """Tells if the factor in a list multiplies or divides the number in the register."""

    MULTIPLY = "multiply"
    DIVIDE = "divide"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """The user's options for the import of a register list.

    The import takes a fact that is None here from the list, or guesses it.
    """

    columns: Mapping[Meaning, str] = field(default_factory=dict)
    """The headings of the columns that the user names, by meaning."""
    addresses: AddressStyle | None = None
    table: Table | None = None
    """The table of the rows for which the list names none; None if the user names no table."""
    scaling: Scaling | None = None
    word_order: WordOrder | None = None
    """The word order of the values for which the list names none; None if the user names no
    order."""
    skip_bad: bool = False
    """True to leave out unreadable rows. If it is False and a row is unreadable, no profile is
    made."""


def parse_columns(said: Sequence[str]) -> dict[Meaning, str]:
    """Read texts MEANING=HEADING, such as `address=Modbus-Adresse`.

    Raises UsageError if a text has another form, a meaning is unknown, or a meaning or a heading is
    named twice.
    """
    columns: dict[Meaning, str] = {}
    for one in said:
        word, equals, heading = (part.strip() for part in one.partition("="))
        if not equals or not heading:
            raise UsageError(f"--column {one}: is not MEANING=HEADING, as address=Register is")
        meaning = SYNONYMS.get(word) or next((each for each in Meaning if each == word), None)
        if meaning is None:
            raise UsageError(f"--column {one}: '{word}' is no meaning; these are: {_MEANINGS}")
        if meaning in columns:
            raise UsageError(f"--column {one}: '{columns[meaning]}' is named for {meaning} already")
        if heading in columns.values():
            raise UsageError(f"--column {one}: '{heading}' is named for another meaning already")
        columns[meaning] = heading
    return columns


_MEANINGS = ", ".join(sorted({*Meaning, *SYNONYMS}))
