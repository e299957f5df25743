"""A connection that was read elsewhere does what one does that was followed to its end."""

from __future__ import annotations

from itertools import product

import pytest

from mbtool.core import Connection, Endpoint
from mbtool.packets.connection import TcpConnection
from mbtool.packets.ended_connection import EndedConnection
from mbtool.packets.segment import ACK, FIN, RST, SYN, TcpSegment
from mbtool.packets.stream_events import CloseReason, StreamItem

_IDENTITY = Connection(Endpoint("10.0.0.1", 49152), Endpoint("10.0.0.2", 502), 7)
_ASKED, _TOLD = b"ask", b"tell!"
_BEGINS = (1001, 2**32 - 2)
"""The sequence numbers of the first bytes; those of the responses wrap inside of them."""
_MEBIBYTE = 1024 * 1024


def _segment(
    sequence: int, flags: int, payload: bytes = b"", missing: int = 0, acknowledgement: int = 0
) -> TcpSegment:
    return TcpSegment(
        b"\x0a\0\0\1", 1, b"\x0a\0\0\2", 2, sequence % 2**32, acknowledgement % 2**32, flags,
        payload, missing,
    )  # fmt: skip


def _followed(*, master_is_lower: bool) -> TcpConnection:
    """A connection that was followed from its SYN to both FINs."""
    out: list[StreamItem] = []
    one = TcpConnection(_IDENTITY, 0, out, joined=False, master_is_lower=master_is_lower)
    asked, told = _BEGINS
    ends = asked + len(_ASKED), told + len(_TOLD)
    for ts_ns, (by_master, segment) in enumerate((
        (True, _segment(asked - 1, SYN)),
        (False, _segment(told - 1, SYN | ACK, acknowledgement=asked)),
        (True, _segment(asked, ACK, _ASKED, acknowledgement=told)),
        (False, _segment(told, ACK, _TOLD, acknowledgement=ends[0])),
        (True, _segment(ends[0], FIN | ACK, acknowledgement=ends[1])),
        (False, _segment(ends[1], FIN | ACK, acknowledgement=ends[0] + 1)),
    )):  # fmt: skip
        one.feed(segment, ts_ns, from_lower=by_master == master_is_lower)
    assert one.closed
    return one


def _passed(*, master_is_lower: bool) -> EndedConnection:
    sizes = len(_ASKED), len(_TOLD)
    return EndedConnection(_IDENTITY, 5, _BEGINS, sizes, master_is_lower)


@pytest.mark.parametrize("master_is_lower", [False, True])
def test_the_same_segments_begin_another_connection(master_is_lower: bool) -> None:
    followed = _followed(master_is_lower=master_is_lower)
    passed = _passed(master_is_lower=master_is_lower)
    answers = set()
    distances = [
        *range(-8, 12), *(sign * _MEBIBYTE + by for sign in (-1, 1) for by in range(-8, 12)),
    ]  # fmt: skip
    for begin, distance, flags, (payload, missing), from_lower in product(
        _BEGINS, distances, (SYN, SYN | ACK, ACK, FIN | ACK, RST, RST | ACK),
        ((b"", 0), (b"x", 0), (b"abc", 0), (b"", 3), (b"abc", 4)), (False, True),
    ):  # fmt: skip
        segment = _segment(begin + distance, flags, payload, missing)
        is_another = passed.is_replaced_by(segment, from_lower=from_lower)
        assert is_another == followed.is_replaced_by(segment, from_lower=from_lower), segment
        answers.add(is_another)
    assert answers == {False, True}


@pytest.mark.parametrize(
    ("distance", "size", "is_another"),
    [
        (0, 3, False),  # The last bytes again.
        (0, 4, True),  # One more.
        (2, 1, False),
        (3, 1, True),
        (3 - _MEBIBYTE, 1, False),
        (2 - _MEBIBYTE, 1, True),
    ],
)
def test_bytes_behind_the_end_or_far_away_belong_to_another_connection(
    distance: int, size: int, is_another: bool
) -> None:
    one = _passed(master_is_lower=False)
    for flags in (ACK, FIN | ACK):
        for payload, missing in ((b"x" * size, 0), (b"", size), (b"x", size - 1)):
            segment = _segment(_BEGINS[0] + distance, flags, payload, missing)
            assert one.is_replaced_by(segment, from_lower=False) == is_another
    reset = _segment(_BEGINS[0] + distance, RST, b"x" * size)
    assert not one.is_replaced_by(reset, from_lower=False)


def test_a_syn_opens_another_connection_unless_it_answers_or_is_a_copy() -> None:
    one = _passed(master_is_lower=False)
    begin = _BEGINS[0] - 1
    said = {
        (distance, flags): one.is_replaced_by(_segment(begin + distance, flags), from_lower=False)
        for distance in (-1, 0, 1)
        for flags in (SYN, SYN | ACK)
    }
    assert said == {
        (-1, SYN): True, (-1, SYN | ACK): True,
        (0, SYN): True, (0, SYN | ACK): False,
        (1, SYN): True, (1, SYN | ACK): True,
    }  # fmt: skip


def test_it_takes_no_segment_and_remembers_when_the_last_came() -> None:
    one = _passed(master_is_lower=False)
    assert (one.identity, one.last_ns, one.closed) == (_IDENTITY, 5, True)
    assert one.feed(_segment(_BEGINS[0], ACK, b"new"), 9, from_lower=False) is False
    one.close(10, CloseReason.IDLE)
    assert one.last_ns == 9
