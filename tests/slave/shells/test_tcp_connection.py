"""One connection: what it reads in place, what in pieces, and its timers, on loopback sockets."""

from __future__ import annotations

import asyncio
import errno
import socket
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Endpoint, TcpLink
from mbtool.modbus import Response, mbap_adu, rtu_adu
from mbtool.modbus.response import ConnectionEnding, Distortion
from mbtool.slave.device.connection_policy import ConnectionPolicy, KeepAlive, Loss, Peer
from mbtool.slave.shells import TcpSlave
from mbtool.slave.shells.tcp_shell import MasterConnection
from tests.slave.scripted import PATIENCE_S, Scripted, echo

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.slave.shells.tcp_shell import Host

LOOPBACK = TcpLink(Endpoint("127.0.0.1", 0))
READ = bytes.fromhex("03 0000 0001")


@dataclass
class _Shell:
    """What a connection asks of its shell, without sockets."""

    answers: list[bytes] = field(default_factory=list)
    waiting: int = 16
    is_rtu: bool = False
    on_exchange: None = None
    rules: ConnectionPolicy = field(default_factory=ConnectionPolicy)

    def note_left(self, connection: MasterConnection) -> None: ...

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        self.answers.append(bytes([unit]) + pdu)
        return None


def _feed(chunks: Iterator[bytes], rules: ConnectionPolicy | None = None) -> list[bytes]:
    """The unit and PDU of each request that is found in the chunks of a stream."""
    shell = _Shell(rules=rules or ConnectionPolicy())
    connection = MasterConnection.__new__(MasterConnection)
    _prepare(connection, shell)
    for chunk in chunks:
        connection._bytes[: len(chunk)] = chunk
        connection.buffer_updated(len(chunk))
    return shell.answers


def _prepare(connection: MasterConnection, shell: _Shell) -> None:
    async def make() -> None:
        host: Host = shell  # type: ignore[assignment]
        shell.responder = shell  # type: ignore[attr-defined]
        shell.clock = lambda: 0  # type: ignore[attr-defined]
        MasterConnection.__init__(connection, host)
        connection.peer = Peer("", 0)

    asyncio.run(make())


_Pieces = st.one_of(
    st.builds(
        mbap_adu, st.integers(0, 0xFFFF), st.integers(0, 255), st.binary(min_size=1, max_size=253)
    ),
    st.binary(max_size=20),
    st.just(bytes.fromhex("0001 0001 0006 01 03 0000 0001")),  # another protocol
)


@given(st.lists(_Pieces, max_size=8), st.data())
def test_what_is_read_in_place_is_what_the_splitter_finds(
    pieces: list[bytes], data: st.DataObject
) -> None:
    stream = b"".join(pieces)
    one_by_one = _feed(bytes([byte]) for byte in stream)
    assert _feed(piece for piece in pieces if piece) == one_by_one
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    bounds = list(zip([0, *cuts], [*cuts, len(stream)], strict=True))
    assert _feed(stream[a:b] for a, b in bounds if b > a) == one_by_one


def test_the_longest_and_the_shortest_request_are_read_and_no_longer_one() -> None:
    for size in (1, 253):
        assert _feed(iter([mbap_adu(1, 2, bytes(size))])) == [bytes([2]) + bytes(size)]
    assert _feed(iter([mbap_adu(1, 2, bytes(254))])) == []


def test_what_an_earlier_read_left_in_the_buffer_does_not_count() -> None:
    short = mbap_adu(1, 2, READ)[:6]
    assert _feed(iter([mbap_adu(1, 2, READ), short])) == [bytes([2]) + READ]


class _Resetting(ConnectionPolicy):
    """Wants no connections from the first request on."""

    closed_until_ns = 1


def test_what_stands_behind_a_remote_reset_is_lost() -> None:
    several = mbap_adu(1, 2, READ) * 3
    assert _feed(iter([several]), _Resetting()) == [bytes([2]) + READ]
    assert _feed(iter([several])) == [bytes([2]) + READ] * 3


class _Watched(ConnectionPolicy):
    """Rules whose timers a test sets, and who says what was lost."""

    def __init__(self, split_s: float = float("inf"), keep_alive: KeepAlive | None = None) -> None:
        super().__init__()
        self._split_s, self._keep_alive = split_s, keep_alive
        self.losses: list[Loss] = []

    @property
    def split_s(self) -> float:
        return self._split_s

    @property
    def keep_alive(self) -> KeepAlive | None:
        return self._keep_alive

    def lost(self, peer: Peer, loss: Loss, now_ns: int) -> None:
        super().lost(peer, loss, now_ns)
        self.losses.append(loss)


def _connect(slave: TcpSlave) -> socket.socket:
    connection = socket.create_connection((slave.endpoint.host, slave.endpoint.port), PATIENCE_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _ask(connection: socket.socket, cut: int | None = None) -> None:
    adu = mbap_adu(1, 1, READ)
    for part in (adu[:cut], adu[cut:]) if cut else (adu,):
        connection.sendall(part)
    data = b""
    while len(data) < len(adu):
        part = connection.recv(len(adu))
        assert part, "closed"
        data += part
    assert data == adu


def _until(done: Callable[[], bool], connection: socket.socket) -> None:
    """Ask until something is so."""
    for _ in range(100_000):
        if done():
            return
        _ask(connection)
    pytest.fail("it does not come about")


def test_a_request_whose_last_part_does_not_come_ends_its_connection_only() -> None:
    rules = _Watched(split_s=0.05)
    with (
        TcpSlave(LOOPBACK, Scripted(echo), rules=rules) as slave,
        _connect(slave) as broken,
        _connect(slave) as whole,
    ):
        broken.sendall(mbap_adu(1, 1, READ)[:-1])
        _until(lambda: bool(rules.losses), whole)
        assert rules.losses == [Loss.SPLIT]
        assert broken.recv(1) == b""
        _ask(whole)


def test_parts_that_come_in_time_are_a_request_and_the_timer_is_off_again() -> None:
    rules = _Watched(split_s=PATIENCE_S)
    with TcpSlave(LOOPBACK, Scripted(echo), rules=rules) as slave, _connect(slave) as split:
        for cut in (1, 6, 11):
            _ask(split, cut=cut)
        _ask(split)
        (mine,) = slave.connections
        assert mine._split_timer is None
        assert rules.losses == []


def _ends_after(connection: socket.socket, byte: int) -> bool:
    """Send a byte; whether the other side has closed."""
    try:
        connection.sendall(bytes([byte]))
        return connection.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionError:
        return True


def test_the_timer_of_a_request_runs_from_its_first_part_on() -> None:
    rules = _Watched(split_s=0.2)
    with TcpSlave(LOOPBACK, Scripted(echo), rules=rules) as slave, _connect(slave) as slow:
        adu = mbap_adu(1, 1, READ + bytes(200))
        slow.settimeout(0.01)
        assert any(_ends_after(slow, byte) for byte in adu[:-1])
        assert rules.losses == [Loss.SPLIT]


def test_answers_that_wait_still_reach_a_master_that_has_said_all() -> None:
    delayed = Scripted(lambda unit, pdu: Response(pdu, delay_ns=20_000_000))
    adus = mbap_adu(1, 1, READ) + mbap_adu(2, 1, READ)
    with TcpSlave(LOOPBACK, delayed) as slave, _connect(slave) as connection:
        connection.sendall(adus)
        connection.shutdown(socket.SHUT_WR)
        assert _received(connection) == adus
    with TcpSlave(LOOPBACK, Scripted(echo)) as slave, _connect(slave) as connection:
        connection.shutdown(socket.SHUT_WR)
        assert _received(connection) == b""


def test_a_master_that_leaves_is_lost_as_closed() -> None:
    rules = _Watched()
    with TcpSlave(LOOPBACK, Scripted(echo), rules=rules) as slave, _connect(slave) as other:
        with _connect(slave) as leaving:
            _ask(leaving)
        _until(lambda: rules.losses == [Loss.CLOSED], other)


@pytest.mark.parametrize(
    ("error", "loss"),
    [
        (None, Loss.CLOSED),
        (ConnectionResetError(errno.ECONNRESET, "reset"), Loss.CLOSED),
        (TimeoutError(errno.ETIMEDOUT, "timed out"), Loss.NOT_ALIVE),
        (OSError(errno.EHOSTUNREACH, "no route to host"), Loss.NOT_ALIVE),
    ],
)
def test_a_master_that_tcp_gives_up_is_lost_as_not_alive(error: OSError | None, loss: Loss) -> None:
    rules = _Watched()
    connection = MasterConnection.__new__(MasterConnection)
    _prepare(connection, _Shell(rules=rules))
    connection.connection_lost(error)
    assert rules.losses == [loss]


@pytest.mark.skipif(not hasattr(socket, "TCP_KEEPIDLE"), reason="no TCP_KEEPIDLE here")
def test_keep_alive_is_set_as_the_rules_say() -> None:
    rules = _Watched(keep_alive=KeepAlive(start_s=7, interval_s=5, count=3))
    with TcpSlave(LOOPBACK, Scripted(echo), rules=rules) as slave, _connect(slave) as connection:
        _ask(connection)
        (mine,) = slave.connections
        sock = mine._transport.get_extra_info("socket")
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        options = (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
        assert [sock.getsockopt(socket.IPPROTO_TCP, option) for option in options] == [7, 5, 3]


def _spoilt(**spoiling: Any) -> Scripted:
    """Spoils the answers to unit 9; others echo."""
    return Scripted(
        lambda unit, pdu: Response(pdu, distortion=Distortion(**spoiling) if unit == 9 else None)
    )


def _received(connection: socket.socket, size: int = 1 << 20) -> bytes:
    """So many bytes, or what comes until the other side ends."""
    data = b""
    while len(data) < size and (part := connection.recv(4096)):
        data += part
    return data


def test_a_spoilt_answer_leaves_spoilt_and_keeps_its_place() -> None:
    script = _spoilt(unit_by=1, id_by=2, cut=1, extra=b"\xee", pieces=3, gap_ns=1_000_000)
    first, then = mbap_adu(5, 9, READ), mbap_adu(6, 1, READ)
    with TcpSlave(LOOPBACK, script) as slave, _connect(slave) as connection:
        connection.sendall(first + then)
        expected = mbap_adu(7, 10, READ)[:-1] + b"\xee" + then
        assert _received(connection, len(expected)) == expected


def test_over_rtu_a_spoilt_answer_has_a_wrong_crc() -> None:
    rtu = TcpLink(LOOPBACK.endpoint, rtu=True)
    with TcpSlave(rtu, _spoilt(wrong_check=True)) as slave, _connect(slave) as connection:
        connection.sendall(rtu_adu(9, READ) + rtu_adu(1, READ))
        wrong = rtu_adu(9, READ)
        expected = wrong[:-1] + bytes([wrong[-1] ^ 0xFF]) + rtu_adu(1, READ)
        assert _received(connection, len(expected)) == expected


def test_an_answer_that_closes_is_sent_and_nothing_behind_it() -> None:
    script = _spoilt(ending=ConnectionEnding.CLOSE)
    with TcpSlave(LOOPBACK, script) as slave, _connect(slave) as connection:
        connection.sendall(mbap_adu(1, 9, READ) + mbap_adu(2, 1, READ))
        assert _received(connection) == mbap_adu(1, 9, READ)


def test_a_silent_answer_that_resets_cuts_the_connection_off() -> None:
    script = _spoilt(silent=True, ending=ConnectionEnding.RESET)
    with (
        TcpSlave(LOOPBACK, script) as slave,
        _connect(slave) as connection,
        _connect(slave) as other,
    ):
        connection.sendall(mbap_adu(1, 9, READ))
        with pytest.raises(ConnectionResetError):
            connection.recv(1)
        _ask(other)
