"""The connection rules of an FA3 module (manual, chapters 10.2 and 10.3)."""

# Connections: two. When a third master connects, the master that was silent longest is
# disconnected.
#
# Alive check: TCP keep-alive, with its timers in holding registers 00F2H to 00F4H. A value outside
# its range acts as the nearest limit and reads back as written (assumed). A master that does not
# answer the probes is disconnected with alarm 0E30H. After that, the module rejects connections
# from this master's IP address for up to ten seconds, says the manual; here it is always ten
# seconds.
#
# Split reception: 00F5H is the longest time from the first part of a request to its last. A slower
# master is disconnected with alarm 0E40H.
#
# Remote reset (41H) closes all connections; for two seconds none is accepted.
#
# Memory: two peers, and an IP address for each failed alive check of the last ten seconds.

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mbtool.modbus.tables import Table
from mbtool.slave.device.connection_policy import Admission, ConnectionPolicy, KeepAlive, Loss, Peer

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.devices import Profile
    from mbtool.slave.device.image import RegisterImage

PLACES = 2
DISCONNECTING_NS = 10_000_000_000
RESETTING_NS = 2_000_000_000

START_INTERVAL = 0x00F2
INTERVAL = 0x00F3
COUNT = 0x00F4
SPLIT_RECEPTION = 0x00F5
TIMERS = range(START_INTERVAL, SPLIT_RECEPTION + 1)

ALARMS = {Loss.NOT_ALIVE: 0x0E30, Loss.SPLIT: 0x0E40}
LATEST_ALARM = 0x0001
"""The address of the input register RWr1, which holds the code of the latest alarm."""


class Fa3Connections(ConnectionPolicy):
    """Decides which TCP connections one module accepts, and when it closes them."""

    def __init__(
        self,
        profile: Profile,
        image: RegisterImage,
        *,
        alarm: Callable[[int], None],
        linked: Callable[[bool], None],
    ) -> None:
        """Take the functions to call.

        `alarm` is called with the code of each alarm. `linked` is called with True when the first
        master has connected, and with False when the last one has gone.
        """
        super().__init__(PLACES, math.inf)
        self._image = image
        self._alarm = alarm
        self._linked = linked
        self._ranges = {
            point.address: (point.minimum, point.maximum)
            for point in profile.points
            if point.table is Table.HOLDING_REGISTERS and point.address in TIMERS
        }
        self._alarm_names = {
            code: text
            for point in profile.points
            if point.table is Table.INPUT_REGISTERS and point.address == LATEST_ALARM
            for code, text in point.texts.items()
        }
        self._closed_until_ns: int | None = None
        self._rejected: dict[str, int] = {}
        """By IP address that may not connect at present, the time in ns when it may again."""

    @property
    def keep_alive(self) -> KeepAlive:
        return KeepAlive(self._timer(START_INTERVAL), self._timer(INTERVAL), self._timer(COUNT))

    @property
    def split_s(self) -> float:
        return self._timer(SPLIT_RECEPTION)

    @property
    def closed_until_ns(self) -> int | None:
        return self._closed_until_ns

    def admit(self, host: str, now_ns: int) -> Admission:
        if self._is_closed(now_ns) or self._rejected.get(host, now_ns) > now_ns:
            return Admission(None)
        leaves = None
        if len(self.peers) >= self.places:
            leaves = min(self.peers, key=lambda peer: peer.heard_ns)
            self.peers.remove(leaves)
            self.notes.append(
                f"a third connection, from {host}: the one from {leaves.host} is closed, which was "
                f"silent for {(now_ns - leaves.heard_ns) / 1e9:.1f} s"
            )
        peer = Peer(host, now_ns)
        self.peers.append(peer)
        if len(self.peers) == 1:
            self._linked(True)
        return Admission(peer, leaves)

    def lost(self, peer: Peer, loss: Loss, now_ns: int) -> None:
        if peer not in self.peers:
            return
        self.peers.remove(peer)
        if loss in ALARMS:
            self._alarm(ALARMS[loss])
            name = self._alarm_names.get(ALARMS[loss], "an alarm")
            rejected = f", and {peer.host} is rejected for {DISCONNECTING_NS / 1e9:.0f} s"
            self.notes.append(
                f"{name} ({ALARMS[loss]:04X}H): the connection from {peer.host} is closed"
                + (rejected if loss is Loss.NOT_ALIVE else "")
            )
        if loss is Loss.NOT_ALIVE:
            still = {host: until for host, until in self._rejected.items() if until > now_ns}
            self._rejected = {**still, peer.host: now_ns + DISCONNECTING_NS}
        if not self.peers:
            self._linked(False)

    def set_timers(self) -> None:
        """Note that a master may have changed the times in registers 00F2H-00F5H.

        These are the keep-alive times and the time in which all parts of a request must arrive; the
        shell applies them.
        """
        self.changed = True

    def reset(self, now_ns: int) -> None:
        """Close all connections; accept none for RESETTING_NS (two seconds) after `now_ns`."""
        self._closed_until_ns = now_ns + RESETTING_NS
        self._rejected.clear()
        self.notes.append(
            f"remote reset: all connections are closed, and none is taken for "
            f"{RESETTING_NS / 1e9:.0f} s"
        )
        self.changed = True

    def _is_closed(self, now_ns: int) -> bool:
        return self._closed_until_ns is not None and now_ns < self._closed_until_ns

    def _timer(self, address: int) -> int:
        (value,) = self._image.get(Table.HOLDING_REGISTERS, address)
        lowest, highest = self._ranges.get(address, (None, None))
        value = value if lowest is None else max(value, int(lowest))
        return value if highest is None else min(value, int(highest))
