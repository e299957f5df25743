"""What a connection of another protocol costs if the capture lacks many of its packets."""

from __future__ import annotations

import io
import random
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.decode.decoder import Decoder
from mbtool.decode.pairing_readings import PairReading
from mbtool.devices import Namer
from mbtool.packets.capture import read_capture
from tests.packets.building import End, Talk, pcap

if TYPE_CHECKING:
    from types import FrameType

    from mbtool.core import Packet

PORT = 5222
COPIES_A_PACKET = 60


def chat(count: int) -> list[Packet]:
    """Two programs talk in text on several connections; the capture lacks half of the packets."""
    rng = random.Random(count)
    talks = [
        Talk(End("10.0.0.1", 40000 + one, 1000), End("10.0.0.9", PORT, 5000)) for one in range(9)
    ]
    packets = [packet for talk in talks for packet in talk.handshake()]
    for _ in range(count):
        talk = rng.choice(talks)
        say = rng.choice((talk.request, talk.response))
        packet = say(bytes(rng.choice(b"abcdefgh <>/=") for _ in range(rng.randint(20, 400))))
        if rng.random() < 0.5:
            packets.append(packet)
    return [replace(packet, ts_ns=number * 1_000_000) for number, packet in enumerate(packets, 1)]


@pytest.mark.parametrize("options", [{"any_port": True}, {"ports": (PORT,)}])
@pytest.mark.parametrize("count", [400, 1600])
def test_ways_to_pair_are_copied_in_proportion_to_the_packets(
    options: dict[str, Any], count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    copies = 0
    copy = PairReading.copy

    def counted(reading: PairReading) -> PairReading:
        nonlocal copies
        copies += 1
        return copy(reading)

    monkeypatch.setattr(PairReading, "copy", counted)
    packets = chat(count)
    decoder = Decoder(Namer(), **options)
    for packet in packets:
        decoder.feed(packet)
    decoder.close()
    assert copies <= COPIES_A_PACKET * len(packets)


def calls(data: bytes, *, any_port: bool) -> int:
    """The number of function calls that reading and decoding a capture takes."""
    count = 0

    def on_call(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    decoder = Decoder(Namer(), any_port=any_port)
    before = sys.getprofile()
    sys.setprofile(on_call)
    try:
        for packet in read_capture(io.BytesIO(data)):
            decoder.feed(packet)
        decoder.close()
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.parametrize("count", [400, 800, 1600, 6400])
def test_any_port_takes_at_most_three_times_the_calls_of_a_port_that_is_not_decoded(
    count: int,
) -> None:
    data = pcap(chat(count))
    calls(pcap(chat(8)), any_port=True)  # What is imported and made once is not counted.
    assert calls(data, any_port=True) <= 3 * calls(data, any_port=False)
