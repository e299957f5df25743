"""Simulates slaves at a UDP endpoint: Modbus/UDP, or RTU frames in datagrams."""

# A datagram has one whole request or several. Bytes of two datagrams are never joined. A response
# goes back to the sender of its request, in one datagram, or in several if a simulated fault
# splits it. Nothing is sent for bytes that are no request, for a request for which the responder
# returns None, and to a machine that may not ask.
#
# UDP has no connections, so rules and faults about connections have no effect here.
#
# Memory: the responses that wait for their time, at most MAX_WAITING; requests beyond are dropped,
# as by a full receive buffer.

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any

from mbtool.core import Direction, Endpoint, TcpLink
from mbtool.framing.mbap import MbapSplitter
from mbtool.framing.rtu_over_tcp import RtuStreamSplitter
from mbtool.modbus.adu import Adu
from mbtool.modbus.response import Responder, wire_pieces
from mbtool.ports.clock import steady_clock
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers, TcpListener
from mbtool.slave.shells.shell import OnExchange, Shell

MAX_WAITING = 4096
MAX_REFUSED_HOSTS = 64
"""At most this many refused machines are reported to the user."""


class UdpSlave(Shell):
    """Answers the requests in datagrams at one endpoint with a responder."""

    def __init__(
        self,
        link: TcpLink,
        responder: Responder,
        *,
        allowed: AllowedPeers = THIS_MACHINE,
        on_exchange: OnExchange | None = None,
    ) -> None:
        """Prepare to answer at the endpoint of `link` with the responses of `responder`."""
        super().__init__()
        self.link = link
        self._responder = responder
        self._on_exchange = on_exchange
        self._clock = steady_clock()
        self._listener = TcpListener(link, link.endpoint, allowed)
        self._refused_hosts: set[str] = set()
        self._notes: list[str] = []
        self._stopped = asyncio.Event()
        self._waiting = 0

    @property
    def endpoint(self) -> Endpoint:
        """The endpoint, with the port that the system chose if the user gave port 0."""
        return self._listener.endpoint

    @property
    def place(self) -> str:
        return str(TcpLink(self.endpoint, self.link.rtu, is_udp=True))

    def notes(self) -> list[str]:
        notes, self._notes = self._notes, []
        return notes

    def _open(self) -> None:
        self._listener.open()
        self._loop = asyncio.new_event_loop()

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._serve())
        finally:
            self._listener.close()

    def _interrupt(self) -> None:
        self._loop.call_soon_threadsafe(self._stopped.set)

    async def _serve(self) -> None:
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(
            lambda: _Datagrams(self), sock=self._listener.sock
        )
        try:
            await self._stopped.wait()
        finally:
            self._transport.close()

    def take(self, data: bytes, address: tuple[Any, ...]) -> None:
        """Answer the requests in a datagram from `address`."""
        refusal = self._listener.refusal_text(address[0])
        if refusal is not None:
            self._report_refused(address[0], refusal)
            return
        now_ns = self._clock()
        splitter: MbapSplitter | RtuStreamSplitter
        splitter = (RtuStreamSplitter if self.link.rtu else MbapSplitter)(
            Direction.REQUEST, is_udp=True
        )
        for request in splitter.feed(data, now_ns):
            if isinstance(request, Adu) and self._waiting < MAX_WAITING:
                self._answer(request, address, now_ns)

    def _answer(self, request: Adu, address: tuple[Any, ...], now_ns: int) -> None:
        answer = self._responder.respond(request.unit, request.pdu, now_ns)
        if answer is not None:
            number = request.transaction_id or 0
            pieces = wire_pieces(answer, request.transport, request.unit, number)
            for after_ns, piece in pieces:
                delay_s = (answer.delay_ns + after_ns) / 1e9
                if delay_s > 0:
                    self._waiting += 1
                    self._loop.call_later(delay_s, self._send_later, piece, address)
                else:
                    self._transport.sendto(piece, address)
        if self._on_exchange is not None:
            self._on_exchange(request, answer)

    def _send_later(self, piece: bytes, address: tuple[Any, ...]) -> None:
        self._waiting -= 1
        with suppress(RuntimeError):  # The shell was stopped meanwhile.
            self._transport.sendto(piece, address)

    def _report_refused(self, host: str, refusal: str) -> None:
        if host not in self._refused_hosts and len(self._refused_hosts) < MAX_REFUSED_HOSTS:
            self._refused_hosts.add(host)
            self._notes.append(f"a master was turned away: {refusal}")


class _Datagrams(asyncio.DatagramProtocol):
    """Gives the datagrams of a socket to its slave."""

    def __init__(self, slave: UdpSlave) -> None:
        self._slave = slave

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._slave.take(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Ignore that a response could not be delivered: its master has gone."""
