"""What is kept of the datagrams between two ends."""

from __future__ import annotations

import tracemalloc

from mbtool.packets.segment import UdpDatagram
from mbtool.packets.udp_flows import UdpFlows

LARGE = 64_000


def _feed(flows: UdpFlows, number: int, ts_ns: int) -> None:
    master, slave = b"\x0a\0\0\1", b"\x0a\0\0\2"
    payload = number.to_bytes(2, "big") * (LARGE // 2)
    flows.feed(UdpDatagram(master, 50000, slave, 502, number, payload, 0), ts_ns, "if0", None)


def test_the_payloads_of_datagrams_are_not_kept() -> None:
    flows = UdpFlows((502,), across=True)
    _feed(flows, 1, 0)
    tracemalloc.start()
    try:
        for number in range(2, 9):
            _feed(flows, number, number)
        assert tracemalloc.get_traced_memory()[0] < LARGE
    finally:
        tracemalloc.stop()


def test_datagrams_older_than_a_copy_may_be_are_forgotten() -> None:
    flows = UdpFlows((502,), across=True)
    for number in range(1, 5):
        _feed(flows, number, number)
    _feed(flows, 5, 2_000_000_000)
    (flow,) = flows._flows.values()
    assert sum(len(seen) for seen in flow.seen.values()) == 1
