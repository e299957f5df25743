"""The user's options for the import of a register list: facts that the import need not guess."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from mbtool.core.errors import UsageError
from mbtool.devices.importing.columns import SYNONYMS, Meaning
from mbtool.devices.point_types import WordOrder
from mbtool.modbus.tables import Table


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
