"""The ends of the TCP connection of a packet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mbtool.packets.tcp_ends import end_of, tcp_ends
from tests.captures import read_packets

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
MASTER, SLAVE = (bytes([10, 0, 0, 1]), 50001), (bytes([10, 0, 0, 11]), 502)


def test_both_directions_of_a_connection_have_the_same_ends() -> None:
    found = [tcp_ends(one) for one in read_packets(CAPTURES / "plant.pcap")]
    assert found[:3] == [frozenset((MASTER, SLAVE))] * 3
    assert None not in found


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("10.0.0.11:502", SLAVE),
        ("[fe80::1]:502", (bytes.fromhex("fe80" + "00" * 13 + "01"), 502)),
        ("plc:502", None),
        ("", None),
        (None, None),
    ],
)
def test_a_text_names_an_end(text: str | None, end: object) -> None:
    assert end_of(text) == end


def test_a_packet_that_is_cut_anywhere_has_these_ends_or_none() -> None:
    packet = next(iter(read_packets(CAPTURES / "plant.pcap")))
    found = {tcp_ends(replace(packet, data=packet.data[:size])) for size in range(60)}
    assert found == {None, frozenset((MASTER, SLAVE))}
