"""mbtool poll."""

from __future__ import annotations

import json
import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.core import TcpLink
from mbtool.modbus import Response
from mbtool.slave.shells import TcpSlave
from tests.cli.program import Program
from tests.slave.scripted import Scripted
from tests.workflows.bench import ANY

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.cli.program import CommandLine


@pytest.fixture
def counting() -> Iterator[tuple[str, Scripted]]:
    """A slave whose register 1 counts every second request; register 0 stands."""
    script = Scripted(
        lambda _unit, _pdu: Response(bytes([3, 4, 0, 7, 0, (len(script.asked) - 1) // 2]))
    )
    with TcpSlave(TcpLink(ANY), script) as shell:
        yield str(TcpLink(shell.endpoint)), script


ROUNDS = ("--every", "1ms", "--count", "4")


def test_shows_the_first_answer_and_then_what_changes(
    mbtool: CommandLine, counting: tuple[str, Scripted]
) -> None:
    told = mbtool("poll", counting[0], "HR400001..400002", "--device", "idec-ft1a-touch", *ROUNDS)
    assert told.code == exit_codes.DONE
    first, third = told.lines[-2:]
    assert first.endswith("  03 read HR400001..400002 -> 7, 0")
    assert third.startswith("    3 ")
    assert third.endswith("  03 read HR400001..400002 -> HR400002: 1 (was 0)")
    _, summary = told.err.splitlines()
    assert summary.startswith("asked 4, answered 4, failed 0; latency ")


def test_json_lines_are_whole_transactions(
    mbtool: CommandLine, counting: tuple[str, Scripted]
) -> None:
    told = mbtool("poll", counting[0], "hr 0..1", *ROUNDS, "--format", "jsonl")
    rows = [json.loads(line) for line in told.lines]
    assert [row["response_values"] for row in rows] == [[7, 0], [7, 1]]
    assert all("points" not in row for row in rows)


def test_shows_every_answer_if_asked_to(
    mbtool: CommandLine, counting: tuple[str, Scripted]
) -> None:
    told = mbtool("poll", counting[0], "hr 0..1", *ROUNDS, "--all", "--format", "jsonl")
    assert len(told.lines) == 4


def test_a_failed_poll_is_a_no(mbtool: CommandLine) -> None:
    with TcpSlave(TcpLink(ANY), Scripted(lambda _unit, _pdu: Response(b"\x83\x02"))) as shell:
        told = mbtool("poll", TcpLink(shell.endpoint), "hr 0..1", *ROUNDS)
    assert told.code == exit_codes.NO
    assert "asked 4, answered 0, failed 4 (4 exception)" in told.err
    assert len([line for line in told.lines if "illegal data address" in line]) == 1


def test_ends_with_a_summary_on_a_signal(counting: tuple[str, Scripted]) -> None:
    link, script = counting
    with Program("poll", link, "hr 0..1", "--every", "1h") as program:
        program.await_said("Ctrl-C ends")
        script.await_asked(1)
        told = program.end(signal.SIGINT)
    assert told.code == exit_codes.INTERRUPTED
    assert told.err.startswith("asked 1, answered ")
    assert "03 read holding 0..1" in told.out
