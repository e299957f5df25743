"""A recording of six devices of a network, all of them unit 1, and what they were asked."""

from __future__ import annotations

from mbtool.modbus import mbap_adu
from tests.packets.building import MASTER, End, Talk, pcap

HOSTS = tuple(f"192.168.1.{number}" for number in range(101, 107))
READ_THREE = bytes.fromhex("03 0000 0003")
READ_INPUTS = bytes.fromhex("04 0010 0002")
READ_BEYOND = bytes.fromhex("03 1000 0001")
WRITE_ONE = bytes.fromhex("06 0005 0007")
ROUNDS = 3


def exchanges(device: int) -> list[tuple[bytes, bytes]]:
    """The requests to a device (0 to 5), each with its response; values change in each round."""
    told = []
    for step in range(ROUNDS):
        registers = bytes([0, device, 0, step, 0x12, 0x34])
        told += [
            (READ_THREE, b"\x03\x06" + registers),
            (READ_INPUTS, bytes([4, 4, 0, 10 * device, 0, step])),
        ]
    return [*told, (WRITE_ONE, WRITE_ONE), (READ_BEYOND, b"\x83\x02")]


def site_capture() -> bytes:
    """A pcap file: the master asks one device after the other, each in a connection of its own."""
    packets = []
    for device, host in enumerate(HOSTS):
        talk = Talk(End(MASTER, 49152 + device, 1000), End(host, 502, 5000))
        talk.ts_ns = 1_700_000_000_000_000_000 + device * 1_000_000_000
        packets += talk.handshake()
        for number, (request, response) in enumerate(exchanges(device), 1):
            packets.append(talk.request(mbap_adu(number, 1, request)))
            packets.append(talk.response(mbap_adu(number, 1, response)))
    return pcap(packets)
