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
# With strict timing (strict_timing.py), an RTU request without the silences that the standard
# demands gets no response, and any other request is executed only when t3.5 has passed after it.
#
# Adapters that echo the bytes written to them cannot be used: their echo would look like a request.
#
# Limits: at most MAX_PENDING responses, or pieces of responses (modbus/distortion.py), wait to be
# sent; while so many wait, requests get no response. If the port does not take a response within
# WRITE_TIMEOUT_S, the rest of it is dropped.

from __future__ import annotations

import threading
from collections import deque
from contextlib import closing
from typing import TYPE_CHECKING

from mbtool.core import Direction, SerialLink, UsageError
from mbtool.modbus.adu import Adu
from mbtool.modbus.distortion import wire_pieces
from mbtool.ports.arrival_times import SerialArrivals
from mbtool.ports.clock import steady_clock
from mbtool.ports.serial_opening import WriteTimeout, open_port, port_in_use
from mbtool.serial_line.ascii import AsciiSplitter
from mbtool.serial_line.bus_model import BusModel, Classification, roles_of
from mbtool.serial_line.bus_state import BusState
from mbtool.serial_line.rtu import RtuSplitter
from mbtool.slave.shells.shell import OnExchange, Shell
from mbtool.slave.shells.strict_timing import StrictTiming

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.modbus.response import Responder

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
