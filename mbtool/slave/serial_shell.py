"""Plays slaves on a serial line: RTU or ASCII."""

# One thread reads, hands what it read to the splitter, and writes the answers. A read waits for
# t3.5 at most, and a read that brings nothing is the silence that ends an RTU frame. An answer
# leaves no earlier than t3.5 after its request's last byte (Serial Line V1.02, 2.5.1.1), or later
# where the slave takes longer. Answers leave in the order of their requests.
#
# Heard and not answered: requests for the units of other slaves, and their answers; frames whose
# check is wrong; noise. Only the slaves played here answer to their units, so a frame for one of
# them is a request, also where it equals the answer to the one before (05, 06): nobody's turn
# counts.
#
# Not for adapters that give back what is written to them: their echo would look like a request.
#
# Bounds: MAX_WAITING answers that wait, or pieces of one where it is sent in pieces on purpose
# (modbus/spoiling.py); while there are so many, no request is answered. A write that the line does
# not take for WRITE_TIMEOUT_S is given up.
#
# Linux: a pseudo-terminal has neither parity nor 7 bits, and may refuse them; then, and only on
# one, it is opened with 8N1, which makes no difference to what travels.

from __future__ import annotations

import errno
import threading
from collections import deque
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import serial

from mbtool.core import Direction, LinkError, SerialLink
from mbtool.modbus.adu import Adu
from mbtool.modbus.ascii import AsciiSplitter
from mbtool.modbus.rtu import RtuSplitter
from mbtool.modbus.spoiling import wire_pieces
from mbtool.modbus.turn import Turn
from mbtool.modbus.turns import Judgement, Turns, roles_of
from mbtool.slave.clock import steady_clock
from mbtool.slave.shell import OnExchange, Shell

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.modbus.answer import Responder

MAX_WAITING = 16
WRITE_TIMEOUT_S = 1.0
_NEVER = 32.0
"""Bits: more than a request costs that says what none does."""


class SerialSlave(Shell):
    """Answers on one serial port."""

    def __init__(
        self, link: SerialLink, responder: Responder, *, on_exchange: OnExchange | None = None
    ) -> None:
        super().__init__()
        self.link = link
        self._responder = responder
        self._on_exchange = on_exchange
        self._clock = steady_clock()
        self._stopping = threading.Event()
        splitter = AsciiSplitter if link.ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(link.format, _NobodysTurn())
        self._waiting: deque[tuple[int, bytes]] = deque()
        """Answers, or pieces of them, and when they are due."""

    @property
    def place(self) -> str:
        return str(self.link)

    def _open(self) -> None:
        self._port = open_port(self.link, self.link.format.t3_5_ns / 1e9)

    def _interrupt(self) -> None:
        self._stopping.set()

    def _run(self) -> None:
        with closing(self._port), port_in_use(self.link):
            while not self._stopping.is_set():
                self._read()
                self._send_due()

    def _read(self) -> None:
        data = self._port.read(self._port.in_waiting or 1)
        now_ns = self._clock()
        events = self._splitter.feed(data, now_ns) if data else self._splitter.advance(now_ns)
        for event in events:
            if isinstance(event, Adu) and event.direction is Direction.REQUEST:
                self._take(event, now_ns)

    def _take(self, request: Adu, now_ns: int) -> None:
        if len(self._waiting) >= MAX_WAITING:
            return
        answer = self._responder.respond(request.unit, request.pdu, now_ns)
        if answer is not None:
            due_ns = request.end_ns + max(answer.delay_ns, self.link.format.t3_5_ns)
            for later_ns, data in wire_pieces(answer, request.transport, request.unit):
                self._waiting.append((due_ns + later_ns, data))
        if self._on_exchange is not None:
            self._on_exchange(request, answer)

    def _send_due(self) -> None:
        """Send the answers that are due before the next read would return."""
        while self._waiting:
            due_ns, data = self._waiting[0]
            rest_ns = due_ns - self._clock()
            if rest_ns > self.link.format.t3_5_ns or self._stopping.wait(max(rest_ns, 0) / 1e9):
                return
            self._waiting.popleft()
            try:
                self._port.write(data)
            except serial.SerialTimeoutException:  # Half an answer is none.
                self._port.reset_output_buffer()


class _NobodysTurn(Turns):
    """No request waits for an answer that the line would bring: what can be a request is one."""

    def judge(
        self, unit: int, pdu: bytes, at_ns: int, roles: Sequence[Direction] = ()
    ) -> Judgement:
        return super().judge(unit, pdu, at_ns, _one_role(roles or roles_of(pdu)))

    def weigh(self, turn: Turn, unit: int, pdu: bytes, role: Direction, at_ns: int) -> float:
        is_none = role not in _one_role(roles_of(pdu))
        return super().weigh(turn, unit, pdu, role, at_ns) + (_NEVER if is_none else 0.0)

    def follow(self, *_: object, **__: object) -> Turn:
        return Turn()


def _one_role(roles: Sequence[Direction]) -> Sequence[Direction]:
    return [Direction.REQUEST] if Direction.REQUEST in roles else roles


def open_port(link: SerialLink, timeout_s: float) -> serial.Serial:
    """Open a port to read and write; a read waits for so long. Raises LinkError."""
    try:
        return _open_with(link, timeout_s, link.format.data_bits, link.format.parity)
    except serial.SerialException as error:
        if not _is_pseudo_terminal(link.port) or _error_number(error) != errno.EINVAL:
            raise LinkError(f"serial port {link.port}: {_why_not_open(link, error)}") from error
    try:
        return _open_with(link, timeout_s, serial.EIGHTBITS, serial.PARITY_NONE)
    except serial.SerialException as error:
        raise LinkError(f"serial port {link.port}: {_why_not_open(link, error)}") from error


@contextmanager
def port_in_use(link: SerialLink) -> Iterator[None]:
    """Tell what an open port raises as a LinkError."""
    try:
        yield
    except serial.SerialTimeoutException as error:
        raise LinkError(
            f"serial port {link.port}: takes no bytes; is anything at its other end?"
        ) from error
    except Exception as error:
        if not isinstance(error, OSError) and not _is_of_termios(error):
            raise
        raise LinkError(f"serial port {link.port}: lost; is it still plugged in?") from error


def _is_of_termios(error: Exception) -> bool:
    """Whether pyserial let an error of termios pass, which is no OSError, and not on Windows."""
    return type(error).__module__ == "termios"


def _open_with(link: SerialLink, timeout_s: float, data_bits: int, parity: str) -> serial.Serial:
    try:
        return serial.Serial(
            link.port,
            baudrate=link.format.baud,
            bytesize=data_bits,
            parity=parity,
            stopbits=link.format.stop_bits,
            timeout=timeout_s,
            write_timeout=WRITE_TIMEOUT_S,
            exclusive=True,
        )
    except ValueError as error:  # A baud rate that the driver does not know.
        raise serial.SerialException(str(error)) from error
    except Exception as error:
        if not _is_of_termios(error):
            raise
        raise serial.SerialException(*error.args) from error


def _is_pseudo_terminal(port: str) -> bool:
    return Path(port).resolve().parent == Path("/dev/pts")


def _error_number(error: serial.SerialException) -> int | None:
    """What the system said; pyserial keeps it in the error, or in the one that it handles."""
    for one in (error, error.__context__):
        if one is not None and one.args and isinstance(one.args[0], int):
            return one.args[0]
    return None


def _why_not_open(link: SerialLink, error: serial.SerialException) -> str:
    match _error_number(error):
        case errno.ENOENT | errno.ENXIO | errno.ENODEV:
            return "is not there; is it plugged in, and is this its name?"
        case errno.ENOTTY | errno.EISDIR:
            return "is not a serial port"
        case errno.EACCES | errno.EPERM:
            return "permission denied; join the port's group, usually dialout, and log in again"
        case errno.EAGAIN | errno.EBUSY:
            return "is in use by another program; end that one first"
        case errno.EINVAL:
            return f"its driver does not do {link.format}; are baud rate and format right?"
        case _:
            return f"cannot be opened: {error}"
