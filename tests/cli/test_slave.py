"""mbtool slave, until a signal."""

from __future__ import annotations

import re
import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.workflows.asking import TcpMaster
from tests.cli.program import Program, endpoint_in, said
from tests.workflows.evidence import READ, VALUES

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_slave_says_where_it_is_and_answers_until_a_signal(tmp_path: Path, number: int) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = [4660, 22136]\n")
    link = "tcp:127.0.0.1:0"
    with Program("slave", "idec-ft1a-touch", "--on", link, "--image", image) as program:
        began = program.await_said("Ctrl-C ends")
        with TcpMaster(endpoint_in(began)) as master:
            assert master.ask(1, READ) == VALUES
        told = program.end(number)
    assert began.startswith("FT1A Touch operator interface, Modbus RTU slave as unit 1 on tcp:")
    assert (told.code, told.out, told.err) == (exit_codes.INTERRUPTED, "", "")


def test_it_shows_exchanges_and_outputs_and_keeps_its_state(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    link = "tcp:127.0.0.1:0"
    arguments = ("slave", "fa3-th1m16y", "--on", link, "--print", "--state", state)
    with Program(*arguments) as program:
        began = program.await_said("Ctrl-C ends")
        with TcpMaster(endpoint_in(began)) as master:
            assert master.ask(0, bytes.fromhex("05 0001 FF00")) is not None
            assert master.ask(0, bytes.fromhex("06 00F5 0007")) is not None
            program.await_said("outputs: Y1 on")
        told = program.end(signal.SIGINT)
    assert told.code == exit_codes.INTERRUPTED
    _, _, first, second = told.out.splitlines()
    assert re.search(r"05 write coil +Y1: on +ok", first)
    assert re.search(r"06 write register +00F5H Split reception monitoring timer: 7 s +ok", second)
    assert "00F5H = 7\n" in state.read_text()


def test_a_state_for_a_device_that_keeps_nothing_is_refused(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    told = said("slave", "idec-ft1a-touch", "--on", "tcp:127.0.0.1:0", "--state", state)
    assert told.code == exit_codes.USAGE
    assert (
        told.err == "mbtool: idec-ft1a-touch keeps nothing over a restart, so --state has no use\n"
    )
