"""When bytes arrived, although they are read late."""

from __future__ import annotations

import socket
import struct
import sys
import time
from typing import cast

import pytest

from mbtool.ports.arrival_times import MOST_LATE_NS, SerialArrivals, note_arrivals, receive

SECOND = 1_000_000_000
STAMPS = 35


class StampedSocket:
    """A socket whose bytes arrived some time before they are read."""

    def __init__(self, late_ns: int) -> None:
        self._late_ns = late_ns

    def recvmsg(self, size: int, _: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, object]:
        stamp = struct.pack("@ll", *divmod(time.time_ns() - self._late_ns, SECOND))
        return b"read late"[:size], [(socket.SOL_SOCKET, STAMPS, stamp)], 0, None


def lateness_of(late_ns: int) -> int:
    """How long ago bytes are said to have arrived that are as late as this, in ns."""
    before_ns = time.monotonic_ns()
    data, arrived_ns = receive(cast("socket.socket", StampedSocket(late_ns)), 100)
    assert data == b"read late"
    return before_ns - arrived_ns


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells times of arrival")
def test_bytes_arrived_when_the_kernel_says() -> None:
    assert 4 * SECOND < lateness_of(5 * SECOND) <= 5 * SECOND


@pytest.mark.parametrize("late_ns", [-5 * SECOND, MOST_LATE_NS + SECOND], ids=["future", "old"])
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells times of arrival")
def test_a_time_that_a_set_clock_explains_is_not_used(late_ns: int) -> None:
    assert lateness_of(late_ns) <= 0


def test_bytes_of_a_connection_arrive_between_sending_and_reading() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
    with near, far:
        note_arrivals(near)
        far.sendall(b"abc")
        data, arrived_ns = receive(near, 100)
        assert data == b"abc"
        assert arrived_ns <= time.monotonic_ns()
        far.close()
        assert receive(near, 100)[0] == b""


def test_bytes_that_one_waited_for_came_before_the_wait_was_over() -> None:
    arrivals = SerialArrivals(character_ns=100)
    assert arrivals.arrived_ns(1, begin_ns=1000, wait_ns=500, now_ns=1200) == 1200
    assert arrivals.arrived_ns(1, begin_ns=2000, wait_ns=500, now_ns=9000) == 2500


def test_bytes_that_are_there_at_once_may_have_come_right_after_the_last_look() -> None:
    arrivals = SerialArrivals(character_ns=100)
    assert arrivals.arrived_ns(3, begin_ns=1000, wait_ns=0, now_ns=1010) == 1010
    assert arrivals.arrived_ns(0, begin_ns=1100, wait_ns=500, now_ns=1600) == 1600
    assert arrivals.arrived_ns(3, begin_ns=9000, wait_ns=0, now_ns=9010) == 1900
    assert arrivals.arrived_ns(3, begin_ns=9020, wait_ns=0, now_ns=9030) == 9030


def test_a_process_that_did_not_run_heard_silence_only_until_its_read_was_over() -> None:
    arrivals = SerialArrivals(character_ns=100)
    assert arrivals.arrived_ns(0, begin_ns=1000, wait_ns=500, now_ns=9000) == 1500
    assert arrivals.arrived_ns(3, begin_ns=9010, wait_ns=0, now_ns=9020) == 1800


def test_bytes_may_have_come_right_after_a_read_that_was_late_to_return() -> None:
    arrivals = SerialArrivals(character_ns=100)
    assert arrivals.arrived_ns(0, begin_ns=1000, wait_ns=500, now_ns=1500) == 1500
    assert arrivals.arrived_ns(1, begin_ns=1600, wait_ns=500, now_ns=1900) == 1900
    assert arrivals.arrived_ns(2, begin_ns=1910, wait_ns=0, now_ns=9000) == 2100
    assert arrivals.arrived_ns(4, begin_ns=9010, wait_ns=0, now_ns=9020) == 2500
