"""Links to sniff without hardware: a relay before a slave, and a virtual serial line."""

from __future__ import annotations

import os
import socket
import time
from contextlib import ExitStack, closing, suppress
from typing import TYPE_CHECKING, Self

from mbtool.core import Endpoint, SerialFormat, SerialLink, TapLink, TcpLink
from mbtool.master.links import open_master
from mbtool.modbus import rtu_adu
from mbtool.slave.shells import TcpSlave
from mbtool.sources.tap import TapSource
from mbtool.sources.virtual_line import VirtualLine
from tests.slave.scripted import Scripted, echo
from tests.sources.live_helpers import MASTER_TIMEOUT_NS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mbtool.decode.decoder import Record
    from mbtool.workflows.sniff import Sniffer

PATIENCE_S = 120.0
ANY = Endpoint("127.0.0.1", 0)
FAST = SerialFormat(115200, 8, "N", 1)


class Bench:
    """A slave that echoes, and a serial line; both end with the context."""

    def __init__(self) -> None:
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def slave(self) -> Endpoint:
        """Where a slave answers each request with its own bytes."""
        slave = TcpSlave(TcpLink(ANY), Scripted(echo))
        self._stack.enter_context(slave)
        return slave.endpoint

    def tap(self) -> TapLink:
        return TapLink(ANY, self.slave())

    def refusing_tap(self) -> TapLink:
        """A tap before a port that is taken and does not listen."""
        silent = self._stack.enter_context(closing(socket.socket()))
        silent.bind(("127.0.0.1", 0))
        return TapLink(ANY, Endpoint(*silent.getsockname()))

    def line(self, folder: Path) -> tuple[SerialLink, int]:
        """A serial line: the end to listen at, and the descriptor of the end that speaks."""
        names = [str(folder / "tap"), str(folder / "master")]
        line = self._stack.enter_context(VirtualLine(ends=2, format=FAST, link_names=names))
        listening, speaking = line.ports
        descriptor = os.open(speaking, os.O_RDWR | os.O_NOCTTY)
        self._stack.callback(os.close, descriptor)
        return SerialLink(listening, FAST), descriptor

    def close(self) -> None:
        """Take all links away."""
        self._stack.close()


def ask(sniffer: Sniffer, pdu: bytes, count: int = 1, tap: int = 0) -> None:
    """Ask the slave behind a sniffer's tap, and get its answers."""
    taps = [source for source in sniffer.sources if isinstance(source, TapSource)]
    with open_master(TcpLink(taps[tap].endpoint), MASTER_TIMEOUT_NS) as master:
        for _ in range(count):
            assert master.ask(1, pdu) == pdu


def call_in_vain(sniffer: Sniffer, count: int) -> None:
    """Connect to a sniffer's tap whose slave cannot be reached."""
    (tap,) = (source for source in sniffer.sources if isinstance(source, TapSource))
    for _ in range(count):
        be_turned_away(tap.endpoint)


def be_turned_away(endpoint: Endpoint) -> None:
    """Connect where the connection is reset at once."""
    address = (endpoint.host, endpoint.port)
    with (
        suppress(ConnectionResetError),
        socket.create_connection(address, PATIENCE_S) as master,
    ):
        assert master.recv(1) == b""


def speak(descriptor: int, pdu: bytes, unit: int = 1) -> None:
    """Send a frame on a serial line."""
    os.write(descriptor, rtu_adu(unit, pdu))


def until(
    records: list[Record], is_enough: Callable[[list[Record]], bool]
) -> Callable[[int], bool]:
    """What tells a sniffer to stop; fails when it would take too long."""
    deadline = time.monotonic() + PATIENCE_S

    def stop(_now_ns: int) -> bool:
        assert time.monotonic() < deadline, f"only {records}"
        return is_enough(records)

    return stop
