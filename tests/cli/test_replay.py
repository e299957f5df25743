"""mbtool replay, until Ctrl-C."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, get_args

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.replay_options import EndChoice, MatchChoice, MissChoice
from mbtool.core import TcpLink
from mbtool.master.links import open_master
from mbtool.modbus import rtu_adu
from mbtool.replay import MatchStrategy, OnEnd, OnMiss
from tests.cli.program import CommandLine, Program, endpoint_in
from tests.logs.samples import transaction, write_log
from tests.packets.building import pcap
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.evidence import READ, VALUES, captured, damaged_log

if TYPE_CHECKING:
    from enum import StrEnum
    from pathlib import Path


def test_a_replay_answers_until_ctrl_c(capture: Path) -> None:
    arguments = ["--as-slave", "--on", "tcp:127.0.0.1:0", "--speed", "max"]
    with Program("replay", capture, *arguments) as program:
        said = program.await_said("Ctrl-C ends")
        with open_master(TcpLink(endpoint_in(said)), MASTER_TIMEOUT_NS) as master:
            assert master.ask(1, READ) == VALUES
        told = program.end(signal.SIGINT)
    assert said.startswith(f"{capture}: 1 request to unit 1 on tcp:127.0.0.1:")
    assert (told.code, told.out) == (exit_codes.INTERRUPTED, "")
    assert told.err.splitlines() == [
        "slave                   asked  recorded  image  profile  unknown",
        "127.0.0.1:0                 1         1      0        0        0",
    ]


def test_requests_that_were_never_recorded_are_marked_and_counted(capture: Path) -> None:
    arguments = ["--as-slave", "--on", "tcp:127.0.0.1:0", "--speed", "max", "--print"]
    other, command = bytes.fromhex("03 ffff 0001"), bytes.fromhex("08 0000 1234")
    with Program("replay", capture, *arguments) as program:
        said = program.await_said("Ctrl-C ends")
        with open_master(TcpLink(endpoint_in(said)), MASTER_TIMEOUT_NS) as master:
            for request in (READ, other, command, other):
                master.ask(1, request)
        told = program.end(signal.SIGINT)
    rows = [line.split("  ", 3)[-1].strip() for line in told.out.splitlines()]
    marks = [at for at, row in enumerate(rows) if "the request above was never recorded" in row]
    assert len(marks) == 3
    assert ["65535" in rows[at - 1] for at in marks] == [True, False, True]
    assert (
        told.err.splitlines()[-1]
        == "never recorded: unit 1 03 holding 65535 (2 times); unit 1 08 (1 time)"
    )


def test_several_requests_and_units_are_said_as_such(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_log(path, [transaction(unit=unit, request_raw=rtu_adu(unit, READ)) for unit in (1, 2)])
    with Program("replay", path, "--as-slave", "--on", "tcp:127.0.0.1:0") as program:
        said = program.await_said("Ctrl-C ends")
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED
    assert said.startswith(f"{path}: 2 different requests to units 1, 2 on tcp:127.0.0.1:")


def test_a_recording_without_a_request_is_an_input_that_cannot_be_read(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap([]))
    told = mbtool("replay", path, "--as-slave", "--on", "tcp:127.0.0.1:0")
    assert told.code == exit_codes.UNREADABLE
    assert "no request to play an answer for" in told.err


def test_a_replay_of_a_cut_capture_says_so_and_plays_what_comes_before(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcap"
    path.write_bytes(pcap(captured(1))[:-1])
    with Program("replay", path, "--as-slave", "--on", "tcp:127.0.0.1:0") as program:
        assert "playing what is there" in program.await_said("cut.pcap")
        with open_master(
            TcpLink(endpoint_in(program.await_said("Ctrl-C ends"))), MASTER_TIMEOUT_NS
        ) as master:
            assert master.ask(1, READ) == VALUES
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED


def test_a_replay_of_a_damaged_log_says_so_and_plays_the_rest(tmp_path: Path) -> None:
    path = damaged_log(tmp_path / "a.mcap", 1)
    with Program("replay", path, "--as-slave", "--on", "tcp:127.0.0.1:0") as program:
        said = program.await_said("damaged at byte")
        with open_master(
            TcpLink(endpoint_in(program.await_said("Ctrl-C ends"))), MASTER_TIMEOUT_NS
        ) as master:
            assert master.ask(1, READ) == VALUES
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED
    assert said.startswith(f"mbtool: {path}: damaged at byte ")
    assert said.endswith("; mbtool recover makes a whole log of it; playing what is there\n")


@pytest.mark.parametrize(
    ("choices", "players"),
    [(MissChoice, OnMiss), (MatchChoice, MatchStrategy), (EndChoice, OnEnd)],
)
def test_the_choices_are_the_players(choices: object, players: type[StrEnum]) -> None:
    assert list(get_args(choices)) == [one.value for one in players]
