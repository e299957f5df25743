"""Judges what a board (the figures of live views) shows, by the rules of `stats` and `report`."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from mbtool.troubles.failure_limits import is_grave
from mbtool.troubles.odd_polling import Oddity, late_units, pauses, short_connections
from mbtool.troubles.refusals import JointRefusals, joint_refusals
from mbtool.watching.board_rows import WatchedSlaveRow, polls_of_slaves, slave_rows

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.watching.board import Board

Unit = tuple[str, int]
"""Link and unit."""


class BoardJudgement(NamedTuple):
    """The slaves that fail or are slow, damaged frames of no known slave, and odd polling."""

    slaves: Sequence[WatchedSlaveRow]
    """All slaves, in trouble or not."""
    refusing: JointRefusals | None
    """The slaves that refuse requests, if they are many."""
    stray_frames: Mapping[str, int]
    """By link, the number of frames with a wrong CRC or LRC that answer no request that is known,
    if they are more than a small thing."""
    odd: Sequence[Sequence[Oddity[Unit]]]
    """Pauses, TCP connections for single polls, and late answers, a list for each kind; empty if a
    slave fails, as that is worse."""


def judge(board: Board) -> BoardJudgement:
    """Judge all records of a board."""
    slaves = slave_rows(board)
    failing = [row for row in slaves if row.is_failing]
    refusing = None
    if failing:
        tallies = {
            key: slave.tally
            for key, slave in board.slaves.items()
            if not slave.tally.is_of_broadcasts
        }
        units = [
            (row.link, row.unit)
            for row in failing
            if row.refused_share is not None and row.refused_share.is_grave
        ]
        refusing = joint_refusals(units, tallies, polls_of_slaves(board))
    return BoardJudgement(slaves, refusing, _stray_frames(board), () if failing else _odd(board))


def _stray_frames(board: Board) -> dict[str, int]:
    bad_checks = board.statistics.bad_checks
    if not bad_checks:
        return {}
    damaged, asked = Counter[str](), Counter[str]()
    for one in board.slaves.values():
        damaged[one.link] += one.tally.damaged
        asked[one.link] += one.tally.transactions
    stray = {link: number - damaged[link] for link, number in bad_checks.items()}
    return {link: number for link, number in stray.items() if is_grave(number, asked[link])}


def _odd(board: Board) -> Sequence[Sequence[Oddity[Unit]]]:
    polls = [poll.statistics for poll in board.polls.values()]

    requests = Counter[str]()
    for one in board.slaves.values():
        requests[one.link] += one.tally.requests
    return (
        pauses(polls),
        short_connections(board.statistics.connections, polls, lambda link: requests[link]),
        late_units({key: slave.tally.latency for key, slave in board.slaves.items()}),
    )
