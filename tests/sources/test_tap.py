"""The tap, on loopback connections."""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import threading
from contextlib import ExitStack, closing, suppress
from typing import TYPE_CHECKING

import pytest

from mbtool.core import (
    Chunk,
    Direction,
    Endpoint,
    EventKind,
    LinkError,
    Quiet,
    Stamp,
    TapLink,
    UsageError,
    WireEvent,
)
from mbtool.packets import CloseReason, StreamClosed, StreamOpened
from mbtool.ports.clock import now_ns
from mbtool.ports.tcp_listener import AllowedPeers, ConnectionLimits
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.tap import TapSource, _unreachable_reason
from tests.sources.live_helpers import PATIENCE_S, drain, start_program, take_until
from tests.sources.tap_bench import ANY_PORT, Bench

if TYPE_CHECKING:
    from collections.abc import Iterator

REQUEST = bytes.fromhex(
    "0001"          # transaction id
    "0000"          # protocol id
    "0006"          # length
    "11"            # unit id
    "03 006b 0003"  # read holding registers, address 107, quantity 3
)  # fmt: skip


@pytest.fixture
def bench() -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(stack)


def read_to_end(connection: socket.socket) -> bytes:
    data = b""
    while piece := connection.recv(2**16):
        data += piece
    return data


def call_and_read(connection: socket.socket, endpoint: Endpoint) -> None:
    """Either may report a reset that follows the acceptance at once."""
    connection.connect((endpoint.host, endpoint.port))
    connection.recv(100)


def reset(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def closing_of(bench: Bench) -> StreamClosed:
    last = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))[-1]
    assert isinstance(last, StreamClosed)
    return last


def test_records_both_directions_in_order_with_their_connection(bench: Bench) -> None:
    tap = bench.tap()
    master = bench.call(tap)
    slave = bench.accept()
    before_ns = now_ns()
    master.sendall(REQUEST)
    assert slave.recv(100) == REQUEST
    slave.sendall(b"answer")
    assert master.recv(100) == b"answer"
    after_ns = now_ns()
    master.close()
    slave.close()
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))
    opened, request, answer, closed = (item for item in items if not isinstance(item, Quiet))
    assert isinstance(opened, StreamOpened)
    assert not opened.joined
    assert opened.connection.slave == bench.target
    assert opened.connection.number == 1
    assert isinstance(request, Chunk)
    assert isinstance(answer, Chunk)
    assert (request.data, request.direction) == (REQUEST, Direction.REQUEST)
    assert (answer.data, answer.direction) == (b"answer", Direction.RESPONSE)
    for chunk in (request, answer):
        assert chunk.connection == opened.connection
        assert chunk.link == tap.link == opened.connection.link
        assert chunk.stamp is Stamp.AT_ONCE
    assert before_ns <= request.ts_ns <= answer.ts_ns <= after_ns
    assert isinstance(closed, StreamClosed)
    assert closed.reason is CloseReason.FINISHED


def test_a_half_close_is_passed_on_and_the_other_direction_goes_on(bench: Bench) -> None:
    tap = bench.tap()
    master = bench.call(tap)
    slave = bench.accept()
    master.sendall(REQUEST)
    master.shutdown(socket.SHUT_WR)
    assert read_to_end(slave) == REQUEST
    slave.sendall(b"answer after the end")
    slave.close()
    assert read_to_end(master) == b"answer after the end"
    assert closing_of(bench).reason is CloseReason.FINISHED


def test_the_slave_may_close_first(bench: Bench) -> None:
    tap = bench.tap()
    master = bench.call(tap)
    slave = bench.accept()
    slave.sendall(b"bye")
    slave.close()
    assert read_to_end(master) == b"bye"
    master.close()
    assert closing_of(bench).reason is CloseReason.FINISHED


def test_megabytes_pass_unchanged_both_ways_at_once(bench: Bench) -> None:
    upward, downward = os.urandom(3 * 2**20), os.urandom(3 * 2**20)
    tap = bench.tap()
    master = bench.call(tap)
    slave = bench.accept()
    heard: dict[str, bytes] = {}

    def talk(connection: socket.socket, data: bytes) -> None:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)

    def listen(connection: socket.socket, name: str) -> None:
        heard[name] = read_to_end(connection)

    threads = [
        threading.Thread(target=talk, args=(master, upward)),
        threading.Thread(target=talk, args=(slave, downward)),
        threading.Thread(target=listen, args=(master, "master")),
        threading.Thread(target=listen, args=(slave, "slave")),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert heard == {"master": downward, "slave": upward}
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))
    chunks = [item for item in items if isinstance(item, Chunk)]
    for direction, data in ((Direction.REQUEST, upward), (Direction.RESPONSE, downward)):
        assert b"".join(chunk.data for chunk in chunks if chunk.direction is direction) == data


def test_a_side_that_does_not_read_stops_the_other(bench: Bench) -> None:
    tap = bench.tap()
    master = bench.call(tap)
    slave = bench.accept()
    master.settimeout(0.5)
    sent = 0
    with suppress(TimeoutError):
        while sent < 2**28:
            sent += master.send(bytes(2**16))
    assert sent < 2**28
    # The slave then reads, and all of it comes.
    master.settimeout(PATIENCE_S)
    master.shutdown(socket.SHUT_WR)
    assert len(read_to_end(slave)) == sent


def test_a_reset_is_passed_on_as_a_reset(bench: Bench) -> None:
    tap = bench.tap()
    master = bench.call(tap)
    slave = bench.accept()
    master.sendall(REQUEST)
    assert slave.recv(100) == REQUEST
    reset(master)
    with pytest.raises(ConnectionResetError):
        slave.recv(100)
    assert closing_of(bench).reason is CloseReason.RESET


_TALKER = """
import socket, sys
with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as tap:
    while True:
        tap.sendall(bytes(range(256)) * 16)
"""


def recorded(bench: Bench, direction: Direction) -> bytes:
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))
    chunks = (item for item in items if isinstance(item, Chunk))
    return b"".join(chunk.data for chunk in chunks if chunk.direction is direction)


def test_a_master_that_is_killed_loses_no_recorded_byte(bench: Bench) -> None:
    tap = bench.tap()
    with start_program(_TALKER, str(tap.endpoint.port)) as master:
        slave = bench.accept()
        heard = slave.recv(2**16)
        master.kill()
        heard += read_to_end(slave)  # Of a killed process the kernel says the end, as of any.
        slave.close()
    assert recorded(bench, Direction.REQUEST) == heard


def test_a_slave_that_is_killed_loses_no_recorded_byte(bench: Bench) -> None:
    tap = bench.tap()
    master = bench.call(tap)
    slave = bench.accept()
    slave.sendall(b"last words")
    assert master.recv(100) == b"last words"
    master.sendall(REQUEST)
    reset(slave)  # With a request that it had not read, a killed process resets.
    with pytest.raises(ConnectionResetError):
        master.recv(100)
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))
    said = {one.direction: one.data for one in items if isinstance(one, Chunk)}
    assert said == {Direction.RESPONSE: b"last words", Direction.REQUEST: REQUEST}
    assert isinstance(items[-1], StreamClosed)
    assert items[-1].reason is CloseReason.RESET


def test_two_connections_are_kept_apart(bench: Bench) -> None:
    tap = bench.tap()
    masters, slaves = [], []
    for _ in range(2):
        masters.append(bench.call(tap))
        slaves.append(bench.accept())
    masters[0].sendall(b"first")
    masters[1].sendall(b"second")
    assert slaves[0].recv(100) == b"first"
    assert slaves[1].recv(100) == b"second"
    items = take_until(bench.inbox, lambda item: isinstance(item, Chunk))
    items += take_until(bench.inbox, lambda item: isinstance(item, Chunk))
    numbers = {
        item.data: item.connection.number
        for item in items
        if isinstance(item, Chunk) and item.connection is not None
    }
    assert numbers == {b"first": 1, b"second": 2}


def test_a_target_that_refuses_is_an_event_and_resets_the_master(bench: Bench) -> None:
    with closing(socket.socket()) as silent:
        silent.bind(("127.0.0.1", 0))  # Bound and not listening: the port is taken, and refuses.
        target = Endpoint(*silent.getsockname())
        inbox = Inbox()
        with TapSource(TapLink(ANY_PORT, target), inbox) as tap, closing(socket.socket()) as master:
            master.settimeout(PATIENCE_S)
            master.bind(("127.0.0.1", 0))
            source = Endpoint(*master.getsockname())
            with pytest.raises(ConnectionResetError):
                call_and_read(master, tap.endpoint)
            event = take_until(inbox, lambda item: isinstance(item, WireEvent))[-1]
    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.REFUSED
    assert (event.link, event.source, event.destination) == (tap.link, str(source), str(target))
    assert event.message == f"{target} cannot be reached: Connection refused"
    assert not any(isinstance(item, StreamOpened | StreamClosed) for item in drain(inbox))


@pytest.mark.parametrize("host", ["nosuch.invalid", "no..host", "x" * 70])
def test_a_target_that_no_name_leads_to_is_an_event(host: str) -> None:
    inbox = Inbox()
    with TapSource(TapLink(ANY_PORT, Endpoint(host, 502)), inbox) as tap:
        with closing(socket.socket()) as master:
            master.settimeout(PATIENCE_S)
            with pytest.raises(ConnectionResetError):
                call_and_read(master, tap.endpoint)
        event = take_until(inbox, lambda item: isinstance(item, WireEvent))[-1]
    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.REFUSED
    assert event.message.startswith(f"{host}:502 cannot be reached: ")
    assert "Errno" not in event.message


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (ConnectionRefusedError(errno.ECONNREFUSED, "Connect call failed"), "Connection refused"),
        (
            OSError(f"Multiple exceptions: [Errno {errno.ECONNREFUSED}] Connect call failed, ..."),
            "Connection refused",
        ),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "no such host"),
        (socket.gaierror(socket.EAI_AGAIN, "Temporary failure"), "Temporary failure"),
        (TimeoutError(), "no answer in 10 s"),
        (OSError("something else"), "something else"),
    ],
)
def test_why_a_target_cannot_be_reached_is_said_in_words(error: Exception, why: str) -> None:
    assert _unreachable_reason(error) == why


def test_a_listening_address_that_no_host_can_have_is_one_line(bench: Bench) -> None:
    link = TapLink(Endpoint("no..host", 0), bench.target)
    with pytest.raises(LinkError, match="no such host"), TapSource(link, bench.inbox):
        pass


def test_a_connection_over_the_bound_is_turned_away_with_an_event(bench: Bench) -> None:
    tap = bench.tap(max_connections=1)
    first = bench.call(tap)
    slave = bench.accept()
    with pytest.raises(ConnectionResetError):
        bench.call(tap).recv(100)
    event = take_until(bench.inbox, lambda item: isinstance(item, WireEvent))[-1]
    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.DISCARDED
    assert event.message == "connection turned away: 1 are open already"
    first.sendall(b"still here")
    assert slave.recv(100) == b"still here"
    first.close()
    slave.close()
    closing_of(bench)
    third = bench.call(tap)
    third.sendall(b"room again")
    assert bench.accept().recv(100) == b"room again"


def test_a_tap_that_waits_lets_nobody_in_before_it_is_told_to(bench: Bench) -> None:
    link = TapLink(ANY_PORT, bench.target)
    with TapSource(link, bench.inbox, waits=True) as tap:
        master = bench.call(tap)
        master.sendall(REQUEST)
        for _ in range(3):  # Three looks at the clock.
            assert isinstance(bench.inbox.get(PATIENCE_S), Quiet)
        tap.accept()
        assert bench.accept().recv(100) == REQUEST
    with TapSource(link, bench.inbox, waits=True) as tap:
        master = bench.call(tap)
    with suppress(ConnectionError):
        assert master.recv(100) == b""


def test_that_no_more_files_can_be_opened_is_told_once(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    tap = bench.tap()
    context = {
        "message": "socket.accept() out of system resource",
        "exception": OSError(errno.EMFILE, os.strerror(errno.EMFILE)),
    }
    loop = tap._loop
    for _ in range(100):
        loop.call_soon_threadsafe(loop.call_exception_handler, context)
    other = {"message": "something else", "exception": ValueError("of another kind")}
    loop.call_soon_threadsafe(loop.call_exception_handler, other)
    bench.call(tap)
    bench.accept()
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamOpened))
    (event,) = [item for item in items if isinstance(item, WireEvent)]
    assert event.kind is EventKind.REFUSED
    assert event.message == (
        "no more connections for now: Too many open files; ulimit -n allows more"
    )
    assert [record.message for record in caplog.records] == ["something else"]


def test_an_idle_connection_is_closed(bench: Bench) -> None:
    tap = bench.tap(idle_s=0.0)
    master = bench.call(tap)
    bench.accept()
    assert closing_of(bench).reason is CloseReason.IDLE
    assert master.recv(100) == b""


def test_the_end_closes_the_connections_and_comes_last(bench: Bench) -> None:
    link = TapLink(ANY_PORT, bench.target)
    with TapSource(link, bench.inbox) as tap:
        master = bench.call(tap)
        slave = bench.accept()
        master.sendall(REQUEST)
        assert slave.recv(100) == REQUEST
    items = [item for item in drain(bench.inbox) if not isinstance(item, Quiet)]
    assert isinstance(items[-2], StreamClosed)
    assert items[-2].reason is CloseReason.CAPTURE_END
    assert items[-1] == Ended(tap.link)
    assert slave.recv(100) == b""
    tap.close()  # A second time does nothing.
    assert drain(bench.inbox) == []


def test_the_consumer_is_told_that_time_passes(bench: Bench) -> None:
    bench.tap()
    first, second = bench.inbox.get(PATIENCE_S), bench.inbox.get(PATIENCE_S)
    assert isinstance(first, Quiet)
    assert isinstance(second, Quiet)
    assert first.ts_ns < second.ts_ns


def test_an_address_in_use_says_what_would_be_right(bench: Bench) -> None:
    link = TapLink(bench.target, Endpoint("127.0.0.1", 502))
    with (
        pytest.raises(LinkError, match=rf"cannot listen at {bench.target}: the port is in use"),
        TapSource(link, bench.inbox),
    ):
        pass


class _Nobody(AllowedPeers):
    """No machine at all, so that a connection from this one is refused."""

    def __contains__(self, host: object) -> bool:
        return False


def test_a_master_that_is_not_allowed_is_reset_with_an_event_and_reaches_no_target(
    bench: Bench,
) -> None:
    link = TapLink(ANY_PORT, bench.target)
    with TapSource(link, bench.inbox, allowed=_Nobody()) as tap, socket.socket() as master:
        with pytest.raises(ConnectionResetError):
            call_and_read(master, tap.endpoint)
        event = take_until(bench.inbox, lambda item: isinstance(item, WireEvent))[-1]
    assert isinstance(event, WireEvent)
    assert event.kind is EventKind.REFUSED
    assert event.message == "127.0.0.1 is in no network of --allow"
    assert event.source.startswith("127.0.0.1:")
    assert event.destination == str(bench.target)
    bench.server.settimeout(0)
    with pytest.raises(BlockingIOError):
        bench.accept()


def test_a_tap_that_other_machines_can_reach_wants_to_know_which(bench: Bench) -> None:
    link = TapLink(Endpoint("0.0.0.0", 0), bench.target)
    with (
        pytest.raises(UsageError, match=r"other machines can reach 0\.0\.0\.0; .*--allow"),
        TapSource(link, bench.inbox),
    ):
        pass
    allowed = AllowedPeers.parse(["10.0.0.0/8"])
    with (
        TapSource(link, bench.inbox, allowed=allowed) as tap,
        socket.create_connection(("127.0.0.1", tap.endpoint.port), PATIENCE_S) as master,
    ):
        master.sendall(REQUEST)
        assert bench.accept().recv(100) == REQUEST


WRITE = bytes.fromhex(
    "0002"          # transaction id
    "0000"          # protocol id
    "0006"          # length
    "11"            # unit id
    "06 0001 1234"  # write single register, address 1
)  # fmt: skip
REFUSAL = bytes.fromhex("0002 0000 0003 11 86 01")


def test_a_read_only_tap_answers_a_write_itself_and_passes_reads_on(bench: Bench) -> None:
    tap = bench.tap(read_only=True)
    master = bench.call(tap)
    slave = bench.accept()
    master.sendall(WRITE)
    assert master.recv(100) == REFUSAL
    master.sendall(REQUEST)
    assert slave.recv(100) == REQUEST
    slave.sendall(b"\x00\x01\x00\x00\x00\x03\x11\x83\x02")
    assert master.recv(100).endswith(b"\x83\x02")
    master.close()
    slave.close()
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))
    said = [one for one in items if isinstance(one, WireEvent)]
    assert [one.kind for one in said] == [EventKind.BLOCKED]
    assert "unit 17: write single register not passed on" in said[0].message
    chunks = [(one.direction, one.data) for one in items if isinstance(one, Chunk)]
    assert chunks[:3] == [
        (Direction.REQUEST, WRITE),
        (Direction.RESPONSE, REFUSAL),
        (Direction.REQUEST, REQUEST),
    ]


def test_a_read_only_tap_ends_a_connection_of_bytes_that_are_no_requests(bench: Bench) -> None:
    tap = bench.tap(read_only=True)
    master = bench.call(tap)
    slave = bench.accept()
    master.sendall(b"\xff" * 2000)
    with suppress(ConnectionResetError):
        assert master.recv(100) == b""
    with suppress(ConnectionResetError):
        assert slave.recv(100) == b""


def test_a_flood_of_silent_connections_makes_room_for_a_master(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.sources.tap.SPARE_S", 0.0)
    tap = bench.tap(max_connections=3)
    silent = [bench.call(tap) for _ in range(3)]
    slaves = [bench.accept() for _ in silent]
    master = bench.call(tap)
    slave = bench.accept()
    master.sendall(REQUEST)
    assert slave.recv(100) == REQUEST
    (closed, *_), _, _ = select.select([*silent, *slaves], [], [], PATIENCE_S)
    with suppress(ConnectionResetError):
        assert closed.recv(100) == b""
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))
    assert isinstance(items[-1], StreamClosed)
    assert items[-1].reason is CloseReason.CROWDED_OUT


def test_a_connection_that_was_answered_keeps_its_place(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbtool.sources.tap.SPARE_S", 0.0)
    tap = bench.tap(max_connections=1)
    master = bench.call(tap)
    slave = bench.accept()
    slave.sendall(b"answer")
    assert master.recv(100) == b"answer"
    with suppress(ConnectionResetError):
        assert bench.call(tap).recv(100) == b""
    slave.sendall(b"again")
    assert master.recv(100) == b"again"


def test_connections_beyond_the_rate_are_reset_with_an_event(bench: Bench) -> None:
    tap = bench.tap(limits=ConnectionLimits(per_second=0.01))
    bench.call(tap)
    with suppress(ConnectionResetError):
        assert bench.call(tap).recv(100) == b""
    last = take_until(bench.inbox, lambda item: isinstance(item, WireEvent))[-1]
    assert isinstance(last, WireEvent)
    assert last.kind is EventKind.REFUSED
    assert last.message == "more than 0.01 connections a second; see --max-rate"
