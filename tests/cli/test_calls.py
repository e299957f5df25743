"""The number of Python calls that one transaction costs, from a file to its row."""

# Calls are counted because they are the same on every machine; a clock is not. Two files of
# different length are decoded, so that what a file costs once does not count.

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from mbtool.cli.main import run
from mbtool.views.transaction_table import SAMPLE
from mbtool.workflows.shared import reading_choice
from tests.benchmarks.file_workloads import CONNECTIONS, clean, make_capture, make_serial

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from tests.benchmarks.file_workloads import Made

FEW, MANY = 100, 300
"""Transactions of the two files."""


def _capture(folder: Path, transactions: int) -> Made:
    handshakes = 3 * CONNECTIONS
    return make_capture(folder / f"{transactions}.pcap", clean, handshakes + 2 * transactions)


def _line(folder: Path, transactions: int) -> Made:
    return make_serial(folder / f"{transactions}.bin", 2 * transactions)


def _calls(made: Made, format_: str) -> int:
    """The number of Python functions called or generators resumed to decode a file."""
    calls = 0

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    # Standard output under pytest takes calls of its own.
    output = ["--output", str(made.path.with_suffix(".rows")), "--overwrite"]
    sys.setprofile(count)
    try:
        assert run(["decode", str(made.path), *made.options, "--format", format_, *output]) == 0
    finally:
        sys.setprofile(None)
    return calls


def _calls_per_transaction(few: Made, many: Made, format_: str) -> float:
    _calls(few, format_)  # Fills caches and loads modules.
    added = many.transactions - few.transactions
    return (_calls(many, format_) - _calls(few, format_)) / added


def test_a_row_of_a_tcp_transaction_takes_few_calls(tmp_path: Path) -> None:
    few, many = _capture(tmp_path, FEW), _capture(tmp_path, MANY)
    jsonl = _calls_per_transaction(few, many, "jsonl")
    assert 50 < jsonl <= 130
    assert _calls_per_transaction(few, many, "csv") <= 1.01 * jsonl
    assert _calls_per_transaction(few, many, "table") <= 1.3 * jsonl


def test_a_row_of_a_table_from_arrays_takes_a_tenth_of_the_calls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, many = _capture(tmp_path, SAMPLE + FEW), _capture(tmp_path, SAMPLE + MANY)
    monkeypatch.setattr(reading_choice, "WORTH_BYTES", 0)
    assert 3 < _calls_per_transaction(few, many, "table") <= 13


def test_a_row_of_a_serial_line_takes_few_calls(tmp_path: Path) -> None:
    few, many = _line(tmp_path, FEW), _line(tmp_path, MANY)
    assert 50 < _calls_per_transaction(few, many, "jsonl") <= 146
