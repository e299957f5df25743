"""What a service tells systemd, and when."""

from __future__ import annotations

import os
import socket
import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.ports.service_manager import MAX_STATUS, ServiceManager

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets")


def listening(address: str) -> socket.socket:
    channel = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    channel.bind(address)
    channel.setblocking(False)
    return channel


def test_tells_that_it_is_ready_alive_and_stopping(tmp_path: Path) -> None:
    with listening(str(tmp_path / "notify")) as channel:
        manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify")})
        manager.ready("recording")
        manager.status("two\nlines")
        manager.alive()
        manager.stopping()
        told = [channel.recv(1000) for _ in range(4)]
    assert told == [
        b"READY=1\nSTATUS=recording",
        b"STATUS=two lines",
        b"WATCHDOG=1",
        b"STOPPING=1",
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="abstract names are Linux's")
def test_an_abstract_name_begins_with_an_at_sign() -> None:
    name = f"mbtool-test-{os.getpid()}"
    with listening(f"\0{name}") as channel:
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).alive()
        assert channel.recv(100) == b"WATCHDOG=1"


def test_a_status_is_bounded(tmp_path: Path) -> None:
    with listening(str(tmp_path / "notify")) as channel:
        ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify")}).status("x" * 10_000)
        assert len(channel.recv(20_000)) == len("STATUS=") + MAX_STATUS


@pytest.mark.parametrize("address", ["", "/no/such/socket", "@no-such-name", "x" * 200])
def test_a_manager_that_is_not_there_is_no_error(address: str) -> None:
    ServiceManager({"NOTIFY_SOCKET": address}).ready("recording")


@pytest.mark.parametrize(
    ("environment", "every_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_is_for_the_process_that_the_manager_names(
    environment: dict[str, str], every_s: float | None
) -> None:
    assert ServiceManager(environment).watchdog_s == every_s
