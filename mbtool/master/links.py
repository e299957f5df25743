"""Links on which a master sends requests and receives responses."""

# Matching. Over Modbus/TCP a response names its request by the transaction id, which counts up with
# each request. On a serial line and with RTU over TCP one request is pending at a time, and the
# next frame from its unit is the response.
#
# Lost connections. When the slave closes the connection, it is opened again for the next request.
# As long as this fails, requests are reported as lost at once, so that nobody waits for their
# responses. After a failed attempt, the next one is made only after the same time as the attempt
# took, so attempts take at most half of the time; a refused attempt takes almost no time, so it
# delays no other. The user is told when the connection cannot be opened again, and when it is open
# again.
#
# One thread sends and receives: it waits in `receive` until bytes come or the timeout is over.
#
# Memory: one incomplete ADU, and the numbers of pending and of lost requests, at most
# MAX_OPEN_REQUESTS of each; the oldest is forgotten first. The last MAX_UNREAD pieces of bytes that
# belong to no response are kept until the next request.

from __future__ import annotations

import os
import select
import socket
import ssl
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction, LinkError, LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.core.closing import ClosesOnExit
from mbtool.core.limits import MAX_OPEN_REQUESTS, LinkLimits
from mbtool.core.link_spec import ANSWERED
from mbtool.core.moments import SECOND_NS, duration
from mbtool.framing import MbapSplitter, RtuStreamSplitter
from mbtool.master.other_master import (
    FEW_BYTES,
    MARGIN_NS,
    MOST_LISTEN_NS,
    RELIABLE,
    SILENT_LISTEN_NS,
    NoPauseError,
    OtherMaster,
)
from mbtool.modbus import Adu, Skipped, ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.adu import MAX_PDU, DirectionBy, Transport
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.modbus.response import ConnectionEnding
from mbtool.ports.arrival_times import SerialArrivals, note_arrivals, receive
from mbtool.ports.host_names import why_failed, why_unknown
from mbtool.ports.serial_opening import open_port, port_in_use
from mbtool.ports.tcp_listener import reset_on_close
from mbtool.ports.tls import client_context, failure
from mbtool.serial_line import AsciiSplitter, RtuSplitter

if TYPE_CHECKING:
    from mbtool.core import Endpoint, TargetTls

CONNECT_S = 5.0
"""Timeout for opening the first connection, in seconds."""
RECONNECT_S = 0.5
"""Timeout for opening a lost connection again, in seconds. It is short because a request waits."""
READ_BYTES = 4096
_LEAST_TLS_WAIT_S = 0.001
LONGEST_WAIT_S = 3600.0
MAX_UNREAD = 16
_POLL_S = 0.001
"""The interval in seconds at which a serial port is checked for bytes, on systems that cannot wait
for them (Windows)."""
LONGEST_TURN_NS = 60_000_000_000
"""A request that waits for a pause of another master fails after this time (ns)."""
_LONGEST_LATER_TURN_NS = 180_000_000_000
"""The limit in place of LONGEST_TURN_NS once a request was sent in a pause (ns). Pauses that are
long enough are then known to come, but after a short pause, as before a request that the other
master sent out of turn, it may take a while until one counts again."""
_LISTEN_SLICE_NS = 20_000_000
"""The longest single read while listening before the first request, in ns."""
SLICE_NS = 20_000_000
"""The longest single wait for a response, in ns."""
MAX_WAIT_STRETCH = 3
"""On a busy machine, the wait for a response takes at most this many times its set length."""
_LEAST_ASK_PAUSE_NS = 5_000_000
"""Shortest pause, in ns, before a request of `ask` on a serial line. At high baud rates t3.5 is so
short that a listening adapter would return two frames as one."""


class Patience:
    """A time for which something is awaited, in waits of at most SLICE_NS.

    A wait that takes longer than that, as this process got no processor, counts as SLICE_NS: the
    slave may be on the same machine, and what it sent meanwhile is read at the next look. So the
    time may become longer, but at most MAX_WAIT_STRETCH times as long.
    """

    def __init__(self, wait_ns: int, most_ns: int = SLICE_NS) -> None:
        """A single wait counts as `most_ns` at most."""
        self._wait_ns, self._most_ns = wait_ns, most_ns
        self._looked_ns = time.monotonic_ns()
        self._end_ns = self._looked_ns + MAX_WAIT_STRETCH * wait_ns
        self._waited_ns = 0

    def next_ns(self) -> int:
        """Return how long to wait next, in ns; 0 or less if the time is over."""
        now_ns = time.monotonic_ns()
        self._waited_ns += min(now_ns - self._looked_ns, self._most_ns)
        self._looked_ns = now_ns
        return min(self._wait_ns - self._waited_ns, self._end_ns - now_ns, SLICE_NS)


class ReceivedResponse(NamedTuple):
    """A response, with the times of its first and last byte."""

    number: int
    """The number that the request was sent with; -1 if it belongs to no pending request."""
    pdu: bytes
    start_ns: int
    end_ns: int


class Exchange(NamedTuple):
    """A request and what was received after it. Times are those of the monotonic clock, in ns."""

    request: Adu
    response: Adu | None
    """The response; None if none came in time, or if the request was a broadcast."""
    unread: tuple[Skipped, ...]
    """Bytes that came after the request and are no ADU, such as a frame with a wrong CRC."""


class MasterLink(ClosesOnExit):
    """Sends requests and receives responses. A context manager whose exit closes the link."""

    limits: LinkLimits
    transport: Transport
    _asked = 0
    """The number of requests sent by `exchange`, which numbers them from 1."""
    _request: Adu
    """The request sent last, with the time when it was sent."""
    _response: Adu | None = None
    """The last response received that belongs to a request; None before the first one."""

    def __init__(self) -> None:
        self._unread: deque[Skipped] = deque(maxlen=MAX_UNREAD)
        self.is_stopped: Callable[[], bool] = lambda: False
        """Returns True once no request shall wait for a pause of another master any more."""

    @abstractmethod
    def send(self, number: int, unit: int, pdu: bytes) -> None:
        """Send a request; `number` is the caller's, and its response will have the same.

        If a TCP connection is lost, `lost` returns the number. Raises LinkError if a serial port
        fails or is unplugged.
        """

    @abstractmethod
    def receive(self, timeout_ns: int) -> Sequence[ReceivedResponse]:
        """Return the responses that have come; if there is none, wait at most `timeout_ns` for one.

        Raises LinkError if a serial port is lost.
        """

    def lost(self) -> Sequence[int]:
        """Return the numbers of requests that get no response because the connection was lost.

        Each number is returned only once.
        """
        return ()

    def ask(self, unit: int, pdu: bytes) -> bytes | None:
        """Send one request and return the PDU of its response; None if none comes in time.

        `ask` numbers its requests itself, so do not also use `send` on the same link.
        Raises LinkError if a serial port is lost.
        """
        response = self.exchange(unit, pdu).response
        return None if response is None else response.pdu

    def exchange(self, unit: int, pdu: bytes) -> Exchange:
        """Send one request and wait for its response, as `ask` does.

        No unit responds to a broadcast (unit 0) on a serial line: this returns after the turnaround
        delay. If the TCP connection is lost, it returns at once. Raises LinkError if a serial port
        is lost.
        """
        wait_ns = self._await_turn(unit, pdu)
        while not self._is_turn():
            wait_ns = self._await_turn(unit, pdu)
        self.receive(0)  # Drop late responses, which would be taken for this request's.
        self._unread.clear()
        self._asked += 1
        self.send(self._asked, unit, pdu)
        if unit == 0 and self.transport.is_serial:
            time.sleep(self.limits.turnaround_ns / SECOND_NS)
            return Exchange(self._request, None, ())
        response = self._response if self._is_answered(wait_ns) else None
        return Exchange(self._request, response, tuple(self._unread))

    def take_line(self, listen_ns: int | None, *, between: bool = False) -> None:
        """Before the first request listen to a serial line, which another master may poll.

        Listens for `listen_ns` ns, or until each poll of the other master is known; 0 for not at
        all, None for one second in silence and at most five. With `between`, `exchange` sends in
        the pauses of the other master. Raises LinkError if another master asks there, or somebody
        speaks with other settings.
        """

    def listen(self, time_ns: int) -> None:
        """Hear another master of the line for a time (ns), to learn the pauses that it leaves."""

    def _await_turn(self, unit: int, pdu: bytes) -> int:
        """Wait until `exchange` may send this request; return how long, in ns, to wait for its
        response.
        """
        if self.limits.pause_ns:
            time.sleep(max(2 * self.limits.pause_ns, _LEAST_ASK_PAUSE_NS) / SECOND_NS)
        return self.limits.timeout_ns

    def _is_turn(self) -> bool:
        """False if the turn has passed since `_await_turn`, as this process was suspended."""
        return True

    def _is_answered(self, wait_ns: int) -> bool:
        """Wait for the response to the last request; False if it does not come in `wait_ns`."""
        patience = self._patience(wait_ns)
        while self._asked not in self.lost():
            # Read once more after the timeout, because this process may have been suspended.
            rest_ns = patience.next_ns()
            if any(one.number == self._asked for one in self.receive(max(rest_ns, 0))):
                return True
            if rest_ns <= 0:
                return False
        return False

    def _patience(self, wait_ns: int) -> Patience:
        return Patience(wait_ns)

    def _note_request(
        self, unit: int, pdu: bytes, raw: bytes, transaction_id: int | None = None
    ) -> None:
        """Store the request that was sent just now, with the bytes `raw` of its ADU."""
        now_ns = time.monotonic_ns()
        self._request = Adu(
            start_ns=now_ns,
            end_ns=now_ns,
            transport=self.transport,
            direction=Direction.REQUEST,
            direction_by=DirectionBy.PORT,
            confidence=1.0,
            unit=unit,
            pdu=pdu,
            raw=raw,
            transaction_id=transaction_id,
        )


def open_master(
    link: LinkSpec,
    timeout_ns: int,
    on_remark: Callable[[str], None] = lambda _: None,
    tls: TargetTls | None = None,
) -> MasterLink:
    """Open a master on a link; `timeout_ns` is the longest wait for a response.

    `on_remark` gets a line when a lost connection cannot be opened again, and when it is open
    again. `tls` is for a slave that speaks Modbus/TCP Security. Raises LinkError if the slave
    cannot be reached, TLS fails or the port cannot be opened, UsageError if a master cannot use
    such a link.
    """
    if tls is not None and (not isinstance(link, TcpLink) or link.rtu or link.is_udp):
        raise UsageError(f"link {link}: TLS is for Modbus/TCP, tcp:HOST:PORT")
    if isinstance(link, SerialLink):
        link.demand_one_port()
        return SerialMaster(link, timeout_ns)
    if isinstance(link, TcpLink):
        return TcpMaster(link, timeout_ns, on_remark, tls)
    raise UsageError(f"link {link}: a master needs {ANSWERED}")


class TcpMaster(MasterLink):
    """A master that reaches slaves through a TCP connection (Modbus/TCP, or RTU over TCP), or with
    datagrams of UDP.

    A datagram has whole ADUs: bytes of two are never joined. A lost one is not sent again.
    """

    def __init__(
        self,
        link: TcpLink,
        timeout_ns: int,
        on_remark: Callable[[str], None] = lambda _: None,
        tls: TargetTls | None = None,
        connect_s: float = CONNECT_S,
    ) -> None:
        """Connect to the slave, for at most `connect_s` seconds; see open_master. Raises LinkError
        if it cannot be reached.
        """
        super().__init__()
        self.transport = Transport.at_endpoint(is_rtu=link.rtu, is_udp=link.is_udp)
        self.limits = LinkLimits(timeout_ns=timeout_ns, one_at_a_time=link.rtu)
        self._link = link
        self._on_remark = on_remark
        self._tls = None if tls is None else client_context(tls, link.endpoint.host)
        """The ssl context, and the name expected in the slave's certificate; None without TLS."""
        self._is_reconnecting = False
        """True if the last attempt to open a lost connection again failed."""
        self._next_attempt_ns = 0
        self._pending: dict[int, tuple[int, int]] = {}
        """The number and the unit of each pending request, by transaction id. RTU over TCP has no
        such ids: at most one request is pending, with the key 0."""
        self._lost: deque[int] = deque(maxlen=MAX_OPEN_REQUESTS)
        self._last_id = 0
        self._is_refused = False
        """True after nobody listened at the slave's UDP port, until a datagram comes from it. The
        user is told only once."""
        self.ended: ConnectionEnding | None = None
        """The way in which the slave ended the last connection, FIN or RST; None if it did not, and
        always for UDP."""
        self.socket: socket.socket | None = self._connect(connect_s)

    def send(self, number: int, unit: int, pdu: bytes) -> None:
        if self.socket is None:
            self.socket = self._reconnect()
        if self._link.rtu:
            self._pending.clear()
            adu = rtu_adu(unit, pdu)
        else:
            self._last_id = self._last_id % 0xFFFF + 1
            adu = mbap_adu(self._last_id, unit, pdu)
        self._note_request(unit, pdu, adu, None if self._link.rtu else self._last_id)
        if self.socket is None:
            self._lost.append(number)
            return
        self._pending[self._last_id] = number, unit
        if len(self._pending) > MAX_OPEN_REQUESTS:
            del self._pending[next(iter(self._pending))]
        try:
            self.socket.sendall(adu)
        except OSError as error:
            if self._link.is_udp:
                self._report_failed(error)
            else:
                self.ended = ConnectionEnding.RESET
            self._drop_connection()

    def receive(self, timeout_ns: int) -> Sequence[ReceivedResponse]:
        wait_s = min(max(timeout_ns / SECOND_NS, 0.0), LONGEST_WAIT_S)
        if self.socket is None:
            time.sleep(wait_s)
            return ()
        if not self._has_bytes(self.socket, wait_s):
            return ()
        try:
            data, arrived_ns = receive(self.socket, READ_BYTES)
        except (TimeoutError, ssl.SSLWantReadError):
            return ()  # Only TLS's own messages came, no data.
        except OSError as error:
            self._report_failed(error)
            if self._link.is_udp:
                return ()
            data, arrived_ns = b"", 0
            self.ended = ConnectionEnding.RESET
        if self._link.is_udp:
            self._is_refused = False
            if not data:
                return ()
        if not data:
            self.ended = self.ended or ConnectionEnding.CLOSE
            self._drop_connection()
            return ()
        rest = self._splitter.restart() if self._link.is_udp else []
        return [
            response
            for event in [*rest, *self._splitter.feed(data, arrived_ns)]
            if (response := self._match_response(event)) is not None
        ]

    def _report_failed(self, error: OSError) -> None:
        why = failure(error, "slave")
        if self._link.is_udp and isinstance(error, ConnectionRefusedError):
            if not self._is_refused:
                why = "its host answers that nobody listens at this port"
            self._is_refused = True
        if why is not None:
            self._on_remark(f"mbtool: {self._link}: {why}")

    @staticmethod
    def _has_bytes(connected: socket.socket, wait_s: float) -> bool:
        """Wait at most `wait_s` seconds; True if bytes can be read, also from TLS's buffer."""
        if isinstance(connected, ssl.SSLSocket):
            if connected.pending():
                return True
            connected.settimeout(max(wait_s, _LEAST_TLS_WAIT_S))
        return bool(select.select([connected], [], [], wait_s)[0])

    def lost(self) -> Sequence[int]:
        numbers = list(self._lost)
        self._lost.clear()
        return numbers

    def end(self, ending: ConnectionEnding) -> None:
        """End the connection as the master, with a FIN or a RST. Pending requests are lost."""
        if self.socket is not None and ending is ConnectionEnding.RESET:
            reset_on_close(self.socket)
        self._drop_connection()

    def close(self) -> None:
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def _match_response(self, event: Adu | Skipped) -> ReceivedResponse | None:
        if not isinstance(event, Adu):
            self._unread.append(event)
            return None
        number, unit = self._pending.get(event.transaction_id or 0, (-1, -1))
        if self._link.rtu and unit != event.unit:
            number = -1  # With Modbus/TCP the unit may differ: FA3 modules answer with their own.
        if number >= 0:
            self._response = event
            del self._pending[event.transaction_id or 0]
        return ReceivedResponse(number, event.pdu, event.start_ns, event.end_ns)

    def _drop_connection(self) -> None:
        self.close()
        self._lost.extend(number for number, _ in self._pending.values())
        self._pending.clear()

    def _reconnect(self) -> socket.socket | None:
        begin_ns = time.monotonic_ns()
        if begin_ns < self._next_attempt_ns:
            return None
        try:
            connected = self._connect(RECONNECT_S)
        except LinkError as error:
            if not self._is_reconnecting:
                self._on_remark(f"mbtool: the connection was lost; {error}")
            self._is_reconnecting = True
            now_ns = time.monotonic_ns()
            self._next_attempt_ns = now_ns + (now_ns - begin_ns)
            return None
        if self._is_reconnecting:
            self._on_remark(f"mbtool: {self._link}: connected again")
        self._is_reconnecting = False
        return connected

    def _connect(self, timeout_s: float) -> socket.socket:
        endpoint = self._link.endpoint
        try:
            if self._link.is_udp:
                connected = _datagram_socket(endpoint)
            else:
                connected = socket.create_connection((endpoint.host, endpoint.port), timeout_s)
        except (OSError, UnicodeError) as error:
            unknown = why_unknown(error)
            hint = "does a slave listen there?" if unknown is None else "is the name right?"
            why = unknown or why_failed(error)
            raise LinkError(f"{self._link}: cannot be reached: {why}; {hint}") from error
        if not self._link.is_udp:
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._tls is not None:
            connected = self._open_tls(connected, *self._tls)
        note_arrivals(connected)
        self._splitter = (RtuStreamSplitter if self._link.rtu else MbapSplitter)(
            Direction.RESPONSE, is_udp=self._link.is_udp
        )
        return connected

    def _open_tls(
        self, connected: socket.socket, context: ssl.SSLContext, name: str
    ) -> socket.socket:
        """Return the connection after a TLS handshake. Raises LinkError if TLS fails."""
        try:
            return context.wrap_socket(connected, server_hostname=name)
        except (OSError, ValueError) as error:
            connected.close()
            of_tls = failure(error, "slave") if isinstance(error, OSError) else None
            why = of_tls or f"TLS: {why_failed(error)}; perhaps it speaks no TLS"
            raise LinkError(f"{self._link}: {why}") from error


def _datagram_socket(endpoint: Endpoint) -> socket.socket:
    """Open a socket that exchanges datagrams with one endpoint. Raises OSError, UnicodeError."""
    family, kind, protocol, _, address = socket.getaddrinfo(
        endpoint.host, endpoint.port, type=socket.SOCK_DGRAM
    )[0]
    connected = socket.socket(family, kind, protocol)
    try:
        connected.connect(address)
    except OSError:
        connected.close()
        raise
    return connected


class SerialMaster(MasterLink):
    """A master that reaches slaves through a serial port: RTU or ASCII."""

    def __init__(self, link: SerialLink, timeout_ns: int) -> None:
        """Open the port. Raises LinkError if it cannot be opened."""
        super().__init__()
        self.transport = Transport.ASCII if link.ascii else Transport.RTU
        self.limits = LinkLimits(
            timeout_ns=timeout_ns, one_at_a_time=True, pause_ns=link.format.t3_5_ns
        )
        self.link = link
        self._port = open_port(link, link.format.t3_5_ns / SECOND_NS)
        splitter = AsciiSplitter if link.ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(
            link.format, speaker=Direction.RESPONSE
        )
        self._arrivals = SerialArrivals(link.format.character_ns)
        self._doubt_ns = 0
        """The error of the time of the last read (ns): its bytes may have come this much later."""
        self._pending: tuple[int, int] | None = None
        self._expected: ExpectedResponse | None = None
        """The form of the pending request's response."""
        self._other: OtherMaster | None = None
        """The other master in whose pauses requests are sent; None if there is no other master."""
        self._turns = 0
        """The number of requests that were sent in pauses of the other master."""
        self._turn_ends_ns = 0
        """The latest time (ns) at which the next request may be sent in the present pause."""
        self.on_bytes: Callable[[bytes, int, bool], None] = lambda *_: None
        """Called with all bytes of the line, the time of the last one in ns of the monotonic clock,
        and True for a request of this program and for the bytes after it, until it waits for the
        next turn."""

    def send(self, number: int, unit: int, pdu: bytes) -> None:
        adu = (ascii_adu if self.link.ascii else rtu_adu)(unit, pdu)
        self._pending = number, unit
        self._expected = ExpectedResponse.of(pdu)
        # The silence before the response, and the timeout, begin when the last byte of the request
        # has been sent.
        self.send_bytes(adu)
        self._note_request(unit, pdu, adu)

    def receive(self, timeout_ns: int) -> Sequence[ReceivedResponse]:
        until_ns = time.monotonic_ns() + max(timeout_ns, 0)
        responses: list[ReceivedResponse] = []
        while not responses:
            rest_ns = until_ns - time.monotonic_ns()
            with port_in_use(self.link):
                data, at_ns = self._read(min(max(rest_ns, 0), self.link.format.t3_5_ns))
            if data:
                self.on_bytes(data, at_ns, True)
            events = self._splitter.feed(data, at_ns) if data else self._splitter.advance(at_ns)
            for event in events:
                self._note_intrusion(event)
            self._unread.extend(event for event in events if not isinstance(event, Adu))
            responses = [self._match_response(event) for event in events if isinstance(event, Adu)]
            if rest_ns <= 0 and not data:
                break
        return responses

    def close(self) -> None:
        self._port.close()

    def send_bytes(self, raw: bytes) -> int:
        """Send any bytes, and wait until the last of them has left; return the time, in ns of the
        monotonic clock, at which the port had taken them.

        Raises LinkError if the port is lost.
        """
        with port_in_use(self.link):
            self._port.write(raw)
            taken_ns = time.monotonic_ns()
            self._port.flush()
        self.on_bytes(raw, time.monotonic_ns(), True)
        return taken_ns

    def overhear(self, wait_ns: int) -> tuple[bytes, int]:
        """Return bytes that others sent, and the time of the last one, in ns of the monotonic
        clock; if there are none within `wait_ns`, b"" and the time until which the line was silent.

        Raises LinkError if the port is lost.
        """
        with port_in_use(self.link):
            data, at_ns = self._read(wait_ns)
        if data:
            self.on_bytes(data, at_ns, False)
        return data, at_ns

    def take_line(self, listen_ns: int | None, *, between: bool = False) -> None:
        if listen_ns == 0:
            return
        other = self._listen(listen_ns)
        if not (between and other.polls):
            other.demand_free()
            return
        # From now on a response must fit its request; other responses are probably for the other
        # master.
        self._other = other

    def _listen(self, listen_ns: int | None) -> OtherMaster:
        """Listen as `take_line` says, and return what was heard."""
        other = OtherMaster(self.link)
        in_silence_ns = SILENT_LISTEN_NS if listen_ns is None else listen_ns
        most_ns = MOST_LISTEN_NS if listen_ns is None else listen_ns
        begin_ns = now_ns = time.monotonic_ns()
        while now_ns - begin_ns < most_ns and not other.is_known:
            other.feed(*self.overhear(_LISTEN_SLICE_NS), self._doubt_ns)
            now_ns = time.monotonic_ns()
            if not other.has_heard and now_ns - begin_ns >= in_silence_ns:
                break
        other.end(now_ns - begin_ns)
        return other

    def _await_turn(self, unit: int, pdu: bytes) -> int:
        if self._other is None:
            return super()._await_turn(unit, pdu)
        until_ns = time.monotonic_ns() + self._longest_turn_ns
        while not (
            self._other.has_known_pauses or self.is_stopped() or time.monotonic_ns() >= until_ns
        ):
            self._overhear_other()
        needed_ns, wait_ns = self._needed_ns(self._other, unit, pdu)
        # Once a request was sent, the shortest pause may have been an exception: wait for a longer
        # one.
        most_ns = self._other.longest_pause_ns
        if self._turns:
            most_ns = round(self._other.greatest_pause_ns * RELIABLE)
        if needed_ns > most_ns:
            raise NoPauseError(
                f"{self.link}: a request to unit {unit} needs a pause of {duration(needed_ns)}; "
                f"the longest sure one of the other master is {duration(most_ns)}; it was not sent"
                ". A shorter --timeout needs less, a longer --listen may find more"
            )
        if self._has_missed_bytes():
            self._other.listen_anew(time.monotonic_ns())
        while (
            rest_ns := self._other.silence_left_ns(now_ns := time.monotonic_ns(), unit)
        ) < needed_ns:
            if now_ns > until_ns or self.is_stopped():
                raise NoPauseError(
                    f"{self.link}: the other master left no pause of {duration(needed_ns)} in "
                    f"{duration(self._longest_turn_ns)}; the request was not sent"
                )
            self._overhear_other()
            needed_ns, wait_ns = self._needed_ns(self._other, unit, pdu)
        self._turn_ends_ns = now_ns + rest_ns - needed_ns
        self._other.note_our_request()
        self._turns += 1
        return wait_ns

    def listen(self, time_ns: int) -> None:
        until_ns = time.monotonic_ns() + time_ns
        while self._other is not None and time.monotonic_ns() < until_ns:
            self._overhear_other()

    def _patience(self, wait_ns: int) -> Patience:
        # The pause of another master ends, whether this process runs or not.
        return Patience(wait_ns, SLICE_NS if self._other is None else wait_ns)

    def _overhear_other(self) -> None:
        assert self._other is not None
        self._other.feed(*self.overhear(self.link.format.t3_5_ns), self._doubt_ns)

    def _is_turn(self) -> bool:
        if self._other is None:
            return True
        return time.monotonic_ns() <= self._turn_ends_ns and not self._has_bytes(0.0)

    @property
    def _longest_turn_ns(self) -> int:
        return _LONGEST_LATER_TURN_NS if self._turns else LONGEST_TURN_NS

    def _needed_ns(self, other: OtherMaster, unit: int, pdu: bytes) -> tuple[int, int]:
        """Return the length, in ns, of the pause that a request needs, and the wait for its
        response in it.

        The wait is the timeout, or twice the longest latency heard of the unit if only this fits
        into a pause.
        """
        rest_ns = self._transfer_ns(unit, pdu) + MARGIN_NS
        wait_ns = self.limits.timeout_ns
        known_ns = other.latency_ns(unit)
        if known_ns is not None and rest_ns + wait_ns > other.longest_pause_ns:
            wait_ns = min(wait_ns, 2 * known_ns + MARGIN_NS)
        return rest_ns + wait_ns, wait_ns

    def _has_missed_bytes(self) -> bool:
        """Drop what has waited in the port since the last read, as it came at times that nobody
        knows; True if there was any.
        """
        has_missed = False
        while self.overhear(0)[0]:
            has_missed = True
        return has_missed

    def _note_intrusion(self, event: Adu | Skipped) -> None:
        """While a request of this program is pending, note other bytes. Few bytes are noise, and a
        frame of the unit asked is probably a late answer.
        """
        if self._other is None or self._pending is None:
            return
        if isinstance(event, Adu):
            if event.unit != self._pending[1]:
                self._other.note_intrusion(event.start_ns, self._doubt_ns)
        elif len(event.raw) >= FEW_BYTES:
            self._other.note_intrusion(event.ts_ns, self._doubt_ns)

    def _transfer_ns(self, unit: int, pdu: bytes) -> int:
        """Return the time, in ns, that a request and its response take on the line at most, with
        the silences around them.
        """
        expected = ExpectedResponse.of(pdu)
        size = MAX_PDU if expected is None else expected.size or MAX_PDU
        adu = ascii_adu if self.link.ascii else rtu_adu
        characters = len(adu(unit, pdu)) + len(adu(unit, bytes(size)))
        return characters * self.link.format.character_ns + 3 * self.link.format.t3_5_ns

    def _read(self, wait_ns: int) -> tuple[bytes, int]:
        """Return the bytes that have come; if there are none, wait `wait_ns` at most.

        Also returns the time at which the last of them came, or the present time if there are none.
        The timeout of the pyserial port stays unchanged. To change it, pyserial would configure the
        whole port again, which takes time, and fails on a pseudo-terminal if the line has parity.
        """
        begin_ns = time.monotonic_ns()
        is_there = self._has_bytes(0.0)
        has_bytes = is_there or self._has_bytes(wait_ns / SECOND_NS)
        data = bytes(self._port.read(self._port.in_waiting or 1)) if has_bytes else b""
        now_ns = time.monotonic_ns()
        at_ns = self._arrivals.arrived_ns(len(data), begin_ns, 0 if is_there else wait_ns, now_ns)
        # If other processes held the processor, the wait took longer than `wait_ns`, and the bytes
        # may have come at any time from `at_ns` to `now_ns`.
        self._doubt_ns = now_ns - at_ns
        return data, at_ns

    def _has_bytes(self, wait_s: float) -> bool:
        if os.name == "posix":
            return bool(select.select([self._port], [], [], wait_s)[0])
        if not self._port.in_waiting:
            time.sleep(min(wait_s, _POLL_S))
        return bool(self._port.in_waiting)

    def _match_response(self, adu: Adu) -> ReceivedResponse:
        number, unit = self._pending if self._pending is not None else (-1, -1)
        is_other = self._other is not None and not (
            self._expected is not None and self._expected.fits(adu.pdu)
        )
        is_named = self._expected is None or self._expected.is_named_by(adu.pdu[0])
        if unit != adu.unit or is_other or not is_named:
            return ReceivedResponse(-1, adu.pdu, adu.start_ns, adu.end_ns)
        self._pending, self._response = None, adu
        return ReceivedResponse(number, adu.pdu, adu.start_ns, adu.end_ns)
