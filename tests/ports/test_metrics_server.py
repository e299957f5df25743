"""The text that is served over HTTP."""

from __future__ import annotations

import socket
import time
import urllib.error
import urllib.request

import pytest

from mbtool.core import Endpoint, LinkError, UsageError
from mbtool.ports.metrics_server import CONTENT_TYPE, MAX_FETCHING, MetricsServer, parse_place

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
        with urllib.request.urlopen(f"http://{server.place}/metrics", timeout=30) as answer:
            assert answer.read() == b"# EOF\n"


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
