"""The kernel filter that lets only Modbus traffic into a capture: classic BPF, assembled here."""

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

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import UsageError
from mbtool.packets.segment import BEFORE_TCP, TCP, UDP
from mbtool.packets.tunnels import ERSPAN, GRE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

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
        *_heard_once(is_loopback),
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
        *_from_or_to(ports),
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


def _heard_once(is_loopback: bool | None) -> Iterator[Instruction]:
    if is_loopback is None:
        yield Instruction(_LD_WORD, _HARDWARE)
        yield Instruction(_JUMP_EQUAL, _ARPHRD_LOOPBACK, "", "wanted")
    if is_loopback is not False:
        yield Instruction(_LD_WORD, _PACKET_TYPE)
        yield Instruction(_JUMP_EQUAL, _PACKET_OUTGOING, "drop")


def _from_or_to(ports: Sequence[int]) -> Iterator[Instruction]:
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
