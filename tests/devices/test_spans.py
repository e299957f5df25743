from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.devices.loading import load_profile
from mbtool.devices.references import write_reference
from mbtool.devices.spans import Span, parse_span
from mbtool.modbus import Table

FT1A = load_profile("idec-ft1a-touch")
AT1M8X = load_profile("fa3-at1m8x")


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("HR400010..400020", Span(Table.HOLDING_REGISTERS, 9, 19)),
        ("hr400010..HR400020", Span(Table.HOLDING_REGISTERS, 9, 19)),
        ("C1", Span(Table.COILS, 0, 0)),
        ("0105H..010EH", Span(Table.HOLDING_REGISTERS, 0x105, 0x10E)),
        ("0105..010EH", None),
        ("X0..XF", Span(Table.DISCRETE_INPUTS, 0, 15)),
        ("RWr2..RWr9", Span(Table.INPUT_REGISTERS, 2, 9)),
        ("holding 10..20", Span(Table.HOLDING_REGISTERS, 10, 20)),
        ("input:7", Span(Table.INPUT_REGISTERS, 7, 7)),
        ("hr 0x10..0x1F", Span(Table.HOLDING_REGISTERS, 16, 31)),
        ("HR 7", Span(Table.HOLDING_REGISTERS, 7, 7)),
        ("ir:7", Span(Table.INPUT_REGISTERS, 7, 7)),
        ("co 1..0x3", Span(Table.COILS, 1, 3)),
        ("di 0", Span(Table.DISCRETE_INPUTS, 0, 0)),
        ("hr7", None),
        ("holding 0x1G", None),
        ("holding 0x10000", None),
        ("coil 0..65535", Span(Table.COILS, 0, 65535)),
        ("coil 0..65536", None),
        ("holding 20..10", None),
        ("HR400020..400010", None),
        ("HR400010..C20", None),
        ("nonsense", None),
        ("", None),
        ("..", None),
    ],
)
def test_reads_what_a_user_writes(text: str, span: Span | None) -> None:
    if span is not None:
        assert parse_span(text, [FT1A, AT1M8X]) == span
        return
    with pytest.raises(UsageError, match=r"range"):
        parse_span(text, [FT1A, AT1M8X])


def test_reads_what_mbtool_writes() -> None:
    for profile in (FT1A, AT1M8X, None):
        for area in (FT1A if profile is None else profile).areas:
            text = write_reference(profile, area.table, area.first, 5)
            assert parse_span(text, [] if profile is None else [profile]) == Span(
                area.table, area.first, area.first + 4
            )


def test_a_span_has_its_ends() -> None:
    span = Span(Table.COILS, 3, 5)
    assert [address for address in range(9) if address in span] == [3, 4, 5]
