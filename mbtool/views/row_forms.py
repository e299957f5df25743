"""Makes the texts of transactions that differ only in their values."""

# The text of an example is made as for any row, but with _MARK as its only value. The text before
# and behind the mark is that of all these transactions.

from __future__ import annotations

from dataclasses import dataclass

from msgspec.structs import replace

from mbtool.devices import NamedTransaction
from mbtool.modbus import FUNCTIONS
from mbtool.views.cells import finding_texts, transaction_text, values_text
from mbtool.views.tables import printable

_MARK = 1_000_000_007
"""Greater than a register, a reference and every other number in a text."""


@dataclass(frozen=True, slots=True, eq=False)
class RowForm:
    """What the texts of equal requests with equal outcomes have in common."""

    like: NamedTransaction
    """An example."""
    before: str
    """The text up to the values; the whole text if it has no values."""
    behind: str | None
    """The text behind the values; None if the text has no values."""
    is_bits: bool
    """True if the values are bits."""
    in_hex: bool
    """True if registers are shown as 1234H."""

    @classmethod
    def of(cls, like: NamedTransaction, *, in_hex: bool) -> RowForm:
        """Return the form of the transactions that differ from `like` only in their values.

        `like` has no named points.
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
