"""Listening on loopback sockets, and what is said where that cannot be done."""

from __future__ import annotations

import errno
import os
import socket
from contextlib import closing

import pytest

from mbtool.core import Endpoint, LinkError, TapLink, TcpLink, UsageError
from mbtool.ports.tcp_listener import AllowedPeers, TcpListener

PATIENCE_S = 10.0
TARGET = Endpoint("192.0.2.1", 502)


def listener_at(host: str, port: int = 0, *networks: str) -> TcpListener:
    endpoint = Endpoint(host, port)
    listener = TcpListener(TcpLink(endpoint), endpoint, AllowedPeers.parse(networks))
    listener.open()
    return listener


def connect(listener: TcpListener, host: str) -> None:
    socket.create_connection((host, listener.endpoint.port), PATIENCE_S).close()


def has_ipv6() -> bool:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        return False
    return True


needs_ipv6 = pytest.mark.skipif(not has_ipv6(), reason="there is no ::1 here")


@pytest.mark.parametrize("host", ["127.0.0.1", pytest.param("::1", marks=needs_ipv6)])
def test_port_0_takes_a_free_port(host: str) -> None:
    with closing(listener_at(host)) as listener:
        assert listener.endpoint.host == host
        assert listener.endpoint.port > 0
        connect(listener, host)


@needs_ipv6
@pytest.mark.parametrize("host", ["::1", "127.0.0.1"])
def test_all_addresses_of_ipv6_are_those_of_ipv4_too(host: str) -> None:
    with closing(listener_at("::", 0, "fd00::/8")) as listener:
        connect(listener, host)
        accepted, peer = listener.sock.accept()
        accepted.close()
        assert listener.refusal(peer[0]) is None


def test_a_peer_is_refused_by_its_address_in_plain_form() -> None:
    with closing(listener_at("0.0.0.0", 0, "10.0.0.0/8", "192.0.2.7")) as listener:
        assert listener.refusal("::ffff:10.0.0.1") is None
        assert listener.refusal("192.0.2.7") is None
        assert listener.refusal("::ffff:192.0.2.8") == "192.0.2.8 is in no network of --allow"


@pytest.mark.parametrize("host", ["0.0.0.0", pytest.param("::", marks=needs_ipv6)])
def test_an_address_that_others_can_reach_needs_the_option(host: str) -> None:
    with pytest.raises(UsageError, match=f"^tcp:.* other machines can reach {host}; .* --allow "):
        listener_at(host)


def test_a_host_name_counts_as_the_address_that_it_stands_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("192.0.2.1", 1502))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    with pytest.raises(UsageError, match=r"other machines can reach 192\.0\.2\.1"):
        listener_at("localhost", 1502)


def test_a_port_in_use_is_named_with_the_link() -> None:
    with closing(listener_at("127.0.0.1")) as listener:
        link = TapLink(listener.endpoint, TARGET)
        with pytest.raises(LinkError) as told:
            TcpListener(link, link.listen).open()
    assert str(told.value) == (
        f"{link}: cannot listen at {link.listen}: the port is in use; give another one, "
        "or 0 for any that is free"
    )


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (errno.EACCES, "ports below 1024 need a privilege"),
        (errno.EADDRNOTAVAIL, "no interface here has this address"),
        (errno.ENOBUFS, os.strerror(errno.ENOBUFS)),
    ],
)
@pytest.mark.parametrize("call", ["bind", "listen"])
def test_an_error_of_the_system_is_one_line(
    monkeypatch: pytest.MonkeyPatch, number: int, says: str, call: str
) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(socket, "socket", type("Failing", (socket.socket,), {call: fail}))
    with pytest.raises(LinkError, match=f"^tcp:127.0.0.1:0: cannot listen at 127.0.0.1:0: {says}"):
        listener_at("127.0.0.1")


@pytest.mark.parametrize("host", ["nowhere.invalid", "x" * 70, "a..b"])
def test_a_host_that_does_not_exist_is_told(monkeypatch: pytest.MonkeyPatch, host: str) -> None:
    if host == "nowhere.invalid":

        def fail(*_: object, **__: object) -> list[object]:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

        monkeypatch.setattr(socket, "getaddrinfo", fail)
    with pytest.raises(LinkError, match=f"cannot listen at {host}:0: no such host; give an addr"):
        listener_at(host)


@pytest.mark.parametrize("host", ["127.0.0.1", pytest.param("::1", marks=needs_ipv6)])
def test_a_held_port_refuses_connections_and_stays_taken(host: str) -> None:
    with closing(listener_at(host)) as listener:
        endpoint = listener.endpoint
        with pytest.raises(LinkError, match="the port is in use"):
            listener.hold()  # Its own socket still listens.
        listener.close()
        listener.hold()
        assert listener.endpoint == endpoint
        with pytest.raises(ConnectionRefusedError):
            connect(listener, host)
        listener.sock.listen()
        connect(listener, host)
