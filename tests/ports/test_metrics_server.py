"""The text that is served over HTTP."""

from __future__ import annotations

import http.client
import socket
import time
import urllib.error
import urllib.request
from contextlib import suppress

import pytest

from mbtool.core import Endpoint, LinkError, UsageError
from mbtool.ports.metrics_server import CONTENT_TYPE, MAX_FETCHING, MetricsServer, parse_place
from mbtool.ports.tcp_listener import AllowedPeers, ConnectionLimits

PATIENCE_S = 20.0
LOOPBACK = Endpoint("127.0.0.1", 0)


@pytest.mark.parametrize(
    ("text", "place"),
    [(":9502", Endpoint("127.0.0.1", 9502)), ("0.0.0.0:80", Endpoint("0.0.0.0", 80)),
     ("[::1]:80", Endpoint("::1", 80))],
)  # fmt: skip
def test_without_a_host_it_is_this_machine_alone(text: str, place: Endpoint) -> None:
    assert parse_place(text) == place


@pytest.mark.parametrize("text", ["9502x", "host", "host:", "host:70000"])
def test_a_place_of_another_form_is_one_clear_line(text: str) -> None:
    with pytest.raises(UsageError, match="--metrics"):
        parse_place(text)


def test_the_text_that_was_set_last_is_served() -> None:
    with MetricsServer(LOOPBACK) as server:
        for text in (b"a 1\n# EOF\n", b"a 2\n# EOF\n"):
            server.text = text
            with urllib.request.urlopen(f"http://{server.place}/metrics") as answer:
                assert (answer.read(), answer.headers["Content-Type"]) == (text, CONTENT_TYPE)
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(f"http://{server.place}/other")


def test_many_connections_that_ask_nothing_leave_room_when_they_end() -> None:
    with MetricsServer(LOOPBACK) as server:
        port = int(server.place.rpartition(":")[2])
        idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(MAX_FETCHING + 4)]
        for one in idle:
            one.close()
        found = b""
        until = time.monotonic() + PATIENCE_S
        while not found and time.monotonic() < until:
            # The server may not have noticed yet that they have ended.
            with suppress(OSError):
                found = urllib.request.urlopen(f"http://{server.place}/metrics", timeout=30).read()
        assert found == b"# EOF\n"


def test_a_client_that_sends_a_byte_now_and_then_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbtool.ports.metrics_server.FETCH_S", 0.2)
    with MetricsServer(LOOPBACK) as server:
        port = int(server.place.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port)) as slow:
            slow.settimeout(0.02)
            answered: bytes | None = None
            until = time.monotonic() + PATIENCE_S
            while answered is None and time.monotonic() < until:
                try:
                    slow.sendall(b"G")
                    answered = slow.recv(1)
                except TimeoutError:
                    continue
                except ConnectionError:
                    answered = b""
            assert answered == b""


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_an_address_that_others_can_reach_needs_the_option(host: str) -> None:
    with (
        pytest.raises(UsageError, match=r"^--metrics .* other machines can reach .*--allow"),
        MetricsServer(Endpoint(host, 0)),
    ):
        pass


def test_a_machine_that_is_not_allowed_is_closed_without_an_answer() -> None:
    allowed = AllowedPeers.parse(["192.0.2.0/24"])
    with MetricsServer(Endpoint("0.0.0.0", 0), allowed) as server:
        assert server._server is not None
        assert server._server.verify_request(None, ("192.0.2.7", 1))  # type: ignore[arg-type]
        assert server._server.verify_request(None, ("127.0.0.1", 1))  # type: ignore[arg-type]
        assert not server._server.verify_request(None, ("198.51.100.7", 1))  # type: ignore[arg-type]


def test_connections_that_come_too_fast_are_closed_without_an_answer() -> None:
    allowed = AllowedPeers(limits=ConnectionLimits(per_second=0.001))
    with MetricsServer(LOOPBACK, allowed) as server:
        with urllib.request.urlopen(f"http://{server.place}/metrics", timeout=30) as answer:
            assert answer.read() == b"# EOF\n"
        with pytest.raises((urllib.error.URLError, ConnectionError, http.client.HTTPException)):
            urllib.request.urlopen(f"http://{server.place}/metrics", timeout=30)


def test_an_address_of_ipv6_is_served() -> None:
    with MetricsServer(Endpoint("::1", 0)) as server:
        assert server.place.startswith("[::1]:")
        with urllib.request.urlopen(f"http://{server.place}/metrics", timeout=30) as answer:
            assert answer.read() == b"# EOF\n"


def test_nobody_is_asked_for_the_name_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.getfqdn", lambda *_: pytest.fail("DNS"))
    with MetricsServer(LOOPBACK) as server:
        assert server.place.startswith("127.0.0.1:")


def test_an_address_that_is_taken_is_one_clear_line() -> None:
    with MetricsServer(LOOPBACK) as server:
        port = int(server.place.rpartition(":")[2])
        with (
            pytest.raises(LinkError, match="cannot be opened"),
            MetricsServer(Endpoint("127.0.0.1", port)),
        ):
            pass
