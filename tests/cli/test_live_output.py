"""Rows of a recording before a reader that takes none, takes some late, or leaves."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.live_output import LiveOutput
from mbtool.cli.options import EventChoice, Format
from mbtool.cli.printers import printer_for
from tests.cli.program import full_pipe
from tests.logs.samples import transaction

if TYPE_CHECKING:
    from collections.abc import Iterator

ROW = 400
"""More than the bytes of one row of jsonl."""


@contextmanager
def output_to(descriptor: int, *, is_kept: bool = True) -> Iterator[LiveOutput]:
    with open(descriptor, "w", closefd=False, encoding="utf-8") as file:
        yield LiveOutput(
            file,
            "the pipe",
            lambda to: printer_for(Format.JSONL, to, lambda _: None),
            EventChoice.NONE,
            lambda _: True,
            None,
            is_kept=is_kept,
            is_hurried=lambda: True,
        )


@pytest.fixture
def small_queue(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbtool.cli.view_queue.MAX_WAITING", 10 * ROW)


@pytest.mark.usefixtures("small_queue")
def test_rows_that_find_no_room_are_counted_and_told_before_the_next_row(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with full_pipe() as (reading, writing), output_to(writing) as output:
        for _ in range(100):
            output.add(transaction())
        held = output._not_shown
        assert 0 < held < 100
        assert output.sentence() == "100 transactions: 100 ok"
        assert capsys.readouterr().err == ""
        while output._queue is not None and output._queue.is_full:
            os.read(reading, 4096)
        output.add(transaction())
        told = f"mbtool: {held} rows not shown: the pipe did not take them in time\n"
        assert capsys.readouterr().err == told


@pytest.mark.usefixtures("small_queue")
def test_the_end_waits_for_no_reader_and_tells_what_was_not_shown(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with full_pipe() as (_, writing), output_to(writing) as output:
        for _ in range(100):
            output.add(transaction())
        output.finish()
    *_, rows, last = capsys.readouterr().err.splitlines()
    assert rows.endswith("rows not shown: the pipe did not take them in time")
    assert last == "mbtool: the pipe takes no text, so the last rows are not shown"


def test_a_reader_that_leaves_is_told_once_if_a_log_keeps_the_rows(
    capsys: pytest.CaptureFixture[str],
) -> None:
    reading, writing = os.pipe()
    with output_to(writing) as output:
        os.close(reading)
        output.add(transaction())
        output.finish()
        output.add(transaction())
        output.finish()
    os.close(writing)
    told = "mbtool: nobody reads the pipe any more; the recording goes on\n"
    assert capsys.readouterr().err == told
    assert output.sentence() == "2 transactions: 2 ok"


def test_a_terminal_that_is_gone_is_a_reader_that_has_left(
    capsys: pytest.CaptureFixture[str],
) -> None:
    reading, writing = os.openpty()
    with output_to(writing) as output:
        os.close(reading)
        output.add(transaction())
        output.finish()
    os.close(writing)
    told = "mbtool: nobody reads the pipe any more; the recording goes on\n"
    assert capsys.readouterr().err == told


def test_a_reader_that_leaves_ends_a_run_whose_rows_nothing_keeps() -> None:
    reading, writing = os.pipe()
    with output_to(writing, is_kept=False) as output:
        os.close(reading)
        output.add(transaction())
        with pytest.raises(BrokenPipeError):
            output.finish()
    os.close(writing)
