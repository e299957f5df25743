"""Makes tables of one style, and removes control characters from texts for a terminal."""

from __future__ import annotations

import json
from dataclasses import dataclass

from msgspec.structs import replace
from rich.table import Table
from rich.text import Text

from mbtool.devices import NamedTransaction
from mbtool.modbus import FUNCTIONS
from mbtool.views.cells import finding_texts, transaction_text, values_text


def printable_json(text: str) -> str:
    """Return a JSON text in which characters that cannot be printed are written as JSON escapes."""
    if text.isascii():
        return text
    return "".join(
        one if one.isprintable() or one == "\n" else json.dumps(one)[1:-1] for one in text
    )


def printable(text: str) -> str:
    """Replace control characters in a text by ?, because a terminal would obey them."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else "?" for char in text)


def plain(text: str, style: str = "") -> Text:
    """Return a text for the library rich, without control characters; brackets are not markup."""
    return Text(printable(text), style)


def plain_table(*headings: str) -> Table:
    """Return an empty table without a frame; long cells take several lines."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table


# The code below makes the texts of table rows for transactions that differ only in their values.
#
# The text of one of these transactions, the example, is made as for any row, but with the number
# _MARK as its only value. All the others have the same text before and behind the mark.

_MARK = 1_000_000_007
"""A number greater than any register, reference or other number in a text, so that it occurs only
as the mark."""


@dataclass(frozen=True, slots=True, eq=False)
class RowForm:
    """The text that the rows of equal requests with equal outcomes share: all but their values."""

    like: NamedTransaction
    """One of these transactions, as an example."""
    before: str
    """The text of a row up to the values; the whole text if it has no values."""
    behind: str | None
    """The text of a row behind the values; None if it has no values."""
    is_bits: bool
    """True if the values are bits, False if they are registers."""
    in_hex: bool
    """True if registers are shown in hexadecimal, as 1234H."""

    @classmethod
    def of(cls, like: NamedTransaction, *, in_hex: bool) -> RowForm:
        """Return the form (RowForm) of the transactions that differ from `like` only in their
        values.

        `like` has no points (named values).
        """
        function = FUNCTIONS.get(like.function)
        is_bits = function is not None and function.table is not None and function.table.is_bits
        lists = {
            name: [_MARK] for name in ("request_values", "response_values") if getattr(like, name)
        }
        text = transaction_text(replace(like, **lists), in_hex=in_hex)
        line = "  ! ".join((printable(text), *finding_texts(like)))
        before, mark, behind = line.partition(values_text([_MARK], bits=is_bits, in_hex=in_hex))
        return cls(like, before, behind if mark else None, is_bits, in_hex)

    def text(self, values: list[int]) -> str:
        """Return the text of a transaction with these values, and its findings."""
        if self.behind is None:
            return self.before
        shown = values_text(values, bits=self.is_bits, in_hex=self.in_hex)
        return f"{self.before}{shown}{self.behind}"
