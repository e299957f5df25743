from __future__ import annotations

import shutil
from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat
from tests.benchmarks.adapters import Column, Damage, Wire, damaged, delivered
from tests.benchmarks.bus_traffic import bus_traffic
from tests.benchmarks.figures import Figures, figures
from tests.benchmarks.line_peers import bursts, pymodbus, pymodbus_searched, tshark

if TYPE_CHECKING:
    from tests.benchmarks.line_peers import Peer

MS = 1_000_000


def test_reads_are_joined_until_a_silence() -> None:
    wire = Wire(SerialFormat())
    reads = [(b"a", 1 * MS), (b"b", 2 * MS), (b"c", 9 * MS), (b"d", 10 * MS)]
    assert bursts(wire, reads, Column.POLLED) == [(b"ab", 2 * MS), (b"cd", 10 * MS)]
    assert bursts(wire, reads, Column.NO_TIMES) == reads
    assert bursts(wire, [], Column.POLLED) == []


def test_pymodbus_finds_frames_and_loses_what_is_behind_them() -> None:
    one = heard_by(pymodbus, Column.FTDI)
    assert 0 < one.found < one.frames
    assert one.transactions is None


@pytest.mark.parametrize("column", [Column.BYTES, Column.NO_TIMES])
def test_pymodbus_searched_finds_nearly_every_frame_but_not_user_defined_functions(
    column: Column,
) -> None:
    one = heard_by(pymodbus_searched, column)
    assert 0.9 * one.frames < one.found < one.frames
    assert one.transactions is None


@pytest.mark.peers
@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_tshark_finds_the_frames_of_a_clean_capture_but_not_their_directions() -> None:
    one = heard_by(tshark, Column.BYTES)
    assert 0.9 * one.frames < one.found < one.frames
    assert one.ambiguous > 0
    assert one.wrong > 0
    assert 0 < one.transactions_right < (one.transactions or 0)


def heard_by(peer: Peer, column: Column) -> Figures:
    traffic = bus_traffic(4, 300)
    wire = damaged(traffic, Damage.NONE, Random(1))
    return figures(traffic, wire, peer(wire, delivered(wire, column), column))
