"""Records in each format."""

from __future__ import annotations

import io

import pytest

from mbtool.cli.options import Format
from mbtool.cli.printers import printer_for
from mbtool.devices import load_profile
from tests.logs.samples import EVENT, transaction

TOUCH = load_profile("idec-ft1a-touch")


def _printed(format_: Format) -> list[str]:
    file = io.StringIO()
    printer = printer_for(format_, file, lambda _: TOUCH)
    printer.print(transaction(findings=["FT1A-Q3"]), 7)
    printer.print(EVENT, 7)
    printer.flush()
    return file.getvalue().splitlines()


@pytest.mark.parametrize(
    ("format_", "lines", "transaction_part", "event_part"),
    [
        (Format.TABLE, 4, "    7 ", "  gap: "),
        (Format.JSONL, 2, '"findings":["FT1A-Q3"]', '"kind":"gap"'),
        (Format.CSV, 2, ",FT1A-Q3,", None),
    ],
)
def test_prints_transactions_and_what_the_format_can_say_of_events(
    format_: Format, lines: int, transaction_part: str, event_part: str | None
) -> None:
    printed = _printed(format_)
    assert len(printed) == lines
    assert any(transaction_part in line for line in printed)
    assert event_part is None or event_part in printed[-1]


def test_a_table_has_the_figures_of_the_profile() -> None:
    assert "! FT1A-Q3 limit is 125" in _printed(Format.TABLE)[2]
