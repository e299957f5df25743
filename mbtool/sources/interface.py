"""A network interface as a live source: whole packets, as the kernel saw them."""

# scapy opens the listening socket, makes the interface promiscuous, and puts a VLAN tag that the
# kernel has removed back into the packet; it decodes nothing. `port_filter` makes the filter,
# so neither libpcap nor tcpdump is needed. Linux only.
#
# The kernel notes the time of a packet by the system's clock, which somebody may set during a
# capture. So the difference between that clock and `now_ns`, which never steps, is measured before
# each fetch and subtracted from the packets' times. scapy returns the time as a float, exact to
# 0.25 us. At the beginning of a capture it can be some 30 us late (seen on the loopback). The
# kernel buffers packets until the thread here fetches them: 32 MiB if the process has the
# privilege, else net.core.rmem_max. The kernel counts packets that do not fit. The count is read
# every second and at the end, and reported as an event. Each packet that passed the filter is
# either fetched or counted, so the sum is exact.
#
# The link net:any uses the same kind of socket, bound to no interface. With each packet comes the
# hardware type of the interface that received it; packets of types that cannot be read are left
# out, with one event for each type. No interface is made promiscuous.
#
# The link net:A,B uses a socket for each interface, and merges their packets in the order of their
# times: a packet is held back while another interface may still deliver an earlier one, but at most
# _FETCH packets of each interface. If the system's clock was set back, packets with time stamps
# from before that are not held back.
#
# scapy takes 0.1 s to import, so it is imported only when a capture starts.

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
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from mbtool.core import EventKind, InterfaceLink, LinkError, Packet, Quiet, UsageError, WireEvent
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.link_spec import ANY_INTERFACE
from mbtool.core.local_ports import PortTrouble
from mbtool.packets.segment import BEFORE_TCP, TCP, UDP
from mbtool.packets.tunnels import ERSPAN, GRE
from mbtool.ports.clock import ClockWatch, now_ns
from mbtool.sources.inbox import Ended, PatientSink
from mbtool.sources.source import LiveSource

# The kernel filter that lets only Modbus traffic into a capture: classic BPF, assembled here.
#
# scapy compiles filters with libpcap, which may not be installed. mbtool needs only one BPF
# program, so it is assembled here. The program reads the packet from the network header on
# (SKF_NET_OFF) and asks the kernel for the protocol, so it works for every link type, and for
# packets whose VLAN tag the kernel has removed.
#
# The filter keeps all packets that could belong to a Modbus connection:
#   TCP and UDP over IPv4 or IPv6 from or to one of the ports; on all ports if none is named
#   IPv4 fragments of TCP, since only the first one has the ports
#   IPv6 with an extension header before TCP, or instead of it
#   packets with a second VLAN tag (802.1ad), with a tag that the kernel does not remove (9100H), or
#   with the tag of HSR
#   ERSPAN over IPv4: packets that a switch mirrors to this machine over a network
# Packets in other tunnels, PPPoE and MPLS are dropped, as the filter could not tell which of them
# carry Modbus. mbtool reads such packets only from capture files.
#
# The loopback shows every packet twice, as sent and as received; the sent one is dropped. In a
# capture of all interfaces the filter checks for each packet if it comes from the loopback.
#
# The user can name at most 100 ports, as a conditional jump reaches only 255 instructions ahead.

MAX_PORTS = 100

# Instruction codes and special offsets of linux/bpf_common.h and linux/filter.h
_LD_WORD, _LD_HALF, _LD_BYTE = 0x20, 0x28, 0x30
_LD_HALF_X = 0x48
_LDX_IMMEDIATE, _LDX_HEADER_LENGTH = 0x01, 0xB1
_JUMP, _JUMP_EQUAL, _JUMP_ANY_BIT = 0x05, 0x15, 0x45
_RETURN = 0x06
_NET = -0x100000
_PROTOCOL, _PACKET_TYPE, _HARDWARE = -0x1000, -0x1000 + 4, -0x1000 + 28

_PACKET_OUTGOING = 4
_ARPHRD_LOOPBACK = 772
_ETHERTYPE_IPV4, _ETHERTYPE_IPV6 = 0x0800, 0x86DD
_ETHERTYPE_TAGS = (0x8100, 0x88A8, 0x9100, 0x892F)
_MORE_FRAGMENTS_OR_OFFSET = 0x3FFF
_WHOLE_PACKET = 0x40000


@dataclass(frozen=True, slots=True)
class Instruction:
    """One instruction of a BPF program: its code and its operand `k`.

    A conditional jump goes to the label `then` if its condition is true, else to `otherwise`. The
    label "" means the next instruction.
    """

    code: int
    k: int = 0
    then: str = ""
    otherwise: str = ""


def port_filter(ports: Sequence[int], *, is_loopback: bool | None) -> list[bytes]:
    """Assemble the filter that keeps the packets of some ports of TCP and UDP, or of all ports if
    `ports` is empty.

    Returns each instruction as the kernel's struct sock_filter. `is_loopback` is True if the filter
    is for the loopback interface, None if it is for a capture of all interfaces. Raises UsageError
    for more than MAX_PORTS ports.
    """
    if len(ports) > MAX_PORTS:
        raise UsageError(f"at most {MAX_PORTS} ports can be named, not {len(ports)}")
    lines: list[Instruction | str] = [
        *_rules_against_copies(is_loopback),
        "wanted",
        Instruction(_LD_WORD, _PROTOCOL),
        *(Instruction(_JUMP_EQUAL, tag, "keep") for tag in _ETHERTYPE_TAGS),
        Instruction(_JUMP_EQUAL, _ETHERTYPE_IPV4, "ipv4"),
        Instruction(_JUMP_EQUAL, _ETHERTYPE_IPV6, "ipv6", "drop"),
        "ipv4",
        Instruction(_LD_BYTE, _NET + 9),
        Instruction(_JUMP_EQUAL, GRE, "gre"),
        Instruction(_JUMP_EQUAL, UDP, "udp"),
        Instruction(_JUMP_EQUAL, TCP, "", "drop"),
        Instruction(_LD_HALF, _NET + 6),
        Instruction(_JUMP_ANY_BIT, _MORE_FRAGMENTS_OR_OFFSET, "keep", "whole"),
        "udp",
        Instruction(_LD_HALF, _NET + 6),
        Instruction(_JUMP_ANY_BIT, _MORE_FRAGMENTS_OR_OFFSET, "drop"),
        "whole",
        Instruction(_LDX_HEADER_LENGTH, _NET),
        Instruction(_JUMP, then="ports"),
        "ipv6",
        Instruction(_LD_BYTE, _NET + 6),
        *(Instruction(_JUMP_EQUAL, header, "keep") for header in sorted(BEFORE_TCP)),
        Instruction(_JUMP_EQUAL, UDP, "six"),
        Instruction(_JUMP_EQUAL, TCP, "", "drop"),
        "six",
        Instruction(_LDX_IMMEDIATE, 40),
        "ports",
        *_rules_for_ports(ports),
        Instruction(_JUMP, then="drop" if ports else "keep"),
        "gre",
        Instruction(_LDX_HEADER_LENGTH, _NET),
        Instruction(_LD_HALF_X, _NET + 2),
        *(Instruction(_JUMP_EQUAL, protocol, "keep") for protocol in ERSPAN),
        "drop",
        Instruction(_RETURN, 0),
        "keep",
        Instruction(_RETURN, _WHOLE_PACKET),
    ]
    return _assemble(lines)


def _rules_against_copies(is_loopback: bool | None) -> Iterator[Instruction]:
    if is_loopback is None:
        yield Instruction(_LD_WORD, _HARDWARE)
        yield Instruction(_JUMP_EQUAL, _ARPHRD_LOOPBACK, "", "wanted")
    if is_loopback is not False:
        yield Instruction(_LD_WORD, _PACKET_TYPE)
        yield Instruction(_JUMP_EQUAL, _PACKET_OUTGOING, "drop")


def _rules_for_ports(ports: Sequence[int]) -> Iterator[Instruction]:
    for side in (0, 2) if ports else ():
        yield Instruction(_LD_HALF_X, _NET + side)
        for port in ports:
            yield Instruction(_JUMP_EQUAL, port, "keep")


def drop_everything() -> list[bytes]:
    """Return a filter that drops every packet. It is set while a capture is being set up."""
    return _assemble([Instruction(_RETURN, 0)])


def _assemble(lines: Sequence[Instruction | str]) -> list[bytes]:
    places: dict[str, int] = {}
    program: list[Instruction] = []
    for line in lines:
        if isinstance(line, str):
            places[line] = len(program)
        else:
            program.append(line)
    assembled = []
    for place, line in enumerate(program):
        then, otherwise = (
            places[label] - place - 1 if label else 0 for label in (line.then, line.otherwise)
        )
        if line.code == _JUMP:
            assembled.append(_encode(line.code, 0, 0, then))
        else:
            assembled.append(_encode(line.code, then, otherwise, line.k))
    return assembled


def _encode(code: int, jump_true: int, jump_false: int, k: int) -> bytes:
    return struct.pack("=HBBI", code, jump_true, jump_false, k & 0xFFFFFFFF)


# The link type (LINKTYPE_ of tcpdump.org/linktypes.html) for each hardware type (the kernel's
# ARPHRD_ of linux/if_arp.h). Ethernet and loopback have link type 1; tunnels and PPP, whose packets
# begin with the IP header, have 101.
_LINK_TYPES = {
    1: 1,
    _ARPHRD_LOOPBACK: 1,
    65534: 101,
    512: 101,
    768: 101,
    769: 101,
    776: 101,
}

_MAX_PACKET = 2**17
"""The most bytes that are read of a packet. Even a TCP segment that the card has yet to split to
the MTU has only 64 KiB."""
_BUFFER = 32 * 2**20
"""Size in bytes of the kernel's buffer for one interface. Without the privilege CAP_NET_ADMIN the
kernel limits it to net.core.rmem_max."""
_FETCH = 1000
"""The most packets of one interface that are fetched before the loop reads the clock again."""
_LAST_FETCHES = 100
"""At the end of a capture, the packets that still wait in the kernel are fetched in at most this
many rounds of up to _FETCH packets."""
_TICK_S = 0.1
_SOON_S = 0.002
"""The longest wait for packets, in seconds, while fetched packets of an interface are held back."""
_SETTLE_NS = 1_000_000
"""The longest time in ns between a packet's time stamp and the moment at which it can be
fetched."""
_AHEAD_NS = 1_000_000_000
"""If a packet's time stamp is more than this many ns ahead of `now_ns`, the system's clock was set
back after the kernel noted the time stamp."""
_STATISTICS_NS = 1_000_000_000

# Constants of linux/if_ether.h, asm-generic/socket.h and linux/if_packet.h that Python's socket
# module lacks.
_ETH_P_ALL = 3
_SO_ATTACH_FILTER = 26
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SOL_PACKET = 263
_PACKET_STATISTICS = 6
_PACKET_AUXDATA = 8


@dataclass(slots=True)
class _Capture:
    """One network interface that is being captured."""

    name: str
    socket: Any
    """scapy's listening socket."""
    link_type: int | None = None
    """The link type of all packets (LINKTYPE_); None for net:any, where each packet has its own."""
    held: list[Packet] = field(default_factory=list)
    """Packets that are held back, as another interface may still deliver earlier ones; in the order
    of their times."""

    def release(self, horizon_ns: int | None = None) -> list[Packet]:
        """Remove packets from `held` and return them: those up to the time `horizon_ns` (UTC ns).

        None means all packets.
        """
        count = len(self.held)
        if horizon_ns is not None:
            count = bisect_right(self.held, horizon_ns, key=attrgetter("ts_ns"))
        released, self.held = self.held[:count], self.held[count:]
        return released


class InterfaceSource(LiveSource[InterfaceLink]):
    """Captures packets of one or several network interfaces while its context is open.

    Entering the context raises LinkError if an interface cannot be captured.
    """

    _inbox: PatientSink

    def __init__(
        self, link: InterfaceLink, inbox: PatientSink, *, ports: Sequence[int] = (MODBUS_PORT,)
    ) -> None:
        super().__init__(link, inbox)
        self._ports = ports
        self._captures: list[_Capture] = []
        self._clocks = ClockWatch()
        self._told: set[int] = set()
        """The hardware types (ARPHRD_) that were already reported as unreadable."""
        self._alarm: tuple[int, int] | None = None
        """The read end and the write end of a pipe. Closing the write end wakes the thread, which
        then ends."""

    def open(self) -> None:
        try:
            for name in self._link.interfaces:
                socket_ = _open(self._link, name)
                self._captures.append(_Capture(name, socket_))
                self._captures[-1].link_type = self._prepare(name, socket_.ins)
        except Exception:
            self._close_captures()
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
        self._close_captures()

    def _close_captures(self) -> None:
        for each in self._captures:
            each.socket.close()

    def _prepare(self, name: str, listener: socket.socket) -> int | None:
        """Set the kernel's packet filter for the interface `name`; `listener` is its socket.

        Returns the link type (LINKTYPE_) of the interface's packets; None for net:any, where each
        packet has its own. Raises LinkError if packets of this interface cannot be read.
        """
        if name == ANY_INTERFACE:
            _prepare(listener, port_filter(self._ports, is_loopback=None))
            return None
        hardware = listener.getsockname()[3]
        unreadable = hardware_trouble(hardware)
        if unreadable is not None:
            raise LinkError(f"{_link_text(self._link, name)}: {unreadable}")
        _prepare(listener, port_filter(self._ports, is_loopback=hardware == _ARPHRD_LOOPBACK))
        return _LINK_TYPES[hardware]

    def _run(self) -> None:
        assert self._alarm is not None
        told, error = self._alarm[0], None
        waited_for = [told, *(each.socket.ins for each in self._captures)]
        statistics_ns = now_ns()
        is_running = True
        try:
            while is_running:
                held = any(each.held for each in self._captures)
                ready, _, _ = select.select(waited_for, [], [], _SOON_S if held else _TICK_S)
                is_running = told not in ready
                asked_ns = now_ns()
                with self._inbox.fetching_first():
                    self._clocks.look()
                    more = self._fetch()
                    for _ in range(0 if is_running else _LAST_FETCHES):
                        more = more and self._fetch()
                if not ready and not any(each.held for each in self._captures):
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
        """Fetch packets of all interfaces from the kernel; return True if it may have more.

        Packets that no other interface can precede go into the inbox; the others are held back.
        """
        if len(self._captures) == 1:
            (capture,) = self._captures
            packets, more = self._receive(capture)
            self._put(packets)
            return more
        asked_ns = now_ns()
        horizon_ns = asked_ns - _SETTLE_NS
        more = False
        for each in self._captures:
            may_have_more = bool(each.held)
            if not each.held:
                each.held, may_have_more = self._receive(each)
            if may_have_more and each.held:
                more = True
                horizon_ns = min(horizon_ns, each.held[-1].ts_ns)
        if any(each.held and each.held[0].ts_ns > asked_ns + _AHEAD_NS for each in self._captures):
            self._put(held for each in self._captures for held in each.release())
        else:
            self._release(horizon_ns)
        return more

    def _release(self, horizon_ns: int | None = None) -> None:
        released = (held for each in self._captures for held in each.release(horizon_ns))
        self._put(sorted(released, key=attrgetter("ts_ns")))

    def _put(self, packets: Iterable[Packet]) -> None:
        for packet in packets:
            self._inbox.put(packet)

    def _receive(self, capture: _Capture) -> tuple[list[Packet], bool]:
        """Fetch at most _FETCH packets of an interface from the kernel, and return them.

        The second value is True if the kernel may have more.
        """
        packets: list[Packet] = []
        asked_ns, from_system = now_ns(), self._clocks.from_system
        with suppress(BlockingIOError):
            for _ in range(_FETCH):
                link_type = capture.link_type
                if link_type is not None:
                    _, data, seconds = capture.socket.recv_raw(_MAX_PACKET)
                else:
                    # recv_raw does not return the interface that received the packet, nor its
                    # hardware type. _recv_raw does; it is a private method, but scapy offers no
                    # other way.
                    data, heard_by, seconds = capture.socket._recv_raw(
                        capture.socket.ins, _MAX_PACKET
                    )
                    link_type = _LINK_TYPES.get(heard_by[3])
                    if link_type is None:
                        self._report_unreadable(heard_by[0], heard_by[3], asked_ns)
                        continue
                packets.append(
                    Packet(
                        ts_ns=from_system(round(seconds * 1e9), asked_ns),
                        link=self.link,
                        link_type=link_type,
                        data=data,
                        original_length=len(data),
                    )
                )
            return packets, True
        return packets, False

    def _report_drops(self, ts_ns: int) -> None:
        for each in self._captures:
            raw = each.socket.ins.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
            _, drops = struct.unpack("=II", raw)
            if drops:
                where = f" of {each.name}" if len(self._captures) > 1 else ""
                self._inbox.put(
                    WireEvent(
                        ts_ns=ts_ns,
                        link=self.link,
                        kind=EventKind.DISCARDED,
                        message=f"capture fell behind: the kernel dropped {drops} packets{where}",
                        packets=drops,
                    )
                )

    def _report_unreadable(self, interface: str, hardware: int, ts_ns: int) -> None:
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


def capture_trouble() -> PortTrouble | None:
    """Return the reason why this process cannot capture from any interface; None if it can."""
    if sys.platform != "linux":
        return PortTrouble(
            "listening to an interface needs Linux; decode a file of Wireshark's, "
            "or use tap:LISTEN=TARGET"
        )
    # Open a packet socket to see whether the kernel permits it. It is bound to no protocol, so it
    # receives nothing.
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0).close()
    except PermissionError:
        return PortTrouble(
            "listening needs the capability cap_net_raw",
            f"sudo {_program()}; or give raw sockets to every Python program: "
            f"sudo setcap cap_net_raw+ep {os.path.realpath(sys.executable)}",
        )
    return None


def _program() -> str:
    """Return a command that starts this program under sudo, which has its own search path."""
    script = os.path.join(os.path.dirname(sys.executable), "mbtool")
    if not os.path.exists(script):
        return f"{sys.executable} -m mbtool"
    here = os.path.relpath(script)
    return script if here.startswith(os.pardir) else here


def hardware_trouble(hardware: int) -> PortTrouble | None:
    """Return the reason why packets of a hardware type (ARPHRD_, linux/if_arp.h) cannot be read.

    Returns None if they can be read.
    """
    if hardware in _LINK_TYPES:
        return None
    return PortTrouble(
        f"its hardware type {hardware} is not one that can be read; "
        "Ethernet, loopback and IP tunnels are"
    )


def _open(link: InterfaceLink, name: str) -> Any:
    interfaces = [name for _, name in socket.if_nameindex()]
    is_any = name == ANY_INTERFACE
    of = _link_text(link, name)
    if sys.platform == "linux" and not is_any and name not in interfaces:
        raise LinkError(f"{of}: no such interface; here are: {', '.join(interfaces)}")
    # Check the permission before scapy is imported: the import takes time, and scapy's error
    # message would say less.
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
        # scapy binds its socket to one interface. Replace it by a socket bound to none, which
        # receives from all interfaces.
        capture = L2ListenSocket(iface="lo" if "lo" in interfaces else interfaces[0], promisc=False)
        capture.ins.close()
        capture.ins = _hearing_all()
        return capture
    except OSError as error:
        why = "is it up?" if error.errno == errno.ENETDOWN else error.strerror
        raise LinkError(f"{of}: cannot listen: {why}") from error


def _link_text(link: InterfaceLink, name: str) -> str:
    """Return the link as text, with the interface's name behind it if the link has several."""
    return f"{link}: {name}" if len(link.interfaces) > 1 else str(link)


def _hearing_all() -> socket.socket:
    """Open a packet socket that receives from all interfaces; set the options that scapy sets."""
    listener = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
    listener.setsockopt(_SOL_PACKET, _PACKET_AUXDATA, 1)
    listener.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return listener


def _prepare(listener: socket.socket, program: Sequence[bytes]) -> None:
    """Prepare a packet socket: set the size of the kernel's buffer and the filter `program`.

    Packets that the socket received before it had the filter are dropped.
    """
    _attach(listener, drop_everything())
    listener.setblocking(False)
    with suppress(BlockingIOError):
        while True:
            listener.recv(1)
    try:
        listener.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
    except PermissionError:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    listener.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)  # Reading resets the count.
    _attach(listener, program)


def _attach(listener: socket.socket, program: Sequence[bytes]) -> None:
    code = ctypes.create_string_buffer(b"".join(program))
    sock_fprog = struct.pack("@HP", len(program), ctypes.addressof(code))
    listener.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, sock_fprog)
