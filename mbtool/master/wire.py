"""Sends any bytes to a slave, right or wrong, and returns the bytes that come back."""

# A test needs bytes that a master never sends: a wrong CRC, half an ADU, two ADUs at once. The
# returned bytes end with a silence on a serial line. On TCP they end with the last expected ADU,
# the end of the connection, or the timeout. Time in which this process got no processor is not
# counted (Patience), so that on a busy machine no answer is late and no pause is inside one.

from __future__ import annotations

import select
import socket
import time
from abc import abstractmethod
from collections.abc import Sequence
from errno import ETIMEDOUT
from typing import NamedTuple

from mbtool.core import LinkError, LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.core.closing import ClosesOnExit
from mbtool.core.link_spec import ANSWERED
from mbtool.core.moments import SECOND_NS
from mbtool.master.links import CONNECT_S, READ_BYTES, Patience, SerialMaster
from mbtool.modbus import ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.adu import (
    CRC_BYTES,
    MAX_ASCII_ADU,
    MBAP_BYTES,
    RTU_EXTRA_BYTES,
    crc,
    mbap_size,
    read_frame,
)
from mbtool.modbus.expected_response import EXCEPTION_SIZE, ExpectedResponse
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.ports.host_names import why_failed

_ASCII_END = b"\r\n"
QUIET_NS = 300_000_000
"""Bytes that must get no answer count as unanswered if nothing comes for this time (ns), nor for
QUIET_TIMES times the longest time that an answer has taken."""
QUIET_TIMES = 2
_LEAST_GAP_NS = 40_000_000
"""After a whole response on a serial line further bytes are awaited for at least this time, in ns:
USB adapters deliver bytes in blocks up to 16 ms apart."""
_REST_NS = 500_000_000
"""The rest of an answer on a serial line is awaited for this time (ns) after its last byte."""
_KEEP_ALIVE = (("TCP_KEEPIDLE", 1), ("TCP_KEEPINTVL", 1), ("TCP_KEEPCNT", 1))
"""A probe is sent after one second of silence (s); one that is not answered for a second ends the
connection."""
_SHOWN = 32
"""A text shows at most this many bytes of a damaged answer."""


class HeardAdu(NamedTuple):
    """An ADU that a slave sent."""

    unit: int
    pdu: bytes
    transaction_id: int | None = None


class Heard(NamedTuple):
    """The bytes that a slave sent back, and their times."""

    raw: bytes
    adus: tuple[HeardAdu, ...]
    """The ADUs in `raw`; bytes that are no ADU are not among them."""
    after_ns: int
    """The time from the last byte sent to the first byte that came back, in ns."""
    is_closed: bool = False
    """True if the slave closed the TCP connection."""
    was_closed: bool = False
    """True if the slave had closed the connection before the bytes were sent, so that a new one was
    opened."""
    longest_pause_ns: int = 0
    """The longest silence inside the answer that was surely heard, in ns; 0 on TCP."""
    rest: bytes = b""
    """The bytes behind the last ADU, on TCP and in ASCII."""
    made_pause_ns: int = 0
    """An upper bound (ns) of the pause between the pieces sent on a serial line; on a busy machine
    it is longer than asked for."""


class Wire(ClosesOnExit):
    """A link to one slave, for any bytes. A context manager whose exit closes it."""

    def __init__(self, timeout_ns: int) -> None:
        self.timeout_ns = timeout_ns
        self._last_id = 0
        self._longest_ns = 0
        """The longest time, in ns, that an answer has taken."""

    @abstractmethod
    def adu(self, unit: int, pdu: bytes) -> bytes:
        """Return the right ADU of a PDU on this link."""

    @abstractmethod
    def send(self, pieces: Sequence[bytes], pause_ns: int = 0, awaited: int = 1) -> Heard:
        """Send pieces with a pause between them, and return what comes back.

        Waits for `awaited` ADUs on TCP; with 0, as for bytes that get no answer, for QUIET_NS, or
        longer if answers have taken longer.
        Raises LinkError if the link is lost.
        """

    @abstractmethod
    def hear(self, wait_ns: int, since_ns: int | None = None) -> Heard:
        """Return what comes without a request, for at most `wait_ns` ns until its first byte.

        `since_ns` is the time of the monotonic clock (ns) from which the time to its first byte is
        measured; None for now. Raises LinkError if the link is lost.
        """

    @abstractmethod
    def damage(self, raw: bytes, request: bytes) -> str:
        """Say why the bytes of an answer are no ADU; `request` is the PDU that was sent."""

    def _wait_ns(self, awaited: int) -> int:
        quiet_ns = max(QUIET_NS, QUIET_TIMES * self._longest_ns)
        return self.timeout_ns if awaited else min(self.timeout_ns, quiet_ns)

    def renew(self) -> None:
        """Open a new TCP connection in place of this one."""


def open_wire(link: LinkSpec, timeout_ns: int, listen_ns: int | None) -> Wire:
    """Open a link for any bytes. On a serial line listen first, as `MasterLink.take_line` does.

    Raises LinkError if the slave cannot be reached, or another master asks on the line, UsageError
    for a link on which nobody answers.
    """
    if isinstance(link, TcpLink) and link.is_udp:
        raise UsageError(
            f"link {link}: a test sends pieces of ADUs, which UDP cannot; test the slave over TCP "
            "or on its serial line"
        )
    if isinstance(link, TcpLink):
        return TcpWire(link, timeout_ns)
    if not isinstance(link, SerialLink):
        raise UsageError(f"link {link}: a test needs {ANSWERED}")
    link.demand_one_port()
    master = SerialMaster(link, timeout_ns)
    try:
        master.take_line(listen_ns)
    except BaseException:
        master.close()
        raise
    return SerialWire(master, timeout_ns)


class SerialWire(Wire):
    """A serial port, RTU or ASCII."""

    def __init__(self, master: SerialMaster, timeout_ns: int) -> None:
        super().__init__(timeout_ns)
        self._master = master
        self._format = master.link.format
        self._gap_ns = max(_LEAST_GAP_NS, 2 * self._format.t3_5_ns)

    def adu(self, unit: int, pdu: bytes) -> bytes:
        return (ascii_adu if self._master.link.ascii else rtu_adu)(unit, pdu)

    def send(self, pieces: Sequence[bytes], pause_ns: int = 0, awaited: int = 1) -> Heard:
        quiet_ns = time.monotonic_ns() + QUIET_NS
        while self._master.overhear(2 * self._format.t3_5_ns)[0]:
            if time.monotonic_ns() > quiet_ns:
                raise LinkError(f"{self._master.link}: somebody else speaks without a pause")
        made_ns = end_ns = 0
        for number, piece in enumerate(pieces):
            if number:
                time.sleep(max(end_ns + pause_ns - time.monotonic_ns(), 0) / SECOND_NS)
            taken_ns = self._master.send_bytes(piece)
            made_ns = max(made_ns, taken_ns - end_ns) if number else 0
            # A virtual line reports at once that all bytes were sent, and carries them afterwards.
            on_line_ns = len(piece) * self._format.character_ns
            end_ns = max(taken_ns + on_line_ns, time.monotonic_ns())
        return self.hear(self._wait_ns(awaited))._replace(made_pause_ns=made_ns)

    def hear(self, wait_ns: int, since_ns: int | None = None) -> Heard:
        begin_ns = time.monotonic_ns()
        raw, first_ns, read_ns, longest_ns, pause_ns = b"", 0, 0, 0, 0
        patience = Patience(wait_ns)
        whole = Patience(wait_ns + _REST_NS + MAX_ASCII_ADU * self._format.character_ns)
        while whole.next_ns() > 0 and (slice_ns := patience.next_ns()) > 0:
            data, silent_ns = self._master.overhear(slice_ns)
            now_ns = time.monotonic_ns()
            if not data:
                # What came since the last read would be there.
                longest_ns = max(longest_ns, silent_ns - read_ns) if raw else 0
            else:
                first_ns, read_ns = first_ns or now_ns, now_ns
                raw += data
                pause_ns = longest_ns
                patience = Patience(self._gap_ns if self._adus(raw) else _REST_NS)
        after_ns = first_ns - (begin_ns if since_ns is None else since_ns) if first_ns else 0
        self._longest_ns = max(self._longest_ns, after_ns)
        return Heard(
            raw,
            self._adus(raw),
            after_ns,
            rest=raw.rpartition(_ASCII_END)[2] if self._master.link.ascii else b"",
            longest_pause_ns=pause_ns,
        )

    def damage(self, raw: bytes, request: bytes) -> str:
        if not self._master.link.ascii:
            return _rtu_damage(raw, request)
        first, end, _ = raw.partition(_ASCII_END)
        if not end:
            return f"a frame without its end, CR LF: {_hex_text(raw)}"
        frame = read_frame(first + end)
        if frame is None or frame.checksum.ok:
            return f"bytes that are no frame: {_hex_text(raw)}"
        received, computed = frame.checksum.received, frame.checksum.computed
        return f"a wrong LRC: {received:02x}, right is {computed:02x}"

    def _adus(self, raw: bytes) -> tuple[HeardAdu, ...]:
        if self._master.link.ascii:
            *parts, _ = raw.split(_ASCII_END)
            frames = [read_frame(part + _ASCII_END) for part in parts]
            return tuple(
                HeardAdu(one.body[0], one.body[1:])
                for one in frames
                if one is not None and one.checksum.ok
            )
        if len(raw) >= 4 and crc(raw[:-2]) == int.from_bytes(raw[-2:], "little"):
            return (HeardAdu(raw[0], raw[1:-2]),)
        return ()

    def close(self) -> None:
        self._master.close()


MAX_HEARD = 1 << 16
"""About so many bytes are read for one request, or dropped before one: a slave may send without
end."""


class TcpWire(Wire):
    """A TCP connection: Modbus/TCP, or RTU over TCP."""

    def __init__(self, link: TcpLink, timeout_ns: int) -> None:
        super().__init__(timeout_ns)
        self._link = link
        self._socket: socket.socket | None = None
        self.renew()

    def adu(self, unit: int, pdu: bytes) -> bytes:
        if self._link.rtu:
            return rtu_adu(unit, pdu)
        self._last_id = self._last_id % 0xFFFF + 1
        return mbap_adu(self._last_id, unit, pdu)

    def open_another(self) -> TcpWire:
        """Return a further connection to the same slave. Raises LinkError if it is refused."""
        return TcpWire(self._link, self.timeout_ns)

    def stay_silent(self, silent_ns: int) -> bool:
        """Send nothing for `silent_ns` ns, with keep-alive probes from one second on; False if the
        connection ends meanwhile.

        Raises LinkError if nothing answers the probes.
        """
        if self._socket is None:
            self.renew()
        assert self._socket is not None
        for name, value in _KEEP_ALIVE:
            if hasattr(socket, name):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        end_ns = time.monotonic_ns() + silent_ns
        try:
            while (rest_ns := end_ns - time.monotonic_ns()) > 0:
                self._socket.settimeout(rest_ns / SECOND_NS)
                if not self._socket.recv(READ_BYTES):
                    break
            else:
                return True
        except TimeoutError as error:
            if error.errno != ETIMEDOUT:
                return True
            self.close()
            raise LinkError(f"{self._link}: no answer to the keep-alive probes of TCP") from error
        except OSError:
            pass
        self.close()
        return False

    def renew(self) -> None:
        self.close()
        endpoint = self._link.endpoint
        try:
            self._socket = socket.create_connection((endpoint.host, endpoint.port), CONNECT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except (OSError, UnicodeError) as error:
            raise LinkError(f"{self._link}: cannot be reached: {why_failed(error)}") from error

    def send(self, pieces: Sequence[bytes], pause_ns: int = 0, awaited: int = 1) -> Heard:
        if self._socket is None:
            self.renew()
        assert self._socket is not None
        was_closed = self.is_ended()
        if was_closed:
            self.renew()
        try:
            for number, piece in enumerate(pieces):
                if number:
                    time.sleep(pause_ns / SECOND_NS)
                self._socket.sendall(piece)
        except OSError:
            self.close()
            return Heard(b"", (), 0, is_closed=True, was_closed=was_closed)
        return self._receive(self._wait_ns(awaited), awaited, was_closed=was_closed)

    def hear(self, wait_ns: int, since_ns: int | None = None) -> Heard:
        return self._receive(wait_ns, 1, since_ns=since_ns)

    def _receive(
        self, wait_ns: int, awaited: int, *, was_closed: bool = False, since_ns: int | None = None
    ) -> Heard:
        raw, first_ns, is_closed = b"", 0, self._socket is None
        sent_ns = time.monotonic_ns() if since_ns is None else since_ns
        patience = Patience(wait_ns)
        try:
            while (not awaited or len(self._adus(raw)) < awaited) and self._socket is not None:
                slice_ns = patience.next_ns()
                if slice_ns <= 0:
                    break
                if not select.select([self._socket], [], [], slice_ns / SECOND_NS)[0]:
                    continue
                data = self._socket.recv(READ_BYTES)
                first_ns = first_ns or time.monotonic_ns()
                raw += data
                if len(raw) > MAX_HEARD:
                    break
                if not data:
                    is_closed = True
                    self.close()
        except OSError:
            is_closed = True
            self.close()
        adus = self._adus(raw)
        size = 0 if self._link.rtu else sum(MBAP_BYTES + len(one.pdu) for one in adus)
        after_ns = max(first_ns - sent_ns, 0) if raw else 0
        self._longest_ns = max(self._longest_ns, after_ns)
        rest = raw[size:] if adus and size else b""
        return Heard(raw, adus, after_ns, is_closed, was_closed, rest=rest)

    def is_ended(self) -> bool:
        """Return True if the slave has ended the connection. Bytes that came since the last answer
        are dropped.
        """
        if self._socket is None:
            return True
        dropped = 0
        try:
            while dropped <= MAX_HEARD and select.select([self._socket], [], [], 0)[0]:
                data = self._socket.recv(READ_BYTES)
                if not data:
                    return True
                dropped += len(data)
        except OSError:
            return True
        return False

    def damage(self, raw: bytes, request: bytes) -> str:
        if self._link.rtu:
            return _rtu_damage(raw, request)
        if len(raw) >= MBAP_BYTES:
            protocol, size = int.from_bytes(raw[2:4]), mbap_size(raw)
            if protocol:
                return f"protocol id {protocol:04X}, right is 0000"
            if len(raw) < size:
                return f"{len(raw)} bytes of an ADU of {size}: {_hex_text(raw)}"
        return f"bytes that are no ADU: {_hex_text(raw)}"

    def _adus(self, raw: bytes) -> tuple[HeardAdu, ...]:
        if self._link.rtu:
            is_right = len(raw) >= 4 and crc(raw[:-2]) == int.from_bytes(raw[-2:], "little")
            return (HeardAdu(raw[0], raw[1:-2]),) if is_right else ()
        adus = []
        while raw[2:4] == b"\0\0" and MBAP_BYTES < mbap_size(raw) <= len(raw):
            size = mbap_size(raw)
            adus.append(HeardAdu(raw[6], raw[MBAP_BYTES:size], int.from_bytes(raw[:2])))
            raw = raw[size:]
        return tuple(adus)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _rtu_damage(raw: bytes, request: bytes) -> str:
    """Say why bytes are no answer in RTU to the request with this PDU."""
    expected = ExpectedResponse.of(request)
    sizes = [EXCEPTION_SIZE, *([expected.size] if expected is not None else ())]
    for size in (one + RTU_EXTRA_BYTES for one in sizes):
        if size <= len(raw) and not crc(raw[:size]):
            return f"{_hex_text(raw[size:])} behind the answer"
    is_exception = raw[1:2] == bytes([request[0] | EXCEPTION_BIT])
    size = (EXCEPTION_SIZE if is_exception else sizes[-1]) + RTU_EXTRA_BYTES
    if len(raw) == size:
        right = crc(raw[:-CRC_BYTES]).to_bytes(CRC_BYTES, "little")
        return f"a wrong CRC: {raw[-CRC_BYTES:].hex(' ')}, right is {right.hex(' ')}"
    return f"{len(raw)} bytes, where the answer has {size}: {_hex_text(raw)}"


def _hex_text(raw: bytes) -> str:
    return raw[:_SHOWN].hex(" ")
