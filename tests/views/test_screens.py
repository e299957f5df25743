"""What decode shows of whole captures on a terminal of 80x24."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import pytest
from rich.console import Console

from mbtool.core import WireEvent
from mbtool.devices.assignment import Assignments, parse_assignment
from mbtool.views.table_options import TableOptions
from mbtool.views.transaction_table import TransactionTable
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.screens import SHOWN

if TYPE_CHECKING:
    from pathlib import Path

SCREEN = 23
"""Lines of a terminal of 24 above the prompt."""
ORDINARY = ("ft1a-line", "units-in-turn", "fa3-network", "scan", "points")


def lines_of(name: str, folder: Path, width: int, *, full: bool = False) -> list[str]:
    """All lines of the table of a capture on a terminal of this width."""
    shown = SHOWN[name]
    path = folder / f"{name}.pcap"
    path.write_bytes(shown.make())
    devices = Assignments([parse_assignment(one) for one in shown.options[1::2]])
    reading = Reading([str(path)], ReadingOptions(assignments=devices))
    file = io.StringIO()
    console = Console(file=file, width=width, force_terminal=True, color_system=None)
    table = TransactionTable(console, TableOptions(full=full))
    number = 0
    for record in reading.records():
        if isinstance(record, WireEvent):
            continue
        number += 1
        table.add(number, record, reading.profile_for(record))
    table.flush()
    return file.getvalue().splitlines()


def rows(lines: list[str]) -> list[int]:
    return [int(line[:5]) for line in lines if line[:5].strip().isdigit() and line[5] == " "]


@pytest.mark.parametrize("name", ORDINARY)
def test_a_screen_of_80x24_has_at_least_18_ordinary_transactions(name: str, tmp_path: Path) -> None:
    lines = lines_of(name, tmp_path, 80)
    assert len(rows(lines[-SCREEN:])) >= 18
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("name", SHOWN)
@pytest.mark.parametrize("width", [60, 80, 120])
def test_every_line_fits_and_every_transaction_has_one_row(
    name: str, width: int, tmp_path: Path
) -> None:
    for full in (False, True):
        lines = lines_of(name, tmp_path, width, full=full)
        assert max(map(len, lines)) <= width
        assert rows(lines) == list(range(1, len(rows(lines)) + 1))
        assert any("--full" in line for line in lines) is (
            not full and name in ("registers", "bits")
        )
