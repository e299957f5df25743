"""A table of runs is that of the transactions one by one, to the byte."""

from __future__ import annotations

import io
import random
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest
from rich.console import Console

from mbtool.columns import portions, usual_runs
from mbtool.columns.usual_runs import UsualRuns
from mbtool.core import WireEvent
from mbtool.decode.usual_run import UsualRun
from mbtool.views.table_options import TableColumn, TableOptions, TimeStyle
from mbtool.views.transaction_table import TransactionTable
from tests.columns import both_ways
from tests.columns.both_ways import blocks_of, damaged, generated, records_of
from tests.columns.disturbed_captures import disturbed
from tests.columns.test_equality import encoded, every_form, poll
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mbtool.decode.decoder import Record
    from mbtool.views.tables import RowForm

MIDNIGHT_NS = 1_767_225_600_000_000_000
"""2026-01-01 00:00 UTC."""

OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"columns": tuple(TableColumn), "in_hex": True},
    {"columns": (TableColumn.PACKET, TableColumn.TIME), "time": TimeStyle.DELTA},
    {"time": TimeStyle.RELATIVE},
    {"time": TimeStyle.LOCAL, "wide": True},
)


def printed(options: dict[str, Any], add_all: Callable[[TransactionTable], None]) -> str:
    file = io.StringIO()
    table = TransactionTable(Console(file=file, width=60), TableOptions(**options), sample=1)
    add_all(table)
    table.flush()
    return file.getvalue()


def add(table: TransactionTable, number: int, record: Record) -> int:
    """Add a record as `decode` does; return the number of transactions up to it."""
    number += not isinstance(record, WireEvent)
    if not isinstance(record, WireEvent) or record.kind.value not in ("opened", "closed"):
        table.add(number, record)
    return number


def one_by_one(records: Iterable[Record], options: dict[str, Any]) -> str:
    def add_all(table: TransactionTable) -> None:
        number = 0
        for record in records:
            number = add(table, number, record)

    return printed(options, add_all)


def in_runs(capture: bytes, options: dict[str, Any], block_packets: int) -> tuple[str, int]:
    """The table, and how many of its rows came in runs."""
    joined = 0

    def add_all(table: TransactionTable) -> None:
        nonlocal joined
        runs: UsualRuns[RowForm] = UsualRuns(table.form_of, singly=1)
        number = 0
        for block in blocks_of(capture, block_packets)[0]:
            for part in runs.parts(block):
                if isinstance(part, UsualRun):
                    table.add_run(number + 1, part)
                    joined, number = joined + len(part), number + len(part)
                else:
                    number = add(table, number, part)

    return printed(options, add_all), joined


def assert_equal(capture: bytes, block_packets: int = 65_536) -> int:
    """Both ways print the same; return how many rows came in runs."""
    records, _ = records_of(capture)
    joined = 0
    for options in OPTIONS:
        text, joined = in_runs(capture, options, block_packets)
        assert text == one_by_one(records, options)
    return joined


def test_each_form_of_pdu_gives_equal_rows() -> None:
    assert assert_equal(every_form()) > 30


@pytest.mark.parametrize("number", range(6))
def test_disturbed_captures_give_equal_tables(number: int) -> None:
    rng = random.Random(f"tables {number}")
    capture = disturbed(number) if number % 2 else generated(number)
    most = rng.choice((30, portions.MOST_VALUES))
    with (
        patch.object(usual_runs, "MOST", rng.choice((2, 4096))),
        patch.object(portions, "MOST_VALUES", most),
    ):
        assert_equal(damaged(capture, rng), rng.choice((17, 100, 65_536)))


def test_a_new_day_within_a_run_has_its_heading() -> None:
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 8)]
    shift_ns = MIDNIGHT_NS - packets[10].ts_ns
    capture = pcap([replace(one, ts_ns=one.ts_ns + shift_ns) for one in packets])
    assert assert_equal(capture) > 5
    text, _ = in_runs(capture, {}, 65_536)
    headings = [line for line in text.splitlines() if line.endswith("UTC")]
    assert headings == ["2025-12-31 UTC", "2026-01-01 UTC"]


def test_equal_values_in_a_row_are_counted_and_control_characters_replaced() -> None:
    talk = Talk()
    form = 0x03, {"address": 0, "quantity": 6}, {"values": (7, 7, 7, 7, 1, 7)}
    capture = pcap([*talk.handshake(), *poll(talk, 4, *encoded(form))])
    with patch.object(both_ways, "NAME", "a\x1b%s.pcap"):
        assert assert_equal(capture) > 1
        text, _ = in_runs(capture, {"columns": (TableColumn.FILE,)}, 65_536)
    assert text.splitlines()[-1] == "a?%s.pcap             03 read holding 0..5 -> 7 x4, 1, 7"
