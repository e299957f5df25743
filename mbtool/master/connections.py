"""A master with several TCP connections to one slave, opened and ended when its caller says."""

# Each connection is a TcpMaster. A request on a connection that the slave has ended, or that was
# refused, opens it again, as TcpMaster does.
#
# Memory: a TcpMaster for each connection that the caller has opened and not ended.

from __future__ import annotations

import select
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mbtool.core import LinkError, TcpLink
from mbtool.core.limits import LinkLimits
from mbtool.core.moments import SECOND_NS
from mbtool.master.links import LONGEST_WAIT_S, RECONNECT_S, MasterLink, ReceivedResponse, TcpMaster
from mbtool.modbus.adu import Transport

if TYPE_CHECKING:
    from mbtool.modbus.response import ConnectionEnding


class ConnectionsMaster(MasterLink):
    """Sends requests on numbered connections."""

    def __init__(self, link: TcpLink, timeout_ns: int, on_remark: Callable[[str], None]) -> None:
        """Prepare to connect to `link`; no connection is opened before `open` or `send`."""
        super().__init__()
        self.transport = Transport.at_endpoint(is_rtu=link.rtu, is_udp=False)
        self.limits = LinkLimits(timeout_ns=timeout_ns, one_at_a_time=link.rtu)
        self._link = link
        self._timeout_ns = timeout_ns
        self._on_remark = on_remark
        self._masters: dict[int, TcpMaster] = {}
        self._number = 0
        self._lost: list[int] = []

    def open(self, number: int, *, must_open: bool = False) -> bool:
        """Open the connection `number`; return False if the slave refuses it or does not answer.

        With `must_open`, LinkError is raised instead.
        """
        self._drop(number)
        try:
            self._masters[number] = TcpMaster(
                self._link, self._timeout_ns, self._on_remark, connect_s=RECONNECT_S
            )
        except LinkError:
            if must_open:
                raise
            return False
        return True

    def end(self, number: int, ending: ConnectionEnding) -> None:
        """End the connection `number`; a second call does nothing."""
        master = self._masters.get(number)
        if master is not None:
            master.end(ending)
            self._drop(number)

    def ended(self, number: int) -> ConnectionEnding | None:
        """Return the way in which the slave ended connection `number`; None if it did not."""
        master = self._masters.get(number)
        return None if master is None else master.ended

    def is_open(self, number: int) -> bool:
        master = self._masters.get(number)
        return master is not None and master.socket is not None

    def use(self, number: int) -> None:
        """Choose the connection of the next call of `send`."""
        self._number = number

    def send(self, number: int, unit: int, pdu: bytes) -> None:
        master = self._masters.get(self._number)
        if master is None and not self.open(self._number):
            self._lost.append(number)
            return
        self._masters[self._number].send(number, unit, pdu)

    def receive(self, timeout_ns: int) -> Sequence[ReceivedResponse]:
        wait_s = min(max(timeout_ns / SECOND_NS, 0.0), LONGEST_WAIT_S)
        sockets = {one.socket: one for one in self._masters.values() if one.socket is not None}
        if not sockets:
            time.sleep(wait_s)
            return ()
        ready, _, _ = select.select(list(sockets), [], [], wait_s)
        return [answer for each in ready for answer in sockets[each].receive(0)]

    def lost(self) -> Sequence[int]:
        numbers = [*self._lost, *(one for each in self._masters.values() for one in each.lost())]
        self._lost.clear()
        return numbers

    def close(self) -> None:
        for number in list(self._masters):
            self._drop(number)

    def _drop(self, number: int) -> None:
        master = self._masters.pop(number, None)
        if master is not None:
            self._lost += master.lost()
            master.close()
