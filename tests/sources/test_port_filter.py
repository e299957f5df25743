"""The kernel filter, run by a small model of the kernel's machine (linux/filter.h)."""

from __future__ import annotations

import struct
from ipaddress import ip_address

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import UsageError
from mbtool.packets.segment import BEFORE_TCP, IPV6_FRAGMENT, find_tcp
from mbtool.packets.tunnels import ERSPAN
from mbtool.sources.interface import MAX_PORTS, drop_everything, port_filter
from tests.packets.building import gre, vxlan

IPV4, IPV6, ARP = 0x0800, 0x86DD, 0x0806
VLANS, HSR = (0x8100, 0x88A8, 0x9100), 0x892F
HOST, OUTGOING = 0, 4
UDP, TCP = 17, 6


ETHERNET, LOOPBACK = 1, 772


def passes(
    program: list[bytes],
    protocol: int,
    network: bytes,
    packet_type: int = HOST,
    hardware: int = ETHERNET,
) -> bool:
    """Run a filter over what stands from the network header on."""
    accumulator = index = place = 0

    def load(offset: int, size: int) -> int:
        told = {0xFFFFF000: protocol, 0xFFFFF004: packet_type, 0xFFFFF01C: hardware}
        if offset in told:
            return told[offset]
        start = offset - 0xFFF00000
        if start + size > len(network):
            raise IndexError
        return int.from_bytes(network[start : start + size], "big")

    while True:
        code, then, otherwise, k = struct.unpack("=HBBI", program[place])
        place += 1
        try:
            match code:
                case 0x20 | 0x28 | 0x30:
                    accumulator = load(k, {0x20: 4, 0x28: 2, 0x30: 1}[code])
                case 0x48:
                    accumulator = load(k + index, 2)
                case 0x01:
                    index = k
                case 0xB1:
                    index = 4 * (load(k, 1) & 15)
                case 0x05:
                    place += k
                case 0x15:
                    place += then if accumulator == k else otherwise
                case 0x45:
                    place += then if accumulator & k else otherwise
                case 0x06:
                    return bool(k)
                case _:
                    raise AssertionError(f"instruction {code:#x}")
        except IndexError:  # A load beyond the packet ends the filter with 0.
            return False


def ipv4(
    source: int, destination: int, *, protocol: int = TCP, fragment: int = 0, options: int = 0
) -> bytes:
    return (
        bytes([0x45 + options])
        + bytes(5)
        + struct.pack(">H", fragment)
        + bytes([64, protocol])
        + bytes(2)
        + ip_address("10.0.0.1").packed
        + ip_address("10.0.0.9").packed
        + bytes(4 * options)
        + struct.pack(">HH", source, destination)
        + bytes(16)
    )


def ipv6(source: int, destination: int, next_header: int = TCP) -> bytes:
    return (
        bytes.fromhex("60000000 0014")
        + bytes([next_header, 64])
        + bytes(32)
        + struct.pack(">HH", source, destination)
        + bytes(16)
    )


PORTS = st.integers(0, 0xFFFF)


@given(
    ports=st.lists(PORTS, min_size=1, max_size=MAX_PORTS),
    source=PORTS,
    destination=PORTS,
    options=st.integers(0, 10),
)
def test_passes_tcp_from_or_to_a_port(
    ports: list[int], source: int, destination: int, options: int
) -> None:
    program = port_filter(ports, is_loopback=False)
    wanted = source in ports or destination in ports
    assert passes(program, IPV4, ipv4(source, destination, options=options)) == wanted
    assert passes(program, IPV6, ipv6(source, destination)) == wanted
    assert passes(program, IPV4, ipv4(ports[-1], destination, options=options))
    assert passes(program, IPV6, ipv6(source, ports[-1]))


def test_passes_udp_from_or_to_a_port() -> None:
    program = port_filter([502], is_loopback=False)
    for ends in ((502, 9), (9, 502), (9, 9)):
        assert passes(program, IPV4, ipv4(*ends, protocol=UDP)) == (502 in ends)
        assert passes(program, IPV6, ipv6(*ends, UDP)) == (502 in ends)


def test_drops_what_is_neither_tcp_nor_udp() -> None:
    program = port_filter([502], is_loopback=False)
    assert not passes(program, IPV4, ipv4(502, 502, protocol=1))
    assert not passes(program, IPV6, ipv6(502, 502, 58))
    assert not passes(program, ARP, ipv4(502, 502))


@pytest.mark.parametrize("fragment", [0x2000, 0x0001, 0x20B9])
def test_passes_fragments_of_tcp_since_only_the_first_has_ports(fragment: int) -> None:
    program = port_filter([502], is_loopback=False)
    assert passes(program, IPV4, ipv4(1, 1, fragment=fragment))
    assert not passes(program, IPV4, ipv4(1, 1, fragment=fragment, protocol=UDP))


def test_a_packet_that_must_not_be_fragmented_is_no_fragment() -> None:
    program = port_filter([502], is_loopback=False)
    assert not passes(program, IPV4, ipv4(1, 1, fragment=0x4000))
    assert passes(program, IPV4, ipv4(1, 502, fragment=0x4000))


def test_passes_extension_headers_and_inner_tags() -> None:
    program = port_filter([502], is_loopback=False)
    for header in BEFORE_TCP:
        assert passes(program, IPV6, ipv6(1, 1, header))
    for tag in (*VLANS, HSR):
        assert passes(program, tag, b"")


@pytest.mark.parametrize("ports", [[503], [502]])
def test_passes_mirrors_over_a_network_and_no_other_tunnels(ports: list[int]) -> None:
    program = port_filter(ports, is_loopback=False)
    for protocol in ERSPAN:
        assert passes(program, IPV4, gre(bytes(60), protocol))
    assert not passes(program, IPV4, gre(bytes(60), 0x6558))
    assert not passes(program, IPV4, vxlan(bytes(60))[14:])


def test_what_passes_is_what_the_reassembler_looks_into() -> None:
    """Of IPv6 headers: none that is followed is kept out, and no other is let in."""
    program = port_filter([502], is_loopback=False)
    for header in range(256):
        # Behind the header in question stands TCP, in its first byte.
        inside = bytes([TCP]) + bytes(7) if header not in (TCP, UDP) else b""
        data = ipv6(502, 502, header)
        data = data[:40] + inside + data[40:]
        is_followed = find_tcp(data, 0, len(data)) is not None or header == IPV6_FRAGMENT
        assert passes(program, IPV6, data) >= is_followed
        is_port = header in (TCP, UDP)
        assert passes(program, IPV6, data) == (header in BEFORE_TCP or is_port)


def test_without_ports_any_tcp_and_udp_pass() -> None:
    program = port_filter([], is_loopback=False)
    assert passes(program, IPV4, ipv4(1, 2))
    assert passes(program, IPV6, ipv6(1, 2))
    assert passes(program, IPV4, ipv4(1, 2, protocol=UDP))
    assert not passes(program, IPV4, ipv4(1, 2, protocol=1))


def test_on_the_loopback_a_packet_passes_once() -> None:
    program = port_filter([502], is_loopback=True)
    assert passes(program, IPV4, ipv4(1, 502), HOST)
    assert not passes(program, IPV4, ipv4(1, 502), OUTGOING)
    assert passes(port_filter([502], is_loopback=False), IPV4, ipv4(1, 502), OUTGOING)


def test_on_all_interfaces_only_those_of_the_loopback_pass_once() -> None:
    program = port_filter([502], is_loopback=None)
    for way in (HOST, OUTGOING):
        assert passes(program, IPV4, ipv4(1, 502), way, ETHERNET)
        assert not passes(program, IPV4, ipv4(1, 503), way, ETHERNET)
    assert passes(program, IPV4, ipv4(1, 502), HOST, LOOPBACK)
    assert not passes(program, IPV4, ipv4(1, 502), OUTGOING, LOOPBACK)


def test_drop_everything_drops_everything() -> None:
    assert not passes(drop_everything(), IPV4, ipv4(502, 502))


def test_the_number_of_ports_is_bounded() -> None:
    with pytest.raises(UsageError, match="at most 100 ports"):
        port_filter(range(101), is_loopback=False)
