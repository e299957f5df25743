"""Connections as a part of a session: played as the slave and the master, and compared."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from mbtool.core import TcpLink, parse_link
from mbtool.devices import Assignments, Difference, DifferenceKind, parse_assignment
from mbtool.master.links import open_master
from mbtool.slave.shells import TcpSlave
from mbtool.workflows.diff import DiffOptions, compare
from mbtool.workflows.replay_master import MasterOptions, MasterRun, Report
from mbtool.workflows.replay_slave import SlaveOptions, SlaveRun
from mbtool.workflows.shared.reading import ReadingOptions
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.fa3_session import MODEL, READ_X9, session

if TYPE_CHECKING:
    from pathlib import Path

ANYWHERE = parse_link("tcp:127.0.0.1:0")
FA3 = ReadingOptions(assignments=Assignments([parse_assignment("all=fa3-at1m8x")]))


def _file(path: Path, capture: bytes) -> Path:
    path.write_bytes(capture)
    return path


def _loop(path: Path, *, answers_only: bool = False, rate: Fraction | None = Fraction(1)) -> Report:
    """Play a session as the slave and as the master, the two against each other."""
    slave = SlaveRun(str(path), SlaveOptions(answers_only=answers_only, rate=rate))
    master = MasterRun(str(path), MasterOptions(rate=rate))
    with slave.create_slave(ANYWHERE).shell as shell:
        assert isinstance(shell, TcpSlave)
        return master.play(TcpLink(shell.endpoint))


def _connections(differences: list[Difference]) -> list[tuple[str, str, str]]:
    return [
        (one.what, one.a.text, one.b.text)
        for one in differences
        if one.kind is DifferenceKind.CONNECTION
    ]


@pytest.mark.parametrize("rate", [Fraction(1), None])
def test_a_session_is_played_with_its_connections(tmp_path: Path, rate: Fraction | None) -> None:
    report = _loop(_file(tmp_path / "a.pcap", session()), rate=rate)
    assert report.differences == []
    assert (report.requests, report.different, report.connections) == (7, 0, 7)


def test_a_slave_that_plays_answers_only_is_told_apart(tmp_path: Path) -> None:
    report = _loop(_file(tmp_path / "a.pcap", session()), answers_only=True)
    left_open = "opened, left open"
    assert _connections(report.differences) == [
        ("connection 1", "opened, reset by the slave", left_open),
        ("connection 2", "refused", "opened"),
        ("connection 3", "refused", "opened"),
        ("connection 4", "refused", "opened"),
        ("connection 5", "opened, reset by the slave", left_open),
        ("connection 6", "opened, reset by the slave", left_open),
    ]
    assert report.different == 0


def test_a_master_may_play_requests_only(tmp_path: Path) -> None:
    path = _file(tmp_path / "a.pcap", session())
    slave = SlaveRun(str(path), SlaveOptions(answers_only=True, rate=None))
    run = MasterRun(str(path), MasterOptions(answers_only=True, rate=None))
    with slave.create_slave(ANYWHERE).shell as shell:
        assert isinstance(shell, TcpSlave)
        report = run.play(TcpLink(shell.endpoint))
    assert (report.differences, report.connections, report.requests) == ([], 0, 7)


@pytest.mark.parametrize(("unit", "answer"), [(0, MODEL[1]), (77, MODEL[1])])
def test_a_module_that_answers_any_unit_does_so_when_it_is_played(
    tmp_path: Path, unit: int, answer: bytes
) -> None:
    path = _file(tmp_path / "a.pcap", session())
    run = SlaveRun(str(path), SlaveOptions(reading=FA3, rate=None))
    with run.create_slave(ANYWHERE).shell as shell:
        assert isinstance(shell, TcpSlave)
        with open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
            assert master.ask(unit, MODEL[0]) == answer
            assert master.ask(unit, READ_X9[0]) == READ_X9[1]


@pytest.mark.parametrize(
    ("left_out", "expected"),
    [
        ("resets", [
            ("connection 1", "opened, reset by the slave", "opened, not ended by the slave"),
            ("connection 5", "opened, reset by the slave", "opened, not ended by the slave"),
        ]),
        ("checks", [
            ("connection 6", "opened, reset by the slave", "opened, not ended by the slave"),
        ]),
        ("refuses", [
            ("connection 2", "refused: 3 of 7 connections", "refused: 0 of 4 connections"),
        ]),
    ],
)  # fmt: skip
def test_diff_tells_which_connection_differs_and_how(
    tmp_path: Path, left_out: str, expected: list[tuple[str, str, str]]
) -> None:
    whole = _file(tmp_path / "a.pcap", session())
    other = _file(tmp_path / "b.pcap", session(**{left_out: False}))
    options = DiffOptions(reading=ReadingOptions())
    assert compare(str(whole), str(whole), options).differences == []
    assert _connections(compare(str(whole), str(other), options).differences) == expected
    less = DiffOptions(reading=ReadingOptions(), connections=False)
    assert compare(str(whole), str(other), less).differences == []
