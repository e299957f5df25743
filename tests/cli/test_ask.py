"""mbtool read and mbtool write."""

from __future__ import annotations

import json
import os
import pty
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.core import SerialLink, TcpLink
from mbtool.modbus import Response
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.sources.virtual_line import VirtualLine
from tests.cli.program import PATIENCE_S, Program, endpoint_in
from tests.slave.scripted import Scripted
from tests.workflows.bench import ANY, FAST
from tests.workflows.evidence import READ, REFUSED, VALUES

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.cli.program import CommandLine

TOUCH = ("--device", "idec-ft1a-touch")


@pytest.fixture
def script() -> Scripted:
    """Answers one read, and repeats every write; anything else has no such address."""

    def answer(unit: int, pdu: bytes) -> Response | None:
        if unit == 9:
            return None
        if pdu[0] in (5, 6):
            return Response(pdu)
        return Response(pdu[:5] if pdu[0] == 16 else VALUES if pdu == READ else REFUSED)

    return Scripted(answer)


@pytest.fixture
def slave(script: Scripted) -> Iterator[str]:
    with TcpSlave(TcpLink(ANY), script) as shell:
        yield str(TcpLink(shell.endpoint))


def test_reads_with_the_words_of_the_device(mbtool: CommandLine, slave: str) -> None:
    told = mbtool("read", slave, "HR400001..400002", *TOUCH)
    assert told.code == exit_codes.DONE
    assert told.lines[-1].endswith("  03 read HR400001..400002 -> 4660, 22136")
    assert told.err == "1 transaction: 1 ok\n"


def test_reads_on_a_serial_line(mbtool: CommandLine, script: Scripted) -> None:
    with VirtualLine(ends=2, format=FAST) as line:
        theirs, ours = line.ports
        with SerialSlave(SerialLink(theirs, FAST), script):
            told = mbtool("read", f"rtu:{ours}@115200-8N1", "hr 0..1", "--unit", "3")
    assert told.lines[-1].endswith("   3  03 read holding 0..1 -> 4660, 22136")
    assert script.asked == [(3, READ)]


def test_json_lines_are_those_of_decode(mbtool: CommandLine, slave: str) -> None:
    told = mbtool("read", slave, "HR400001..400002", *TOUCH, "--format", "jsonl")
    (row,) = (json.loads(line) for line in told.lines)
    assert row["outcome"] == "ok"
    assert row["response_values"] == [0x1234, 0x5678]
    assert row["reference"] == "HR400001..400002"
    assert row["request_raw"] == "00010000000601" + READ.hex()


def test_an_exception_and_no_answer_are_a_no(mbtool: CommandLine, slave: str) -> None:
    told = mbtool("read", slave, "HR404090", "HR400001..400002", *TOUCH)
    assert told.code == exit_codes.NO
    assert "-> 02 illegal data address" in told.out
    assert told.err == "2 transactions: 1 ok, 1 exception\n"
    told = mbtool("read", slave, "HR400001", "--unit", "9", "--timeout", "0.05")
    assert told.code == exit_codes.NO
    assert told.lines[-1].endswith("03 read holding 0 -> no answer")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("read", "tcp:127.0.0.1:1", "holding 0"), exit_codes.UNREADABLE, "cannot be reached"),
        (("read", "rtu:/dev/absent", "holding 0"), exit_codes.UNREADABLE, "is not there"),
        (("read", "net:eth0", "holding 0"), exit_codes.USAGE, "a master needs rtu:PORT"),
        (("read", "eth0", "holding 0"), exit_codes.USAGE, "write rtu:PORT@19200-8E1"),
        (("read", "tcp:127.0.0.1:1"), exit_codes.USAGE, "REFERENCE"),
        (("read", "tcp:127.0.0.1:1", "much"), exit_codes.USAGE, "'much' is no range"),
        (
            ("read", "tcp:127.0.0.1:1", "coil 0", "--unit", "256"),
            exit_codes.USAGE,
            "write a number from 0 to 255",
        ),
        (
            ("read", "tcp:127.0.0.1:1", "coil 0", "--device", "5=idec-ft1a-touch"),
            exit_codes.USAGE,
            "unit 1 is asked; see --unit",
        ),
        (
            ("read", "tcp:127.0.0.1:1", "coil 0", "--function", "ten"),
            exit_codes.USAGE,
            "--function: 'ten' is no function code",
        ),
        (("write", "tcp:127.0.0.1:1", "coil 0"), exit_codes.USAGE, "write REFERENCE=VALUE"),
        (
            ("poll", "tcp:127.0.0.1:1", "coil 0", "--every", "0"),
            exit_codes.USAGE,
            "--every 0: is shorter than 1 ms",
        ),
        (("poll", "tcp:127.0.0.1:1", "coil 0", "--every", "2026-11-22"), exit_codes.USAGE, "1h30m"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    mbtool: CommandLine, arguments: tuple[str, ...], code: int, message: str
) -> None:
    told = mbtool(*arguments)
    assert told.code == code
    assert told.err.startswith("mbtool: ")
    assert told.err.count("\n") == 1
    assert message in told.err


def test_each_write_is_one_request(mbtool: CommandLine, slave: str, script: Scripted) -> None:
    told = mbtool("write", slave, "HR400001=4660,22136", "C4=1", "--yes", *TOUCH)
    assert told.code == exit_codes.DONE
    assert [pdu.hex() for _, pdu in script.asked] == ["10000000020412345678", "050003ff00"]
    assert told.lines[-2].endswith("10 write HR400001..400002 := 4660, 22136")


def test_nothing_is_written_if_one_of_the_values_is_wrong(
    mbtool: CommandLine, slave: str, script: Scripted
) -> None:
    assert (
        mbtool("write", slave, "holding 0=1", "holding 1=70000", "--yes").code == exit_codes.USAGE
    )
    assert script.asked == []


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
@pytest.mark.parametrize(
    ("answer", "code", "written"),
    [(b"n\n", exit_codes.NO, 0), (b"y\n", exit_codes.DONE, 1)],
)
def test_at_a_terminal_a_write_asks_first(
    slave: str, script: Scripted, answer: bytes, code: int, written: int
) -> None:
    ours, theirs = pty.openpty()
    try:
        with Program("write", slave, "holding 0=5", stdin=theirs) as program:
            said = program.await_said("holding 0=5")
            os.write(ours, answer)
            told = program.end()
    finally:
        os.close(ours)
        os.close(theirs)
    assert said == f"write holding 0=5 to unit 1 at {slave}\n"
    assert told.code == code
    assert len(script.asked) == written
    with_yes = ("write", slave, "holding 0=5", "--yes")
    with Program(*with_yes) as program:
        assert program.process.wait(PATIENCE_S) == exit_codes.DONE


def test_reads_what_the_slave_command_has(tmp_path: Path, mbtool: CommandLine) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = [4660, 22136]\nC8 = 1\n")
    arguments = ("slave", "idec-ft1a-touch", "--on", "tcp:127.0.0.1:0", "--image", image)
    with Program(*arguments) as program:
        link = TcpLink(endpoint_in(program.await_said("Ctrl-C ends")))
        told = mbtool("read", link, "HR400001..400300", "C1..8", *TOUCH, "--wide")
    texts = [line.partition("    1  ")[2] for line in told.lines[-4:]]
    assert texts == [
        "03 read HR400001..400125 -> 4660, 22136, 0 x123",
        "03 read HR400126..400250 -> 0 x125",
        "03 read HR400251..400300 -> 0 x50",
        "01 read C1..8 -> 0 0 0 0 0 0 0 1",
    ]


def test_nothing_is_written_where_nobody_can_be_asked(
    mbtool: CommandLine, slave: str, script: Scripted
) -> None:
    told = mbtool("write", slave, "holding 0=5")
    assert told.code == exit_codes.USAGE
    assert told.err == (
        "mbtool: write: nobody can be asked here, as there is no terminal; give --yes\n"
    )
    assert script.asked == []
