"""Differences as text."""

from __future__ import annotations

import io
from collections import Counter

import pytest
from rich.console import Console

from mbtool.devices import Difference, Side
from mbtool.devices import DifferenceKind as Kind
from mbtool.views.differences import count_text, print_differences

VALUE = Difference(
    kind=Kind.VALUE,
    unit=5,
    reference="0102H",
    name="A/D conversion",
    what="written",
    a=Side(text="CH1 enabled"),
    b=Side(text="none enabled"),
)
SHIFT = Difference(
    kind=Kind.LATENCY,
    unit=5,
    function=3,
    reference="HR400001..400002",
    what="03 read holding",
    a=Side(text="8 ms, p95 11 ms"),
    b=Side(text="12 ms, p95 15 ms"),
    p=2.345e-7,
    alike=["HR400010", "HR400020..400022"],
)
GONE = Difference(
    kind=Kind.SLAVE,
    unit=7,
    link="10.0.0.9",
    what="slave",
    a=Side(text="3 transactions", count=3),
    b=Side(text="", count=0),
)


def shown(*found: Difference, width: int = 120) -> list[str]:
    file = io.StringIO()
    print_differences(Console(file=file, width=width), found)
    return [line.rstrip() for line in file.getvalue().splitlines()]


def test_each_slave_has_a_table_of_its_own() -> None:
    what = "HR400001..400002, HR400010, HR400020..400022 (p = 2.3e-07)"
    assert shown(VALUE, SHIFT, GONE) == [
        "unit 5",
        f"differs  function         {'what':<{len(what)}}  A                B",
        f"value    written          {'0102H A/D conversion':<{len(what)}}  CH1 enabled      "
        "none enabled",
        f"latency  03 read holding  {what}  8 ms, p95 11 ms  12 ms, p95 15 ms",
        "",
        "unit 7 on 10.0.0.9",
        "differs  function  what  A               B",
        "slave    slave           3 transactions  -",
        "",
    ]


def test_a_narrow_terminal_loses_nothing() -> None:
    letters = Counter("".join(shown(VALUE, width=40)))
    wanted = Counter("value written 0102H A/D conversion CH1 enabled none enabled")
    assert all(letters[one] >= count for one, count in wanted.items())


def test_names_are_not_obeyed() -> None:
    import msgspec

    odd = msgspec.structs.replace(VALUE, name="[red]\x1b[2J")
    assert "\x1b" not in "".join(shown(odd))
    assert "[red]" in "".join(shown(odd))


@pytest.mark.parametrize(("count", "text"), [(0, "0 differences"), (1, "1 difference")])
def test_differences_are_counted(count: int, text: str) -> None:
    assert count_text([VALUE] * count) == text
