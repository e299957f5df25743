"""A network interface as a live source: whole packets, as the kernel saw them."""

# scapy opens the listening socket, makes the interface promiscuous, and puts a VLAN tag that the
# kernel has taken off back into the packet; it dissects nothing. The filter is this package's own
# (port_filter.py), so neither libpcap nor tcpdump is needed. Linux only.
#
# The time of a packet is the kernel's. scapy hands it on as a float, true to a quarter of a
# microsecond. In the first moments of a capture it can be some 30 us late (seen on the loopback).
# The kernel keeps packets until the thread here fetches them: 32 MiB where the process has the
# privilege, else net.core.rmem_max. What does not fit the kernel counts; the count is read every
# second and at the end, and an event says it. What passed the filter between two readings is either
# handed over or in that count, so the sum is exact.
#
# net:any is the same socket bound to no interface. What an interface is shows with each packet;
# packets of kinds that cannot be read are left out, with one event for each kind. None of the
# interfaces is made promiscuous.
#
# net:A,B has a socket for each, and gives their packets in the order of their times: each holds
# back, at most _FETCH packets, what another may yet precede. Where the clock was set back, what it
# stamped before is let go as it is.
#
# scapy takes a tenth of a second to import, so only a capture that starts imports it.

from __future__ import annotations

import ctypes
import errno
import logging
import os
import select
import socket
import struct
import sys
import warnings
from bisect import bisect_right
from contextlib import suppress
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from mbtool.core import EventKind, InterfaceLink, LinkError, Packet, Quiet, WireEvent
from mbtool.core.link_spec import ANY_INTERFACE, MODBUS_PORT
from mbtool.core.local_ports import Trouble
from mbtool.ports.clock import now_ns
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.port_filter import drop_everything, port_filter
from mbtool.sources.source import LiveSource

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

# LINKTYPE_ (tcpdump.org/linktypes.html) by the kernel's ARPHRD_ (linux/if_arp.h): Ethernet,
# loopback; tunnels and PPP, whose packets begin with the IP header.
_ARPHRD_LOOPBACK = 772
_LINK_TYPES = {1: 1, _ARPHRD_LOOPBACK: 1, 65534: 101, 512: 101, 768: 101, 769: 101, 776: 101}

_MAX_PACKET = 2**17
"""More than a segment that the kernel has not yet cut (65535 bytes and headers)."""
_BUFFER = 32 * 2**20
_FETCH = 1000
"""Packets taken before the loop looks at the clock again, however many are waiting."""
_LAST_FETCHES = 100
"""How often the last packets are asked for when the capture ends."""
_TICK_S = 0.1
_SOON_S = 0.002
"""As long as it takes until what is held back is let go."""
_SETTLE_NS = 1_000_000
"""A packet may be stamped this long before it can be fetched."""
_AHEAD_NS = 1_000_000_000
"""A packet stamped so far ahead was stamped before the clock was set back."""
_STATISTICS_NS = 1_000_000_000

# asm-generic/socket.h and linux/if_packet.h, linux/if_ether.h; Python's socket module lacks them.
_ETH_P_ALL = 3
_SO_ATTACH_FILTER = 26
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SOL_PACKET = 263
_PACKET_STATISTICS = 6
_PACKET_AUXDATA = 8


@dataclass(slots=True)
class _Ear:
    """An interface that is listened to."""

    name: str
    capture: Any
    link_type: int | None = None
    """None where each packet has its own."""
    held: list[Packet] = field(default_factory=list)
    """What packets of other interfaces may precede, in the order of their times."""

    def release(self, horizon_ns: int | None = None) -> list[Packet]:
        """Take what was held up to a time."""
        count = len(self.held)
        if horizon_ns is not None:
            count = bisect_right(self.held, horizon_ns, key=attrgetter("ts_ns"))
        released, self.held = self.held[:count], self.held[count:]
        return released


class InterfaceSource(LiveSource[InterfaceLink]):
    """Listens to interfaces while its context is open. Entering raises LinkError."""

    _inbox: Inbox

    def __init__(
        self, link: InterfaceLink, inbox: Inbox, *, ports: Sequence[int] = (MODBUS_PORT,)
    ) -> None:
        super().__init__(link, inbox)
        self._ports = ports
        self._ears: list[_Ear] = []
        self._told: set[int] = set()
        """The hardware types that were said to be unreadable."""
        self._alarm: tuple[int, int] | None = None
        """Both ends of a pipe; closing the second end wakes the thread, which then ends."""

    def open(self) -> None:
        try:
            for name in self._link.interfaces:
                capture = _open(self._link, name)
                self._ears.append(_Ear(name, capture))
                self._ears[-1].link_type = self._prepare(name, capture.ins)
        except Exception:
            self._close_ears()
            raise
        self._alarm = os.pipe()
        self._start_thread(self._run)

    def close(self) -> None:
        if self._alarm is None or self._thread is None:
            return
        told, tell = self._alarm
        self._alarm = None
        os.close(tell)
        self._thread.join()
        os.close(told)
        self._close_ears()

    def _close_ears(self) -> None:
        for ear in self._ears:
            ear.capture.close()

    def _prepare(self, name: str, listener: socket.socket) -> int | None:
        """Let in what is wanted. Gives the type of the packets, None where each has its own."""
        if name == ANY_INTERFACE:
            _prepare(listener, port_filter(self._ports, is_loopback=None))
            return None
        hardware = listener.getsockname()[3]
        unreadable = hardware_trouble(hardware)
        if unreadable is not None:
            raise LinkError(f"{_called(self._link, name)}: {unreadable}")
        _prepare(listener, port_filter(self._ports, is_loopback=hardware == _ARPHRD_LOOPBACK))
        return _LINK_TYPES[hardware]

    def _run(self) -> None:
        assert self._alarm is not None
        told, error = self._alarm[0], None
        waited_for = [told, *(ear.capture.ins for ear in self._ears)]
        statistics_ns = now_ns()
        is_running = True
        try:
            while is_running:
                held = any(ear.held for ear in self._ears)
                ready, _, _ = select.select(waited_for, [], [], _SOON_S if held else _TICK_S)
                is_running = told not in ready
                asked_ns = now_ns()
                with self._inbox.first():
                    more = self._fetch()
                    for _ in range(0 if is_running else _LAST_FETCHES):
                        more = more and self._fetch()
                if not ready and not any(ear.held for ear in self._ears):
                    self._inbox.put(Quiet(asked_ns - _SETTLE_NS, self.link))
                if not is_running or asked_ns - statistics_ns > _STATISTICS_NS:
                    statistics_ns = asked_ns
                    self._report_drops(asked_ns)
        except OSError as os_error:
            error = LinkError(f"{self._link}: capture ended: {os_error.strerror}; is it still up?")
        finally:
            self._release()
            self._inbox.put(Ended(self.link, error))

    def _fetch(self) -> bool:
        """Take what waits; the answer is whether there may be more."""
        if len(self._ears) == 1:
            (ear,) = self._ears
            packets, more = self._receive(ear)
            self._put(packets)
            return more
        asked_ns = now_ns()
        horizon_ns = asked_ns - _SETTLE_NS
        more = False
        for ear in self._ears:
            may_have_more = bool(ear.held)
            if not ear.held:
                ear.held, may_have_more = self._receive(ear)
            if may_have_more and ear.held:
                more = True
                horizon_ns = min(horizon_ns, ear.held[-1].ts_ns)
        if any(ear.held and ear.held[0].ts_ns > asked_ns + _AHEAD_NS for ear in self._ears):
            self._put(held for ear in self._ears for held in ear.release())
        else:
            self._release(horizon_ns)
        return more

    def _release(self, horizon_ns: int | None = None) -> None:
        released = (held for ear in self._ears for held in ear.release(horizon_ns))
        self._put(sorted(released, key=attrgetter("ts_ns")))

    def _put(self, packets: Iterable[Packet]) -> None:
        for packet in packets:
            self._inbox.put(packet)

    def _receive(self, ear: _Ear) -> tuple[list[Packet], bool]:
        """At most _FETCH packets that wait in the kernel, and whether there may be more."""
        packets: list[Packet] = []
        with suppress(BlockingIOError):
            for _ in range(_FETCH):
                link_type = ear.link_type
                if link_type is not None:
                    _, data, seconds = ear.capture.recv_raw(_MAX_PACKET)
                else:
                    # recv_raw does not tell which interface heard the packet, and of what kind it
                    # is; what it calls does, and scapy has no public name for that.
                    data, heard_by, seconds = ear.capture._recv_raw(ear.capture.ins, _MAX_PACKET)
                    link_type = _LINK_TYPES.get(heard_by[3])
                    if link_type is None:
                        self._tell_unreadable(heard_by[0], heard_by[3], round(seconds * 1e9))
                        continue
                packets.append(
                    Packet(
                        ts_ns=round(seconds * 1e9),
                        link=self.link,
                        link_type=link_type,
                        data=data,
                        original_length=len(data),
                    )
                )
            return packets, True
        return packets, False

    def _report_drops(self, ts_ns: int) -> None:
        for ear in self._ears:
            raw = ear.capture.ins.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
            _, drops = struct.unpack("=II", raw)
            if drops:
                where = f" of {ear.name}" if len(self._ears) > 1 else ""
                self._inbox.put(
                    WireEvent(
                        ts_ns=ts_ns,
                        link=self.link,
                        kind=EventKind.DISCARDED,
                        message=f"capture fell behind: the kernel dropped {drops} packets{where}",
                        packets=drops,
                    )
                )

    def _tell_unreadable(self, interface: str, hardware: int, ts_ns: int) -> None:
        if hardware in self._told:
            return
        self._told.add(hardware)
        self._inbox.put(
            WireEvent(
                ts_ns=ts_ns,
                link=self.link,
                kind=EventKind.UNREADABLE,
                message=f"{interface}: {hardware_trouble(hardware)}",
            )
        )


def capture_trouble() -> Trouble | None:
    """What keeps this process from listening to any interface."""
    if sys.platform != "linux":
        return Trouble(
            "listening to an interface needs Linux; decode a file of Wireshark's, "
            "or use tap:LISTEN=TARGET"
        )
    # A socket that is bound to nothing: it hears nothing, and asks the kernel what it permits.
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0).close()
    except PermissionError:
        return Trouble(
            "listening needs the capability cap_net_raw",
            f"sudo {_program()}; or give raw sockets to every Python program: "
            f"sudo setcap cap_net_raw+ep {os.path.realpath(sys.executable)}",
        )
    return None


def _program() -> str:
    """How to call this program whatever the path is: under sudo it is another."""
    script = os.path.join(os.path.dirname(sys.executable), "mbtool")
    if not os.path.exists(script):
        return f"{sys.executable} -m mbtool"
    here = os.path.relpath(script)
    return script if here.startswith(os.pardir) else here


def hardware_trouble(hardware: int) -> Trouble | None:
    """Whether the packets of a hardware type, ARPHRD_ of linux/if_arp.h, can be read."""
    if hardware in _LINK_TYPES:
        return None
    return Trouble(
        f"its hardware type {hardware} is not one that can be read; "
        "Ethernet, loopback and IP tunnels are"
    )


def _open(link: InterfaceLink, name: str) -> Any:
    interfaces = [name for _, name in socket.if_nameindex()]
    is_any = name == ANY_INTERFACE
    of = _called(link, name)
    if sys.platform == "linux" and not is_any and name not in interfaces:
        raise LinkError(f"{of}: no such interface; here are: {', '.join(interfaces)}")
    # Asked before scapy is there: it would take the time to import and say less.
    trouble = capture_trouble()
    if trouble is not None:
        raise LinkError(f"{link}: {trouble}")
    logging.getLogger("scapy").setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from scapy.arch.linux import L2ListenSocket
    try:
        if not is_any:
            return L2ListenSocket(iface=name)
        # scapy binds its socket to an interface; one that is bound to none hears all of them.
        capture = L2ListenSocket(iface="lo" if "lo" in interfaces else interfaces[0], promisc=False)
        capture.ins.close()
        capture.ins = _hearing_all()
        return capture
    except OSError as error:
        why = "is it up?" if error.errno == errno.ENETDOWN else error.strerror
        raise LinkError(f"{of}: cannot listen: {why}") from error


def _called(link: InterfaceLink, name: str) -> str:
    """How a message names an interface of a link."""
    return f"{link}: {name}" if len(link.interfaces) > 1 else str(link)


def _hearing_all() -> socket.socket:
    """A socket that hears all interfaces, set up as scapy does it for one."""
    listener = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
    listener.setsockopt(_SOL_PACKET, _PACKET_AUXDATA, 1)
    listener.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return listener


def _prepare(listener: socket.socket, program: Sequence[bytes]) -> None:
    """Put the filter in place and forget what came before it."""
    _attach(listener, drop_everything())
    listener.setblocking(False)
    with suppress(BlockingIOError):
        while True:
            listener.recv(1)
    try:
        listener.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
    except PermissionError:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    listener.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)  # Reading sets it to zero.
    _attach(listener, program)


def _attach(listener: socket.socket, program: Sequence[bytes]) -> None:
    code = ctypes.create_string_buffer(b"".join(program))
    sock_fprog = struct.pack("@HP", len(program), ctypes.addressof(code))
    listener.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, sock_fprog)
