"""Plays slaves on a serial line: RTU or ASCII."""

# One thread reads, passes the bytes to the splitter, and writes the responses. A read waits for
# at most t3.5, and a read without bytes is the silence that ends an RTU frame. A response leaves at
# least t3.5 after its request's last byte (Serial Line V1.02, 2.5.1.1), or later if the slave takes
# longer. Responses leave in the order of their requests.
#
# These get no response: requests for other slaves, and those slaves' responses; frames with a wrong
# CRC or LRC; noise. No other slave answers for the units played here, so a frame for one of them is
# a request, even if it equals the response before it (functions 05 and 06).
#
# With strict timing (StrictTiming), an RTU request without the silences that the standard
# demands gets no response, and any other request is executed only when t3.5 has passed after it.
#
# Adapters that echo the bytes written to them cannot be used: their echo would look like a request.
#
# Limits: at most MAX_PENDING responses, or pieces of responses (modbus/response.py), wait to be
# sent; while that many wait, requests get no response. If the port does not take a response within
# WRITE_TIMEOUT_S, the rest of it is dropped.

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from contextlib import closing

from mbtool.core import Direction, SerialFormat, SerialLink, UsageError
from mbtool.modbus.adu import Adu, Verdict
from mbtool.modbus.response import Responder, wire_pieces
from mbtool.ports.arrival_times import SerialArrivals
from mbtool.ports.clock import steady_clock
from mbtool.ports.serial_opening import WriteTimeout, open_port, port_in_use
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.bus_model import BusModel, Classification, roles_of
from mbtool.serial_line.bus_state import BusState
from mbtool.serial_line.rtu import RtuSplitter
from mbtool.slave.shells.shell import OnExchange, Shell

# The code below decides, for a slave that demands the standard's silences, which RTU requests get a
# response.
#
# Serial Line V1.02, 2.5.1.1, and the manual of FT1A Touch, 4.1: at least 3.5 characters of silence
# come before each message and after it, and no such silence is inside. A real slave takes all bytes
# between two silences as one message. So a request gets no answer if
#
#     a silence of t3.5 or longer is inside it                 it is two messages, both incomplete
#     a shorter silence, or none, is before or after it        it is part of a longer message
#
# A silence between t1.5 and t3.5 inside a request is accepted: it may be caused by this machine
# reading the port late.
#
# Memory: one request, which waits until the line has been silent for t3.5.


class StrictTiming:
    """Holds a request back until the line was silent for t3.5 after it; drops a request if a
    silence before, inside or after it is wrong.
    """

    def __init__(self, line: SerialFormat) -> None:
        self._t3_5_ns = line.t3_5_ns
        self._character_ns = line.character_ns
        self._held: Adu | None = None

    def hear(self, size: int, now_ns: int) -> None:
        """Note a read of the port: `size` bytes, the last of which came at `now_ns`.

        Drops the waiting request if the first of these bytes came less than t3.5 after its end.
        """
        if self._held is not None:
            silence_ns = now_ns - size * self._character_ns - self._held.end_ns
            if silence_ns < self._t3_5_ns:
                self._held = None

    def hold(self, request: Adu) -> None:
        """Keep a complete request until the line was silent for t3.5 after it (`due`).

        A request is dropped at once if the silence before it is too short or one inside it too
        long.
        """
        before_ns, inside_ns = request.silence_before_ns, request.longest_silence_ns
        is_apart = before_ns is None or before_ns >= self._t3_5_ns
        is_apart &= Verdict.GLUED not in request.verdicts
        is_whole = inside_ns is None or inside_ns < self._t3_5_ns
        self._held = request if is_apart and is_whole else None

    def due(self, now_ns: int) -> Adu | None:
        """Return the waiting request once the line has been silent for t3.5 after it; else None."""
        held = self._held
        if held is None or now_ns - held.end_ns < self._t3_5_ns:
            return None
        self._held = None
        return held


MAX_PENDING = 16
"""While this many responses, or pieces of responses, wait to be sent, requests get no response."""
_NEVER = 32.0
"""Extra cost, in bits, of reading a possible request as a response; higher than any other cost."""


class SerialSlave(Shell):
    """A shell that answers requests on one serial port, in RTU or ASCII."""

    def __init__(
        self,
        link: SerialLink,
        responder: Responder,
        *,
        on_exchange: OnExchange | None = None,
        strict_timing: bool = False,
    ) -> None:
        """Prepare to answer on a serial line with the responses of `responder`.

        `on_exchange` is called with each request and its response. Raises UsageError for strict
        timing on an ASCII line.
        """
        if strict_timing and link.ascii:
            raise UsageError(f"link {link}: strict timing is for RTU lines")
        super().__init__()
        self.link = link
        self._responder = responder
        self._on_exchange = on_exchange
        self._clock = steady_clock()
        self._stopping = threading.Event()
        self._arrivals = SerialArrivals(link.format.character_ns)
        splitter = AsciiSplitter if link.ascii else RtuSplitter
        self._splitter: AsciiSplitter | RtuSplitter = splitter(link.format, _RequestsOnlyModel())
        self._pending: deque[tuple[int, bytes]] = deque()
        """Responses, or pieces of responses, each with the time in ns when it is to be sent."""
        self._strict = StrictTiming(link.format) if strict_timing else None

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
        begin_ns, waiting = self._clock(), self._port.in_waiting
        data = self._port.read(waiting or 1)
        now_ns = self._clock()
        wait_ns = 0 if waiting else self.link.format.t3_5_ns
        at_ns = self._arrivals.arrived_ns(len(data), begin_ns, wait_ns, now_ns)
        if self._strict is not None:
            self._strict.hear(len(data), now_ns)
            at_ns = now_ns
        events = self._splitter.feed(data, at_ns) if data else self._splitter.advance(at_ns)
        for event in events:
            if isinstance(event, Adu) and event.direction is Direction.REQUEST:
                if self._strict is None:
                    self._take(event, now_ns)
                else:
                    self._strict.hold(event)
        due = None if self._strict is None else self._strict.due(now_ns)
        if due is not None:
            self._take(due, now_ns)

    def _take(self, request: Adu, now_ns: int) -> None:
        if len(self._pending) >= MAX_PENDING:
            return
        answer = self._responder.respond(request.unit, request.pdu, now_ns)
        if answer is not None:
            due_ns = request.end_ns + max(answer.delay_ns, self.link.format.t3_5_ns)
            for later_ns, data in wire_pieces(answer, request.transport, request.unit):
                self._pending.append((due_ns + later_ns, data))
        if self._on_exchange is not None:
            self._on_exchange(request, answer)

    def _send_due(self) -> None:
        """Send the responses that are due within the next t3.5; wait for the time of each.

        A response that is due later is left for a later call, after the port was read again.
        """
        while self._pending:
            due_ns, data = self._pending[0]
            rest_ns = due_ns - self._clock()
            if rest_ns > self.link.format.t3_5_ns or self._stopping.wait(max(rest_ns, 0) / 1e9):
                return
            self._pending.popleft()
            try:
                self._port.write(data)
            except WriteTimeout:  # Drop the rest: half a response is of no use.
                self._port.reset_output_buffer()


class _RequestsOnlyModel(BusModel):
    """Reads each frame that can be a request as a request, whatever frames came before it.

    A frame for a unit played here is always a request, as no other slave responds for this unit. A
    frame for another unit gets no response here, so it does not matter how it is read.
    """

    holds_first_frame = False

    def classify(
        self, unit: int, pdu: bytes, at_ns: int, roles: Sequence[Direction] = ()
    ) -> Classification:
        return super().classify(unit, pdu, at_ns, _one_role(roles or roles_of(pdu)))

    def cost(self, state: BusState, unit: int, pdu: bytes, role: Direction, at_ns: int) -> float:
        is_none = role not in _one_role(roles_of(pdu))
        return super().cost(state, unit, pdu, role, at_ns) + (_NEVER if is_none else 0.0)

    def next_state(self, *_: object, **__: object) -> BusState:
        return BusState()


def _one_role(roles: Sequence[Direction]) -> Sequence[Direction]:
    return [Direction.REQUEST] if Direction.REQUEST in roles else roles
