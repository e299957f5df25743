"""A link on which recorded requests are sent and their answers come back."""

# Over TCP answers find their request by the transaction id, which counts up with each request; on a
# serial line, and with RTU over TCP, there is one open request, and the next frame of its unit
# answers it. A connection that the slave closes is opened again for the next request; while that
# fails, and when it is lost, requests have no answer and are not waited for. What is tried in vain
# for a while is not tried for as long again, so at most half of the time goes into it; a refusal
# takes none. Each failure is told once, and its end.
#
# One thread sends and receives: it waits in `receive` until bytes come or the time is over.
#
# Holds: the splitter's incomplete ADU, and the numbers of the requests that are open, and of those
# that were lost, at most MAX_OPEN_REQUESTS of each; the oldest is forgotten first.

from __future__ import annotations

import os
import select
import socket
import time
from abc import ABC, abstractmethod
from collections import deque
from typing import TYPE_CHECKING, NamedTuple, Self

from mbtool.core import Direction, LinkError, LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.core.limits import MAX_OPEN_REQUESTS, LinkLimits
from mbtool.core.link_spec import ANSWERED
from mbtool.framing import MbapSplitter, RtuStreamSplitter
from mbtool.modbus import Adu, ascii_adu, mbap_adu, rtu_adu
from mbtool.ports.serial_opening import open_port, port_in_use
from mbtool.serial_line import AsciiSplitter, RtuSplitter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.modbus import Skipped

CONNECT_S = 5.0
SLOW_S = 0.5
"""How long a connection that was lost may take to come back before a request is given up."""
READ_BYTES = 4096
LONGEST_WAIT_S = 3600.0
_POLL_S = 0.001
"""How often a port is looked at where one cannot wait for it."""

_NS = 1_000_000_000


class Answered(NamedTuple):
    """An answer, from its first byte to its last."""

    number: int
    """The number that the request was sent with; -1 where no request is open for it."""
    pdu: bytes
    start_ns: int
    end_ns: int


class MasterLink(ABC):
    """Sends requests; a context manager whose exit closes the link."""

    limits: LinkLimits

    @abstractmethod
    def send(self, number: int, unit: int, pdu: bytes) -> None:
        """Send a request. Raises LinkError where the link is lost for good."""

    @abstractmethod
    def receive(self, timeout_ns: int) -> Sequence[Answered]:
        """The answers that have come; waits for one, at most so long. Raises LinkError."""

    def lost(self) -> Sequence[int]:
        """The requests since the last time that cannot be answered: their connection is gone."""
        return ()

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_master(
    link: LinkSpec, timeout_ns: int, on_remark: Callable[[str], None] = lambda _: None
) -> MasterLink:
    """A master on a link, waiting so long for answers. Raises LinkError, UsageError.

    `on_remark` is told when a connection cannot be opened again, and when it can.
    """
    if isinstance(link, SerialLink):
        link.demand_one_port()
        return SerialMaster(link, timeout_ns)
    if isinstance(link, TcpLink):
        return TcpMaster(link, timeout_ns, on_remark)
    raise UsageError(f"link {link}: a master needs {ANSWERED}")


class TcpMaster(MasterLink):
    """Speaks Modbus/TCP, or RTU over TCP."""

    def __init__(
        self, link: TcpLink, timeout_ns: int, on_remark: Callable[[str], None] = lambda _: None
    ) -> None:
        """Connect. Raises LinkError."""
        self.limits = LinkLimits(timeout_ns=timeout_ns, one_at_a_time=link.rtu)
        self._link = link
        self._on_remark = on_remark
        self._is_away = False
        """The connection could not be opened again."""
        self._again_ns = 0
        """When to try it again."""
        self._open: dict[int, tuple[int, int]] = {}
        """By transaction id, or 0 with RTU: the request's number and unit."""
        self._lost: deque[int] = deque(maxlen=MAX_OPEN_REQUESTS)
        self._last_id = 0
        self._socket: socket.socket | None = self._connect(CONNECT_S)

    def send(self, number: int, unit: int, pdu: bytes) -> None:
        if self._socket is None:
            self._socket = self._reconnect()
        if self._socket is None:
            self._lost.append(number)
            return
        if self._link.rtu:
            self._open.clear()
            adu = rtu_adu(unit, pdu)
        else:
            self._last_id = self._last_id % 0xFFFF + 1
            adu = mbap_adu(self._last_id, unit, pdu)
        self._open[self._last_id] = number, unit
        if len(self._open) > MAX_OPEN_REQUESTS:
            del self._open[next(iter(self._open))]
        try:
            self._socket.sendall(adu)
        except OSError:
            self._lose()

    def receive(self, timeout_ns: int) -> Sequence[Answered]:
        wait_s = min(max(timeout_ns / _NS, 0.0), LONGEST_WAIT_S)
        if self._socket is None:
            time.sleep(wait_s)
            return ()
        if not select.select([self._socket], [], [], wait_s)[0]:
            return ()
        try:
            data = self._socket.recv(READ_BYTES)
        except OSError:
            data = b""
        now_ns = time.monotonic_ns()
        if not data:
            self._lose()
            return ()
        return [
            answer
            for event in self._splitter.feed(data, now_ns)
            if (answer := self._matched(event)) is not None
        ]

    def lost(self) -> Sequence[int]:
        numbers = list(self._lost)
        self._lost.clear()
        return numbers

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _matched(self, event: Adu | Skipped) -> Answered | None:
        if not isinstance(event, Adu):
            return None
        number, unit = self._open.get(event.transaction_id or 0, (-1, -1))
        if self._link.rtu and unit != event.unit:
            number = -1  # Another unit's. A Modbus/TCP slave may give any (FA3: the id counts).
        if number >= 0:
            del self._open[event.transaction_id or 0]
        return Answered(number, event.pdu, event.start_ns, event.end_ns)

    def _lose(self) -> None:
        self.close()
        self._lost.extend(number for number, _ in self._open.values())
        self._open.clear()

    def _reconnect(self) -> socket.socket | None:
        begin_ns = time.monotonic_ns()
        if begin_ns < self._again_ns:
            return None
        try:
            connected = self._connect(SLOW_S)
        except LinkError as error:
            if not self._is_away:
                self._on_remark(f"mbtool: the connection was lost; {error}")
            self._is_away = True
            now_ns = time.monotonic_ns()
            self._again_ns = now_ns + (now_ns - begin_ns)
            return None
        if self._is_away:
            self._on_remark(f"mbtool: {self._link}: connected again")
        self._is_away = False
        return connected

    def _connect(self, timeout_s: float) -> socket.socket:
        endpoint = self._link.endpoint
        try:
            connected = socket.create_connection((endpoint.host, endpoint.port), timeout_s)
        except OSError as error:
            why = "no answer" if isinstance(error, TimeoutError) else error.strerror or error
            raise LinkError(
                f"{self._link}: cannot be reached: {why}; does a slave listen there?"
            ) from error
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._splitter = (RtuStreamSplitter if self._link.rtu else MbapSplitter)(Direction.RESPONSE)
        return connected


class SerialMaster(MasterLink):
    """Speaks RTU or ASCII on a serial port."""

    def __init__(self, link: SerialLink, timeout_ns: int) -> None:
        """Open the port. Raises LinkError."""
        self.limits = LinkLimits(
            timeout_ns=timeout_ns, one_at_a_time=True, pause_ns=link.format.t3_5_ns
        )
        self._link = link
        self._port = open_port(link, link.format.t3_5_ns / _NS)
        splitter = AsciiSplitter if link.ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(
            link.format, speaker=Direction.RESPONSE
        )
        self._open: tuple[int, int] | None = None

    def send(self, number: int, unit: int, pdu: bytes) -> None:
        adu = (ascii_adu if self._link.ascii else rtu_adu)(unit, pdu)
        self._open = number, unit
        with port_in_use(self._link):
            self._port.write(adu)
            # The answer's silence begins where the request ends, and so does its time-out.
            self._port.flush()

    def receive(self, timeout_ns: int) -> Sequence[Answered]:
        until_ns = time.monotonic_ns() + max(timeout_ns, 0)
        answers: list[Answered] = []
        while not answers:
            rest_ns = until_ns - time.monotonic_ns()
            with port_in_use(self._link):
                data = self._read(min(max(rest_ns, 0), self._link.format.t3_5_ns) / _NS)
            now_ns = time.monotonic_ns()
            events = self._splitter.feed(data, now_ns) if data else self._splitter.advance(now_ns)
            answers = [self._matched(event) for event in events if isinstance(event, Adu)]
            if rest_ns <= 0:
                break
        return answers

    def close(self) -> None:
        self._port.close()

    def _read(self, wait_s: float) -> bytes:
        """What has come, or comes within so long.

        The port's own time-out is not touched: pyserial sets the whole port up anew for that, which
        takes its time, and which a pseudo-terminal refuses where a line has parity.
        """
        if os.name == "posix":
            if not select.select([self._port], [], [], wait_s)[0]:
                return b""
        elif not self._port.in_waiting:
            time.sleep(min(wait_s, _POLL_S))
            if not self._port.in_waiting:
                return b""
        return bytes(self._port.read(self._port.in_waiting or 1))

    def _matched(self, adu: Adu) -> Answered:
        number, unit = self._open if self._open is not None else (-1, -1)
        if unit != adu.unit:
            return Answered(-1, adu.pdu, adu.start_ns, adu.end_ns)
        self._open = None
        return Answered(number, adu.pdu, adu.start_ns, adu.end_ns)
