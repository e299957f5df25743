"""The commands that answer until someone stops them: slave, replay and line."""

from __future__ import annotations

import re
import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.replay import MissChoice
from mbtool.core import Endpoint, SerialLink
from mbtool.replay import OnMiss
from mbtool.workflows.asking import RtuMaster, TcpMaster
from tests.cli.program import Program
from tests.packets.building import pcap
from tests.workflows.bench import FAST
from tests.workflows.evidence import READ, VALUES, captured

if TYPE_CHECKING:
    from pathlib import Path

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


def _endpoint(said: str) -> Endpoint:
    match = re.search(r"tcp:127\.0\.0\.1:(\d+)", said)
    assert match is not None, said
    return Endpoint("127.0.0.1", int(match[1]))


@SIGNALS
def test_a_slave_says_where_it_is_and_answers_until_a_signal(tmp_path: Path, number: int) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = [4660, 22136]\n")
    link = "tcp:127.0.0.1:0"
    with Program("slave", "idec-ft1a-touch", "--on", link, "--image", image) as program:
        said = program.await_said("Ctrl-C ends")
        with TcpMaster(_endpoint(said)) as master:
            assert master.ask(1, READ) == VALUES
        told = program.end(number)
    assert said.startswith("FT1A Touch operator interface, Modbus RTU slave as unit 1 on tcp:")
    assert (told.code, told.out, told.err) == (exit_codes.INTERRUPTED, "", "")


@SIGNALS
def test_a_replay_answers_until_a_signal(capture: Path, number: int) -> None:
    arguments = ["--as-slave", "--on", "tcp:127.0.0.1:0", "--speed", "max"]
    with Program("replay", capture, *arguments) as program:
        said = program.await_said("Ctrl-C ends")
        with TcpMaster(_endpoint(said)) as master:
            assert master.ask(1, READ) == VALUES
        told = program.end(number)
    assert said.startswith(f"{capture}: 1 different requests to unit 1 on tcp:127.0.0.1:")
    assert (told.code, told.out, told.err) == (exit_codes.INTERRUPTED, "", "")


def test_a_replay_of_a_cut_capture_says_so_and_plays_what_comes_before(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcap"
    path.write_bytes(pcap(captured(1))[:-1])
    with Program("replay", path, "--as-slave", "--on", "tcp:127.0.0.1:0") as program:
        assert "playing what comes before" in program.await_said("cut.pcap")
        with TcpMaster(_endpoint(program.await_said("Ctrl-C ends"))) as master:
            assert master.ask(1, READ) == VALUES
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED


def test_the_choices_for_a_miss_are_the_players() -> None:
    assert [one.value for one in MissChoice] == [one.value for one in OnMiss]


@SIGNALS
def test_a_line_is_there_until_a_signal(tmp_path: Path, number: int) -> None:
    ends = [tmp_path / "slave", tmp_path / "master"]
    with Program("line", *ends, "--settings", str(FAST)) as program:
        assert program.process.stdout is not None
        assert [program.process.stdout.readline() for _ in ends] == [f"{end}\n" for end in ends]
        program.await_said("2 ends of one line at 115200-8N1; Ctrl-C takes it down")
        with Program("slave", "idec-ft1a-touch", "--on", f"rtu:{ends[0]}@{FAST}") as slave:
            slave.await_said("Ctrl-C ends")
            with RtuMaster(SerialLink(str(ends[1]), FAST)) as master:
                assert master.ask(1, READ) == bytes.fromhex("03 04 0000 0000")
            assert slave.end(signal.SIGINT).code == exit_codes.INTERRUPTED
        assert program.end(number).code == exit_codes.INTERRUPTED
    assert list(tmp_path.iterdir()) == []
