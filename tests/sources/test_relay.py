"""The tap's connections where a side has TLS, on loopback."""

from __future__ import annotations

import os
import select
import socket
import ssl
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from threading import Thread
from typing import TYPE_CHECKING

import pytest

from mbtool.core import (
    Chunk,
    Direction,
    Endpoint,
    EventKind,
    ListenTls,
    TapLink,
    TargetTls,
    WireEvent,
)
from mbtool.packets import CloseReason, StreamClosed, StreamOpened
from mbtool.sources.inbox import Inbox
from mbtool.sources.tap import TapSource
from tests.certificates import (
    CA,
    ELSEWHERE,
    EXPIRED,
    LATIN_1,
    MASTER,
    NO_ROLE,
    NO_SUBJECT,
    OTHER_CA,
    SLAVE,
    STRANGER,
    TLS_1_2,
    TLS_1_3,
    master_context,
    slave_context,
)
from tests.sources.live_helpers import PATIENCE_S, drain, take_until
from tests.sources.tap_bench import ANY_PORT, Bench

if TYPE_CHECKING:
    from collections.abc import Iterator

REQUEST, ANSWER = b"a request", b"and its answer"
LISTEN, LISTEN_MUTUAL = ListenTls(SLAVE), ListenTls(SLAVE, ca=CA)
TARGET, TARGET_MUTUAL = TargetTls(CA), TargetTls(CA, MASTER)

VERSIONS = pytest.mark.parametrize("version", [TLS_1_2, TLS_1_3], ids=["1.2", "1.3"])
SIDES = pytest.mark.parametrize(
    ("listen", "target"),
    [(LISTEN, None), (None, TARGET), (LISTEN_MUTUAL, TARGET_MUTUAL)],
    ids=["tls-plain", "plain-tls", "tls-tls"],
)


class SecureBench(Bench):
    """With what the ends say inside TLS, and what is recorded of that."""

    def both(
        self,
        listen: ListenTls | None,
        target: TargetTls | None,
        *,
        version: ssl.TLSVersion = TLS_1_3,
    ) -> tuple[socket.socket, socket.socket]:
        """A master and a slave with the tap between them."""
        tap = self.tap(listen, target)
        master = self.call(tap, None if listen is None else master_context(version=version))
        if target is None:
            return master, self.accept()
        ca = None if target.cert is None else CA
        return master, self.accept(slave_context(ca=ca, version=version))

    def events(self) -> list[WireEvent]:
        """What was told up to the first event, and what came right behind it."""
        items = take_until(self.inbox, lambda item: isinstance(item, WireEvent))
        return [item for item in (*items, *drain(self.inbox)) if isinstance(item, WireEvent)]

    def recorded(self) -> tuple[dict[Direction, bytes], StreamClosed]:
        """The bytes of each direction until the connection is closed."""
        items = take_until(self.inbox, lambda item: isinstance(item, StreamClosed))
        said = {Direction.REQUEST: b"", Direction.RESPONSE: b""}
        for item in items:
            if isinstance(item, Chunk):
                said[item.direction] += item.data
        closed = items[-1]
        assert isinstance(closed, StreamClosed)
        return said, closed


@pytest.fixture
def bench() -> Iterator[SecureBench]:
    with ExitStack() as stack:
        yield SecureBench(stack)


def read_to_end(connection: socket.socket) -> bytes:
    data = b""
    with suppress(ssl.SSLEOFError):  # An end without the word that TLS has for it.
        while piece := connection.recv(2**16):
            data += piece
    return data


def hang_up(connection: socket.socket) -> None:
    """The end, with the word that TLS has for it where there is TLS; its answer is not awaited."""
    if isinstance(connection, ssl.SSLSocket):
        connection.settimeout(0)
        with suppress(ssl.SSLError, OSError):
            connection.unwrap()
    connection.close()


@SIDES
@VERSIONS
def test_what_is_recorded_is_what_both_ends_say(
    bench: SecureBench, listen: ListenTls | None, target: TargetTls | None, version: ssl.TLSVersion
) -> None:
    master, slave = bench.both(listen, target, version=version)
    master.sendall(REQUEST)
    assert slave.recv(100) == REQUEST
    slave.sendall(ANSWER)
    assert master.recv(100) == ANSWER
    hang_up(master)
    assert read_to_end(slave) == b""
    slave.close()
    said, closed = bench.recorded()
    assert said == {Direction.REQUEST: REQUEST, Direction.RESPONSE: ANSWER}
    assert closed.reason is CloseReason.FINISHED


def test_the_opening_says_who_both_ends_are(bench: SecureBench) -> None:
    bench.both(LISTEN_MUTUAL, TARGET_MUTUAL)
    opened = take_until(bench.inbox, lambda item: isinstance(item, StreamOpened))[-1]
    assert isinstance(opened, StreamOpened)
    assert opened.note == (
        "master TLS 1.3, CN=master, O=Test site, role Operator; "
        "slave TLS 1.3, CN=slave, O=Test site"
    )


def test_the_opening_says_what_was_not_verified(bench: SecureBench) -> None:
    bench.both(LISTEN, TargetTls(None), version=TLS_1_2)
    opened = take_until(bench.inbox, lambda item: isinstance(item, StreamOpened))[-1]
    assert isinstance(opened, StreamOpened)
    assert opened.note == "master TLS 1.2, no certificate; slave TLS 1.2, certificate not verified"


@pytest.mark.parametrize(
    ("cert", "said"),
    [(NO_SUBJECT, "IP Address 127.0.0.1"), (LATIN_1, "certificate without a readable name")],
    ids=["no-subject", "latin-1"],
)
def test_a_verified_certificate_that_says_little_is_not_called_unverified(
    bench: SecureBench, cert: str, said: str
) -> None:
    master = bench.call(bench.tap(ListenTls(SLAVE, ca=cert), TargetTls(cert)), master_context(cert))
    bench.accept(slave_context(cert)).sendall(ANSWER)
    assert master.recv(100) == ANSWER
    opened = take_until(bench.inbox, lambda item: isinstance(item, StreamOpened))[-1]
    assert isinstance(opened, StreamOpened)
    assert opened.note == f"master TLS 1.3, {said}; slave TLS 1.3, {said}"


def test_a_request_right_behind_the_handshake_waits_for_the_target(bench: SecureBench) -> None:
    tap = bench.tap(LISTEN)
    outgoing, incoming = ssl.MemoryBIO(), ssl.MemoryBIO()
    tls = master_context().wrap_bio(incoming, outgoing, server_hostname="localhost")
    with bench.call(tap) as master:
        while True:
            try:
                tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                master.sendall(outgoing.read())
                incoming.write(master.recv(2**16))
        tls.write(REQUEST)
        master.sendall(outgoing.read())  # The end of the handshake and a request, in one segment.
        assert bench.accept().recv(100) == REQUEST
    items = take_until(bench.inbox, lambda item: isinstance(item, StreamClosed))
    opened, request = [item for item in items if isinstance(item, StreamOpened | Chunk)]
    assert isinstance(request, Chunk)
    assert request.data == REQUEST
    assert opened.ts_ns <= request.ts_ns


def test_a_master_that_sends_before_the_target_has_answered_is_stopped() -> None:
    with ExitStack() as stack:
        busy = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        target = Endpoint(*busy.getsockname())
        for _ in range(2):  # One waits to be accepted; who comes behind it gets no answer.
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex((target.host, target.port))
        inbox = Inbox()
        link = TapLink(ANY_PORT, target, listen_tls=LISTEN)
        tap = stack.enter_context(TapSource(link, inbox))
        plain = socket.create_connection((tap.endpoint.host, tap.endpoint.port), PATIENCE_S)
        master = stack.enter_context(
            master_context().wrap_socket(plain, server_hostname="localhost")
        )
        master.settimeout(0.5)
        sent = 0
        with suppress(TimeoutError):
            while sent < 2**26:
                sent += master.send(bytes(2**14))
        assert sent < 2**26
        (relay,) = tap._relays
        assert len(relay.master._early) <= 2**19
        assert not any(isinstance(item, Chunk) for item in drain(inbox))


def swap(connection: socket.socket, data: bytes) -> bytes:
    """Send and receive as much at once, in one thread: OpenSSL takes no two for a connection."""
    connection.setblocking(False)
    sent, heard = 0, b""
    waits = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)
    while sent < len(data) or len(heard) < len(data):
        before = sent, len(heard)
        with suppress(*waits):
            sent += connection.send(data[sent : sent + 2**14])
        with suppress(*waits):
            piece = connection.recv(2**16)
            assert piece, "the connection has ended"
            heard += piece
        if (sent, len(heard)) == before:
            writing = [connection] if sent < len(data) else []
            assert any(select.select([connection], writing, [], PATIENCE_S))
    return heard


@SIDES
def test_megabytes_pass_unchanged_both_ways_at_once(
    bench: SecureBench, listen: ListenTls | None, target: TargetTls | None
) -> None:
    upward, downward = os.urandom(2 * 2**20), os.urandom(2 * 2**20)
    master, slave = bench.both(listen, target)
    with ThreadPoolExecutor() as pool:
        at_master = pool.submit(swap, master, upward)
        at_slave = pool.submit(swap, slave, downward)
        assert at_master.result(PATIENCE_S) == downward
        assert at_slave.result(PATIENCE_S) == upward
    hang_up(master)
    slave.close()
    said, _ = bench.recorded()
    assert said == {Direction.REQUEST: upward, Direction.RESPONSE: downward}


@SIDES
def test_a_side_that_does_not_read_stops_the_other(
    bench: SecureBench, listen: ListenTls | None, target: TargetTls | None
) -> None:
    master, slave = bench.both(listen, target)
    master.settimeout(0.5)
    sent = 0
    with suppress(TimeoutError):
        while sent < 2**28:
            sent += master.send(bytes(2**14))
    assert sent < 2**28
    # The slave then reads, and all of it comes.
    heard = 0
    while heard < sent:
        heard += len(slave.recv(2**16))


@SIDES
def test_the_end_of_a_slave_comes_behind_its_last_words(
    bench: SecureBench, listen: ListenTls | None, target: TargetTls | None
) -> None:
    master, slave = bench.both(listen, target)
    words = os.urandom(300_000)

    def speak() -> None:
        slave.sendall(words)
        hang_up(slave)

    speaker = Thread(target=speak)
    speaker.start()
    assert read_to_end(master) == words
    speaker.join(PATIENCE_S)
    hang_up(master)
    said, closed = bench.recorded()
    assert said[Direction.RESPONSE] == words
    assert closed.reason is CloseReason.FINISHED


@pytest.mark.parametrize(
    ("listen", "target"), [(LISTEN, None), (None, TARGET)], ids=["tls-plain", "plain-tls"]
)
def test_a_half_close_ends_both_directions(
    bench: SecureBench, listen: ListenTls | None, target: TargetTls | None
) -> None:
    master, slave = bench.both(listen, target)
    master.sendall(REQUEST)
    assert slave.recv(100) == REQUEST
    # Of TLS, shutdown() ends the connection below it.
    master.shutdown(socket.SHUT_WR)
    assert read_to_end(slave) == b""
    hang_up(slave)
    said, closed = bench.recorded()
    assert said[Direction.REQUEST] == REQUEST
    assert closed.reason is CloseReason.FINISHED


@SIDES
def test_a_slave_that_is_reset_resets_the_master(
    bench: SecureBench, listen: ListenTls | None, target: TargetTls | None
) -> None:
    master, slave = bench.both(listen, target)
    slave.sendall(ANSWER)
    assert master.recv(100) == ANSWER
    slave.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
    slave.close()
    # Python's TLS takes a reset for an end, so it is looked for below it.
    with socket.socket(fileno=os.dup(master.fileno())) as below:
        assert select.select([below], [], [], PATIENCE_S)[0]
        with pytest.raises(ConnectionResetError):
            below.recv(100)
    said, closed = bench.recorded()
    assert said[Direction.RESPONSE] == ANSWER
    assert closed.reason is CloseReason.RESET


@VERSIONS
@pytest.mark.parametrize(
    ("cert", "ca", "message"),
    [
        (None, CA, "TLS: the master shows no certificate"),
        (EXPIRED, CA, "TLS: the master's certificate is refused: certificate has expired"),
        (
            STRANGER,
            CA,
            "TLS: the master's certificate is refused: unable to get local issuer certificate",
        ),
        (NO_SUBJECT, CA, "TLS: the master's certificate is refused: self-signed certificate"),
        (
            MASTER,
            OTHER_CA,
            "TLS: the master refuses: it does not know who vouches for the tap's certificate",
        ),
    ],
    ids=["none", "expired", "stranger", "self-signed", "other-ca"],
)
def test_a_master_that_fails_the_handshake_is_one_event_and_the_target_is_not_called(
    bench: SecureBench, version: ssl.TLSVersion, cert: str | None, ca: str, message: str
) -> None:
    tap = bench.tap(LISTEN_MUTUAL)
    with suppress(OSError):
        bench.call(tap, master_context(cert, ca=ca, version=version)).recv(100)
    (event,) = bench.events()
    assert (event.kind, event.message) == (EventKind.REFUSED, message)
    assert (event.link, event.destination) == (str(bench.target), str(bench.target))
    # The next master is none the worse, and the first to reach the target.
    master = bench.call(tap, master_context(NO_ROLE))
    slave = bench.accept()
    master.sendall(REQUEST)
    assert slave.recv(100) == REQUEST
    assert bench.inbox.get(PATIENCE_S) is not None
    assert not any(isinstance(item, WireEvent) for item in drain(bench.inbox))


def test_a_master_without_tls_is_one_event(bench: SecureBench) -> None:
    master = bench.call(bench.tap(LISTEN))
    master.sendall(bytes.fromhex("0001 0000 0006 01 03 0000 0001"))
    with suppress(ConnectionResetError):
        assert master.recv(100) == b""
    assert [event.message for event in bench.events()] == ["TLS: the master speaks no TLS"]


def test_a_master_that_hangs_up_in_the_handshake_is_one_event(bench: SecureBench) -> None:
    bench.call(bench.tap(LISTEN)).close()
    (event,) = bench.events()
    assert event.message == "TLS: the master breaks off the handshake"


def test_the_end_does_not_wait_for_a_handshake(bench: SecureBench) -> None:
    link = TapLink(ANY_PORT, bench.target, listen_tls=LISTEN)
    with TapSource(link, bench.inbox) as tap:
        master = bench.call(tap)
        master.sendall(bytes.fromhex("16 0301"))  # The beginning of a record.
        bench.call(tap, master_context())
    assert master.recv(100) == b""


@VERSIONS
@pytest.mark.parametrize(
    ("cert", "target", "why"),
    [
        (SLAVE, TargetTls(OTHER_CA), "unable to get local issuer certificate"),
        (
            ELSEWHERE,
            TARGET,
            "IP address mismatch, certificate is not valid for '127.0.0.1'; "
            "--tls-target-name says which name it has instead",
        ),
        (EXPIRED, TARGET, "certificate has expired"),
        (NO_SUBJECT, TARGET, "self-signed certificate"),
    ],
    ids=["other-ca", "elsewhere", "expired", "self-signed"],
)
def test_a_target_whose_certificate_is_wrong_is_one_event_and_resets_the_master(
    bench: SecureBench, version: ssl.TLSVersion, cert: str, target: TargetTls, why: str
) -> None:
    master = bench.call(bench.tap(target=target))
    with suppress(OSError):
        bench.accept(slave_context(cert, version=version)).recv(100)
    with pytest.raises(ConnectionResetError):
        master.recv(100)
    message = f"{bench.target}: TLS: the slave's certificate is refused: {why}"
    assert [(event.kind, event.message) for event in bench.events()] == [
        (EventKind.REFUSED, message)
    ]


@pytest.mark.parametrize("cert", [SLAVE, ELSEWHERE])
@pytest.mark.parametrize(
    "target",
    [
        TargetTls(None),
        TargetTls(SLAVE),
        TargetTls(ELSEWHERE),
        TargetTls(CA, name="plc.example"),
    ],
    ids=["unverified", "its certificate", "the certificate of another name", "named"],
)
def test_a_target_may_be_known_by_its_name_or_its_very_certificate_or_not_at_all(
    bench: SecureBench, cert: str, target: TargetTls
) -> None:
    is_right = target.ca is None or (cert == SLAVE) is (target.ca == SLAVE)
    master = bench.call(bench.tap(target=target))
    with suppress(OSError):
        bench.accept(slave_context(cert)).sendall(ANSWER)
    if is_right:
        assert master.recv(100) == ANSWER
    else:
        with pytest.raises(ConnectionResetError):
            master.recv(100)


@VERSIONS
def test_a_target_that_refuses_the_taps_certificate_is_one_event(
    bench: SecureBench, version: ssl.TLSVersion
) -> None:
    master = bench.call(bench.tap(target=TargetTls(CA, STRANGER)))
    with pytest.raises(ssl.SSLCertVerificationError):
        bench.accept(slave_context(ca=CA, version=version))
    with pytest.raises(ConnectionResetError):
        master.recv(100)
    (event,) = bench.events()
    assert event.kind is EventKind.REFUSED
    # With TLS 1.3 the tap's handshake is over by then.
    assert event.message.removeprefix(f"{bench.target}: ") == (
        "TLS: the slave refuses: it does not know who vouches for the tap's certificate"
    )
