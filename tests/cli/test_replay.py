"""mbtool replay, until Ctrl-C."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

from mbtool.cli import exit_codes
from mbtool.cli.replay import MissChoice
from mbtool.replay import OnMiss
from mbtool.workflows.asking import TcpMaster
from tests.cli.program import Program, endpoint_in
from tests.packets.building import pcap
from tests.workflows.evidence import READ, VALUES, captured

if TYPE_CHECKING:
    from pathlib import Path


def test_a_replay_answers_until_ctrl_c(capture: Path) -> None:
    arguments = ["--as-slave", "--on", "tcp:127.0.0.1:0", "--speed", "max"]
    with Program("replay", capture, *arguments) as program:
        said = program.await_said("Ctrl-C ends")
        with TcpMaster(endpoint_in(said)) as master:
            assert master.ask(1, READ) == VALUES
        told = program.end(signal.SIGINT)
    assert said.startswith(f"{capture}: 1 different requests to unit 1 on tcp:127.0.0.1:")
    assert (told.code, told.out, told.err) == (exit_codes.INTERRUPTED, "", "")


def test_a_replay_of_a_cut_capture_says_so_and_plays_what_comes_before(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcap"
    path.write_bytes(pcap(captured(1))[:-1])
    with Program("replay", path, "--as-slave", "--on", "tcp:127.0.0.1:0") as program:
        assert "playing what comes before" in program.await_said("cut.pcap")
        with TcpMaster(endpoint_in(program.await_said("Ctrl-C ends"))) as master:
            assert master.ask(1, READ) == VALUES
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED


def test_the_choices_for_a_miss_are_the_players() -> None:
    assert [one.value for one in MissChoice] == [one.value for one in OnMiss]
