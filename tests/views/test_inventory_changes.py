"""What is new since a baseline, as lines."""

from __future__ import annotations

import io

from rich.console import Console

from mbtool.ledger.baseline import ChangeKind, InventoryChange
from mbtool.views.inventory_table import print_changes

CHANGES = [
    InventoryChange(kind=ChangeKind.HOST, host="10.0.0.7", port=502, unit=1, text="asked by X"),
    InventoryChange(
        kind=ChangeKind.RANGE,
        host="10.0.0.8",
        port=1502,
        unit=2,
        text="03 read holding registers reads 100..119 by 10.0.0.5, 10.0.0.6, 10.0.0.7",
    ),
]


def printed(width: int, *, terminal: bool = False) -> list[str]:
    out = io.StringIO()
    console = Console(file=out, width=width, force_terminal=terminal, color_system=None)
    print_changes(console, CHANGES)
    return out.getvalue().splitlines()


def test_on_a_pipe_each_change_is_a_line_with_its_kind_and_place() -> None:
    assert printed(40) == [
        "new host          10.0.0.7 unit 1       asked by X",
        "wider range       10.0.0.8:1502 unit 2  03 read holding registers reads 100..119 by "
        "10.0.0.5, 10.0.0.6, 10.0.0.7",
    ]


def test_on_a_terminal_a_text_that_is_too_long_stands_below() -> None:
    lines = [line.rstrip() for line in printed(60, terminal=True)]
    assert lines == [
        "new host          10.0.0.7 unit 1       asked by X",
        "wider range       10.0.0.8:1502 unit 2",
        "    03 read holding registers reads 100..119 by 10.0.0.5,",
        "    10.0.0.6, 10.0.0.7",
    ]


def test_control_characters_are_not_printed() -> None:
    out = io.StringIO()
    evil = InventoryChange(kind=ChangeKind.HOST, host="\x1b[31m", text="\x07")
    print_changes(Console(file=out, width=80), [evil])
    assert out.getvalue() == "new host          ?[31m  ?\n"
