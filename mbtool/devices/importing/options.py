"""What the user says of a register list, so that it need not be guessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from mbtool.core.errors import UsageError
from mbtool.devices.importing.columns import SYNONYMS, Meaning
from mbtool.devices.point_types import WordOrder
from mbtool.modbus.tables import Table


class AddressStyle(StrEnum):
    """What the numbers in the column of addresses are."""

    ZERO_BASED = "zero-based"
    """Addresses on the wire, counted from 0."""
    ONE_BASED = "one-based"
    """Numbers counted from 1, one more than the address on the wire."""
    REFERENCES = "references"
    """Numbers like 40001 or 300012: the first digit stands for the table, the others count from
    1."""
    HEXADECIMAL = "hexadecimal"
    """Addresses on the wire, written in hexadecimal digits without a sign that they are."""


class Scaling(StrEnum):
    """What is done with the number in a register and the factor in the list."""

    MULTIPLY = "multiply"
    DIVIDE = "divide"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """What the user says of a register list. A field that is None is left to the list."""

    columns: Mapping[Meaning, str] = field(default_factory=dict)
    """The heading of the column for each meaning for which the user names a column."""
    addresses: AddressStyle | None = None
    table: Table | None = None
    """The table of the rows for which the list names none."""
    scaling: Scaling | None = None
    word_order: WordOrder | None = None
    """The word order of the values for which the list names none."""
    skip_bad: bool = False
    """True to leave out rows that cannot be read, False to make no profile if there are any."""


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
