"""mbtool poll."""

from __future__ import annotations

import json
import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.options import Format, condition
from mbtool.cli.output import open_output
from mbtool.cli.poll import Polling
from mbtool.cli.talk import Interrupt
from mbtool.core import TcpLink
from mbtool.master.other_master import NoPauseError
from mbtool.modbus import Response
from mbtool.slave.shells import TcpSlave
from mbtool.workflows.ask import Asker, PollTally
from tests.cli.program import Program
from tests.ledger.requests import request
from tests.slave.scripted import Scripted
from tests.workflows.bench import ANY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mbtool.core import WireEvent
    from mbtool.devices import NamedTransaction
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


class Hidden(Asker):
    """Gives what it is told to; what is an error is raised."""

    def __init__(self, given: Sequence[NamedTransaction | NoPauseError]) -> None:
        self._given = iter(given)
        self.listened_ns = 0

    def ask(self, pdu: bytes) -> tuple[NamedTransaction, list[WireEvent]]:
        given = next(self._given)
        if isinstance(given, NoPauseError):
            raise given
        return given, []

    def stop_when(self, is_stopped: Callable[[], bool]) -> None:
        self.is_stopped = is_stopped

    def listen(self, time_ns: int) -> None:
        self.listened_ns += time_ns


def polled(given: Sequence[NamedTransaction | NoPauseError]) -> tuple[Hidden, PollTally]:
    asker, tally = Hidden(given), PollTally()
    with open_output(None, Format.JSONL, None, lambda _: None, condition(None)) as out:
        polling = Polling(asker, out, [bytes.fromhex("03 0000 0001")], None, tally, is_table=False)
        polling.run(Interrupt(), 1, 2)
    return asker, tally


NO_PAUSE = NoPauseError("rtu:/dev/x: the other master left no pause of 412 ms")


def test_waits_for_a_pause_as_long_as_asked_once_there_was_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    one = request(0, 10, response_values=[1])
    asker, tally = polled([one, NO_PAUSE, NO_PAUSE, NO_PAUSE, one])
    told = capsys.readouterr()
    assert (tally.outcomes.total(), told.out.count("\n")) == (2, 2)
    assert told.err.count("poll waits for a longer pause\n") == 1
    assert asker.listened_ns > 1e9


def test_ctrl_c_ends_the_wait_for_a_pause() -> None:
    interrupt = Interrupt()

    class Asked(Hidden):
        def ask(self, pdu: bytes) -> tuple[NamedTransaction, list[WireEvent]]:
            interrupt.ask(signal.SIGINT, None)
            assert self.is_stopped()
            return super().ask(pdu)

    with open_output(None, Format.JSONL, None, lambda _: None, condition(None)) as out:
        asker, tally = Asked([NO_PAUSE]), PollTally()
        Polling(asker, out, [b"\3\0\0\0\1"], None, tally, is_table=False).run(interrupt, 1, None)
    assert not tally.outcomes


def test_sends_nothing_where_no_pause_was_ever_long_enough() -> None:
    with pytest.raises(NoPauseError):
        polled([NO_PAUSE])


def test_ends_with_a_summary_on_a_signal(counting: tuple[str, Scripted]) -> None:
    link, script = counting
    with Program("poll", link, "hr 0..1", "--every", "1h") as program:
        program.await_said("Ctrl-C ends")
        script.await_asked(1)
        told = program.end(signal.SIGINT)
    assert told.code == exit_codes.INTERRUPTED
    assert told.err.startswith("asked 1, answered ")
    assert "03 read holding 0..1" in told.out
