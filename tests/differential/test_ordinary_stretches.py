"""No stretch of an ordinary capture looks like an attack or a scan."""

# What a capture shows of attacks is in ATTACKED; tests/golden has the attacks that must be found.
# Most stretches begin within connections and end within them. Both ends are drawn by chance, so a
# stretch may have a part of a master's first turn only.

from __future__ import annotations

import random
from bisect import bisect_left
from functools import cache
from typing import TYPE_CHECKING

import pytest

from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.devices.checking.checker import Checker
from tests.adversary.cuts import PORTS, captures
from tests.adversary.removal import packets_of

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.core import Packet

pytestmark = pytest.mark.public_captures

STRETCHES = 300
SHORTEST_S, LONGEST_S = 0.5, 120
MOST_PACKETS = 12_000

ATTACKED = (
    "Quickdraw-Snort",  # tries out all functions, and stops communication
    "OISF__suricata-verify",
    "camp0__aiengine",
    "arkime__arkime",
    "reseg5_suricata",
    "snap62_quickdraw2",
    "fuzz-72",  # made from it
    "send_a_fake_command",  # a second master writes
    "kb221svs",  # an attack in the middle of connections
)
"""Parts of the paths of captures that hold what an attacker does, or what looks like it."""


@cache
def ordinary() -> list[Path]:
    return [path for path in captures() if not any(name in str(path) for name in ATTACKED)]


def findings(packets: list[Packet], ports: tuple[int, ...]) -> list[str]:
    decoder, checker = Decoder(Namer(), ports=ports), Checker()
    found = [
        one for packet in packets for record in decoder.feed(packet) for one in checker.feed(record)
    ]
    found += [one for record in decoder.close() for one in checker.feed(record)]
    found += checker.close()
    return [one.code for one in found if one.code.startswith("SEC-")]


@pytest.mark.parametrize("share", range(10))
def test_no_rule_about_attacks_is_broken_by_an_ordinary_stretch(share: int) -> None:
    if not ordinary():
        pytest.skip("the public captures are not there")
    rng = random.Random(share)
    paths = ordinary()[share::10]
    broken = []
    for path in paths:
        packets = packets_of(path)
        times = [packet.ts_ns for packet in packets]
        for _ in range(STRETCHES // 10 // len(paths) + 1):
            start = rng.randrange(len(packets))
            seconds = rng.choice((SHORTEST_S, 1, 5, 20, 59, LONGEST_S))
            end = bisect_left(times, times[start] + int(seconds * 1e9), start)
            stretch = packets[start : min(end, start + MOST_PACKETS)]
            codes = findings(stretch, PORTS.get(path.name, (502,)))
            if codes:
                broken.append((path.name, start, seconds, codes))
    assert broken == []
