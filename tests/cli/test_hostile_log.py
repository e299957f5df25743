"""A log from anyone may hold any text and number; no command passes them on to a terminal."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.devices import PointValue
from mbtool.logs import LogWriter
from mbtool.modbus import Outcome, Transport
from tests.logs.samples import START_NS, transaction

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine

EVIL = "=cmd|'/c calc'!A1<script>&\x1b]0;owned\x07\x1b[31m\u202e"
NETWORK = {
    "transport": Transport.TCP,
    "link": EVIL,
    "source": f"{EVIL}:1",
    "destination": f"{EVIL}:502",
    "source_mac": EVIL,
    "destination_mac": EVIL,
    "reference": EVIL,
    "function_name": EVIL,
}
POINT = PointValue(name=EVIL, reference=EVIL, value=1, text=EVIL, unit=EVIL)

COMMANDS = (
    "decode LOG --events all",
    "decode LOG --format jsonl --events all",
    "decode LOG --format csv",
    "decode LOG --columns number,link,master,slave,device,outcome,packet,file",
    "stats LOG",
    "stats LOG --json",
    "inventory LOG",
    "inventory LOG --all",
    "inventory LOG --format json",
    "inventory LOG --format csv",
    "inventory LOG --baseline CALM",
    "inventory LOG --baseline CALM --format csv",
    "inventory CALM --baseline LOG",
    "check LOG",
    "check LOG --all",
    "check LOG --format json",
    "check LOG --format sarif",
    "devices --match LOG",
    "devices --match LOG --format jsonl",
    "devices draft LOG",
    "diff LOG CALM",
    "diff CALM LOG",
    "convert LOG OUT.csv",
    "convert LOG OUT.mcap",
    "recover LOG -o OUT.mcap",
    "report LOG -o OUT.html",
)
OF_CELLS = tuple(one for one in COMMANDS if "csv" in one and "convert" not in one)
"""Commands that print CSV."""
LEAVING_OUT = ("decode", "stats", "inventory", "check")
"""Commands that tell of messages which were left out."""


@pytest.fixture
def logs(tmp_path: Path) -> dict[str, Path]:
    """A hostile log, a calm one, and the beginning of the names of outputs."""
    paths = {name: tmp_path / f"{name}.mcap" for name in ("LOG", "CALM")}
    with LogWriter(paths["LOG"], capture={"host": EVIL}) as log:
        log.add_link(EVIL, {"spec": EVIL})
        log.add_device(EVIL, EVIL)
        for number in range(8):
            log.write(transaction(number * 1000, device=EVIL, points=[POINT], **NETWORK))
        refused = {"outcome": Outcome.EXCEPTION, "exception": 2, "exception_name": EVIL}
        log.write(transaction(9000, findings=["MB-103"], **refused, **NETWORK))
        log.write(transaction(9001, unit=-5))
        log.write(transaction(9002, latency_ns=-1))
        log.write(
            WireEvent(
                ts_ns=START_NS,
                link=EVIL,
                kind=EventKind.FOREIGN,
                message=EVIL,
                source=EVIL,
                destination=EVIL,
                raw=b"\x1b[31m",
            )
        )
    with LogWriter(paths["CALM"], capture={}) as log:
        log.write(transaction())
    return {**paths, "OUT": tmp_path / "out"}


def filled(command: str, logs: dict[str, Path]) -> list[str]:
    for name, path in logs.items():
        command = command.replace(name, str(path))
    return command.split()


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_prints_what_a_terminal_would_obey(
    mbtool: CommandLine, logs: dict[str, Path], command: str
) -> None:
    said = mbtool(*filled(command, logs))
    assert said.code in (0, 1, 2)
    assert [one for one in said.out + said.err if not (one.isprintable() or one == "\n")] == []


@pytest.mark.parametrize("command", OF_CELLS)
def test_no_cell_is_a_formula(mbtool: CommandLine, logs: dict[str, Path], command: str) -> None:
    said = mbtool(*filled(command, logs))
    cells = [cell for row in csv.reader(io.StringIO(said.out)) for cell in row]
    assert any("cmd|" in cell for cell in cells)
    assert [cell for cell in cells if cell.startswith(("=", "+", "@", "\t", "\r"))] == []


def test_a_converted_log_has_no_cell_that_is_a_formula(
    mbtool: CommandLine, logs: dict[str, Path]
) -> None:
    assert mbtool(*filled("convert LOG OUT.csv", logs)).code == 0
    text = logs["OUT"].with_suffix(".csv").read_text()
    cells = [cell for row in csv.reader(io.StringIO(text)) for cell in row]
    assert [cell for cell in cells if cell.startswith(("=", "+", "@"))] == []
    assert all(one.isprintable() or one in "\r\n" for one in text)


@pytest.mark.parametrize("command", LEAVING_OUT)
def test_impossible_numbers_are_left_out_and_told(
    mbtool: CommandLine, logs: dict[str, Path], command: str
) -> None:
    said = mbtool(command, logs["LOG"])
    assert "2 messages of the log left out, with numbers that nothing on a wire has" in said.err
    assert "-5" not in said.out.partition("unreadable")[0]
