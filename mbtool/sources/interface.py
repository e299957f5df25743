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
from contextlib import suppress
from threading import Thread
from typing import TYPE_CHECKING, Any, Self

from mbtool.core import EventKind, InterfaceLink, LinkError, Packet, Quiet, WireEvent
from mbtool.core.here import Trouble
from mbtool.core.link_spec import MODBUS_PORT
from mbtool.sources.clock import now_ns
from mbtool.sources.inbox import Ended, Inbox
from mbtool.sources.port_filter import drop_everything, port_filter

if TYPE_CHECKING:
    from collections.abc import Sequence

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
ANY = "any"
_SETTLE_NS = 1_000_000
"""A packet may be stamped this long before it can be fetched."""
_STATISTICS_NS = 1_000_000_000

# asm-generic/socket.h and linux/if_packet.h, linux/if_ether.h; Python's socket module lacks them.
_ETH_P_ALL = 3
_SO_ATTACH_FILTER = 26
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SOL_PACKET = 263
_PACKET_STATISTICS = 6
_PACKET_AUXDATA = 8


class InterfaceSource:
    """Listens to an interface while its context is open. Entering raises LinkError."""

    def __init__(
        self, link: InterfaceLink, inbox: Inbox, *, ports: Sequence[int] = (MODBUS_PORT,)
    ) -> None:
        self._link = link
        self._inbox = inbox
        self._ports = ports
        self._capture: Any = None
        self._link_type: int | None = None
        """None where each packet has its own."""
        self._told: set[int] = set()
        """The hardware types that were said to be unreadable."""
        self._alarm: tuple[int, int] | None = None
        self._thread: Thread | None = None

    @property
    def link(self) -> str:
        return self._link.name

    @property
    def place(self) -> str:
        return str(self._link)

    def __enter__(self) -> Self:
        self._capture = _open(self._link)
        try:
            is_loopback: bool | None = None
            if self._link.interface != ANY:
                hardware = self._capture.ins.getsockname()[3]
                unreadable = hardware_trouble(hardware)
                if unreadable is not None:
                    raise LinkError(f"{self._link}: {unreadable}")
                self._link_type = _LINK_TYPES[hardware]
                is_loopback = hardware == _ARPHRD_LOOPBACK
            _prepare(self._capture.ins, port_filter(self._ports, is_loopback=is_loopback))
        except Exception:
            self._capture.close()
            raise
        self._alarm = os.pipe()
        self._thread = Thread(target=self._run, name=f"capture {self.link}", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the capture; what the kernel has by then is in the inbox, then Ended."""
        if self._alarm is None or self._thread is None:
            return
        told, tell = self._alarm
        self._alarm = None
        os.close(tell)
        self._thread.join()
        os.close(told)
        self._capture.close()

    def _run(self) -> None:
        assert self._alarm is not None
        told, error = self._alarm[0], None
        statistics_ns = now_ns()
        is_running = True
        try:
            while is_running:
                ready, _, _ = select.select([self._capture.ins, told], [], [], _TICK_S)
                is_running = told not in ready
                asked_ns = now_ns()
                more = self._fetch()
                for _ in range(0 if is_running else _LAST_FETCHES):
                    more = more and self._fetch()
                if not ready:
                    self._inbox.put(Quiet(asked_ns - _SETTLE_NS, self.link))
                if not is_running or asked_ns - statistics_ns > _STATISTICS_NS:
                    statistics_ns = asked_ns
                    self._report_drops(asked_ns)
        except OSError as os_error:
            error = LinkError(f"{self._link}: capture ended: {os_error.strerror}; is it still up?")
        finally:
            self._inbox.put(Ended(self.link, error))

    def _fetch(self) -> bool:
        """Take what waits; the answer is whether there may be more."""
        with suppress(BlockingIOError):
            for _ in range(_FETCH):
                # recv_raw, but with what kind of interface heard the packet.
                data, heard_by, seconds = self._capture._recv_raw(self._capture.ins, _MAX_PACKET)
                link_type = self._link_type
                if link_type is None:
                    link_type = _LINK_TYPES.get(heard_by[3])
                    if link_type is None:
                        self._tell_unreadable(heard_by[0], heard_by[3], round(seconds * 1e9))
                        continue
                self._inbox.put(
                    Packet(
                        ts_ns=round(seconds * 1e9),
                        link=self.link,
                        link_type=link_type,
                        data=data,
                        original_length=len(data),
                    )
                )
            return True
        return False

    def _report_drops(self, ts_ns: int) -> None:
        raw = self._capture.ins.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
        _, drops = struct.unpack("=II", raw)
        if drops:
            self._inbox.put(
                WireEvent(
                    ts_ns=ts_ns,
                    link=self.link,
                    kind=EventKind.DISCARDED,
                    message=f"capture fell behind: the kernel dropped {drops} packets",
                    missing=drops,
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


def _open(link: InterfaceLink) -> Any:
    interfaces = [name for _, name in socket.if_nameindex()]
    is_any = link.interface == ANY
    if sys.platform == "linux" and not is_any and link.interface not in interfaces:
        raise LinkError(f"{link}: no such interface; here are: {', '.join(interfaces)}")
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
            return L2ListenSocket(iface=link.interface)
        # scapy binds its socket to an interface; one that is bound to none hears all of them.
        capture = L2ListenSocket(iface="lo" if "lo" in interfaces else interfaces[0], promisc=False)
        capture.ins.close()
        capture.ins = _hearing_all()
        return capture
    except OSError as error:
        why = "is it up?" if error.errno == errno.ENETDOWN else error.strerror
        raise LinkError(f"{link}: cannot listen: {why}") from error


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
