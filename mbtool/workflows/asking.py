"""A master that asks one request at a time and waits for its answer."""

from __future__ import annotations

import socket
import time
from typing import TYPE_CHECKING, Protocol, Self

from mbtool.core import Direction, Endpoint, LinkError, SerialLink
from mbtool.modbus import Adu, MbapSplitter, RtuStreamSplitter, mbap_adu, rtu_adu
from mbtool.slave import open_port

if TYPE_CHECKING:
    from mbtool.modbus import Skipped

TIMEOUT_S = 2.0


class Master(Protocol):
    """Asks on an open link."""

    def ask(self, unit: int, pdu: bytes) -> bytes | None:
        """The response PDU, or None where none comes in time. Raises LinkError."""
        ...


class TcpMaster:
    """Speaks Modbus/TCP. A context manager whose exit closes the connection."""

    def __init__(self, endpoint: Endpoint) -> None:
        """Connect. Raises LinkError."""
        try:
            self._socket = socket.create_connection((endpoint.host, endpoint.port), TIMEOUT_S)
        except OSError as error:
            raise LinkError(f"{endpoint}: cannot be reached: {error}") from error
        self._endpoint = endpoint
        self._splitter = MbapSplitter(Direction.RESPONSE)
        self._transaction_id = 0

    def ask(self, unit: int, pdu: bytes) -> bytes | None:
        self._transaction_id = self._transaction_id % 0xFFFF + 1
        try:
            self._socket.sendall(mbap_adu(self._transaction_id, unit, pdu))
            while data := self._socket.recv(4096):
                for adu in _adus(self._splitter.feed(data, 0)):
                    if adu.transaction_id == self._transaction_id:
                        return adu.pdu
        except TimeoutError:
            return None
        except OSError as error:
            raise LinkError(f"{self._endpoint}: lost: {error}") from error
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


class RtuMaster:
    """Speaks RTU on a serial port. A context manager whose exit closes the port."""

    def __init__(self, link: SerialLink) -> None:
        """Open the port. Raises LinkError."""
        self._port = open_port(link, TIMEOUT_S)
        # What another master would keep on this line: t3.5, and time for the sniffer's adapter.
        self._pause_s = max(2 * link.format.t3_5_ns / 1e9, 0.005)

    def ask(self, unit: int, pdu: bytes) -> bytes | None:
        time.sleep(self._pause_s)
        splitter = RtuStreamSplitter(Direction.RESPONSE)
        try:
            self._port.write(rtu_adu(unit, pdu))
            while data := self._port.read(1):
                data += self._port.read(self._port.in_waiting)
                for adu in _adus(splitter.feed(data, 0)):
                    return adu.pdu
        except OSError as error:  # pyserial's errors are OSErrors too.
            raise LinkError(f"serial port {self._port.port}: lost: {error}") from error
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()


def _adus(events: list[Adu | Skipped]) -> list[Adu]:
    return [event for event in events if isinstance(event, Adu)]
