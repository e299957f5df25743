"""mbtool slave, until a signal."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.workflows.asking import TcpMaster
from tests.cli.program import Program, endpoint_in
from tests.workflows.evidence import READ, VALUES

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_slave_says_where_it_is_and_answers_until_a_signal(tmp_path: Path, number: int) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = [4660, 22136]\n")
    link = "tcp:127.0.0.1:0"
    with Program("slave", "idec-ft1a-touch", "--on", link, "--image", image) as program:
        said = program.await_said("Ctrl-C ends")
        with TcpMaster(endpoint_in(said)) as master:
            assert master.ask(1, READ) == VALUES
        told = program.end(number)
    assert said.startswith("FT1A Touch operator interface, Modbus RTU slave as unit 1 on tcp:")
    assert (told.code, told.out, told.err) == (exit_codes.INTERRUPTED, "", "")
