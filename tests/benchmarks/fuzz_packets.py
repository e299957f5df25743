"""Feeds a decoder packets that nobody sent: python -m tests.benchmarks.fuzz_packets --packets N.

With --any-port it looks for Modbus at every port.

Packets of conversations are mutated, or made of nothing at all, and decoded as a capture's are.
What must hold: nothing is raised, all bounds are kept, and memory grows by no more than
MEMORY_BOUND, however many packets there are.
"""

# The bound adds up what the rooms state: 32 MiB of segments held for others, 4 MiB of fragments, a
# few KiB for each of 4096 connections and their conversations, and what the interpreter keeps for
# itself. Resident memory is what is measured, where the system tells it.

from __future__ import annotations

import argparse
import random
import struct
import sys
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mbtool.core import Packet, WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.modbus import mbap_adu
from tests.packets.building import (
    MASTER,
    SLAVE,
    End,
    Talk,
    erspan,
    ethernet,
    in_fragments,
    ipv4,
    ipv6,
    packet,
    tcp,
    vxlan,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MEMORY_BOUND = 256 * 1024 * 1024
REPORT_EVERY = 500_000

_LINK_TYPES = (0, 1, 12, 101, 108, 113, 147, 228, 229, 250, 276, 9999)
_EDGES = (0, 1, 2, 7, 8, 0x7F, 0x80, 0xFF)
_TCP_AT = 34
_MS = 1_000_000
_PAUSE = 3 * 3_600_000


@dataclass
class Result:
    """What came of a run."""

    packets: int = 0
    transactions: int = 0
    events: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    grown: int | None = None
    """By how many bytes resident memory grew, where the system tells."""


def main() -> None:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--packets", type=int, default=100_000)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--any-port", action="store_true")
    given = options.parse_args()
    result = fuzz(given.packets, given.seed, any_port=given.any_port, progress=True)
    sys.stdout.write(report(result))
    if result.grown is not None and result.grown > MEMORY_BOUND:
        sys.exit("memory grew beyond its bound")


def fuzz(packets: int, seed: int, *, any_port: bool = False, progress: bool = False) -> Result:
    """Decode so many packets. Raises what the decoder raises, with the packet's number."""
    chance = random.Random(seed)
    decoder = Decoder(Namer(), ports=(502,), rtu_ports=(5020,), any_port=any_port)
    result, before, begin = Result(), _resident(), time.perf_counter()
    recent: list[Packet] = []
    for each in _packets(chance):
        if result.packets >= packets:
            break
        result.packets += 1
        mutated = _mutated(chance, each, recent)
        recent = [*recent[-7:], mutated]
        try:
            _count(result, decoder.feed(mutated))
        except Exception as error:
            error.add_note(f"packet {result.packets} of seed {seed}: {mutated!r}")
            raise
        if progress and result.packets % REPORT_EVERY == 0:
            result.grown = _grown(before)
            sys.stderr.write(f"{result.packets:,} packets, memory grew by {_size(result.grown)}\n")
    result.grown = _grown(before)
    _count(result, decoder.close())
    result.seconds = time.perf_counter() - begin
    return result


def report(result: Result) -> str:
    lines = [
        f"{result.packets:,} packets in {result.seconds:.0f} s: nothing was raised",
        f"{result.transactions:,} transactions",
        *(f"{count:,} {kind} events" for kind, count in sorted(result.events.items())),
        f"memory grew by {_size(result.grown)}; the bound is {MEMORY_BOUND / 2**20:.0f} MiB",
    ]
    return "\n".join(lines) + "\n"


def _count(result: Result, records: Sequence[object]) -> None:
    for record in records:
        if isinstance(record, WireEvent):
            result.events[record.kind] += 1
        else:
            result.transactions += 1


def _packets(chance: random.Random) -> Iterator[Packet]:
    """Conversations without end, each a few polls long, some broken off."""
    now_ns = 0
    while True:
        port = chance.randrange(1024, 0x10000)
        first, second = chance.getrandbits(32), chance.getrandbits(32)
        slave_port = chance.choice((502, 502, 502, 5020))
        talk = Talk(End(MASTER, port, first), End(SLAVE, slave_port, second), now_ns)
        said = talk.handshake() if chance.random() < 0.8 else []
        for _ in range(chance.randrange(8)):
            said.append(talk.request(_adu(chance, chance.randrange(5))))
            said.append(talk.response(_adu(chance, chance.randrange(5, 60))))
        if chance.random() < 0.5:
            said += talk.goodbye()
        for each in said:
            if chance.random() < 0.1:
                yield from in_fragments(each, 8, 16, identification=chance.getrandbits(4))
            elif chance.random() < 0.1:
                yield packet(ethernet(ipv6(each.data[_TCP_AT:]), 0x86DD), each.ts_ns)
            elif chance.random() < 0.05:
                yield packet(chance.choice((erspan, vxlan))(each.data), each.ts_ns)
            else:
                yield each
        # Rarely a pause in which all is forgotten, so that the tables fill up in between.
        pause = _PAUSE if chance.random() < 0.0001 else chance.choice((0, 1, 20, -50, -500))
        now_ns = talk.ts_ns + pause * _MS


def _adu(chance: random.Random, size: int) -> bytes:
    function = chance.choice((1, 3, 4, 6, 15, 16, 23, 43, 0x83, chance.randrange(256)))
    return mbap_adu(chance.getrandbits(16), chance.randrange(4), bytes([function])) + bytes(size)


def _mutated(chance: random.Random, each: Packet, recent: list[Packet]) -> Packet:
    what = chance.randrange(12)
    if what < 3:
        return each
    if what == 3 and recent:
        return replace(chance.choice(recent), ts_ns=each.ts_ns)
    if what == 4:
        data = chance.randbytes(chance.randrange(200))
        link_type = chance.choice(_LINK_TYPES)
        return packet(data, each.ts_ns, link_type=link_type, link=f"if{chance.randrange(3)}")
    if what == 5:
        return replace(each, data=each.data[: chance.randrange(len(each.data) + 1)])
    if what == 6:
        length = chance.choice((0, len(each.data) // 2, 0xFFFF, 2**31))
        return replace(each, original_length=length)
    if what == 7:
        data = tcp(
            chance.choice((502, 1502, chance.randrange(0x10000))),
            502,
            chance.choice((0, 0xFFFFFFFF, chance.getrandbits(32))),
            chance.getrandbits(32),
            chance.getrandbits(8),
            chance.randbytes(chance.randrange(300)),
        )
        fragment = chance.choice((0, 0, 0x2000, chance.getrandbits(14)))
        return packet(ethernet(ipv4(data, fragment=fragment)), each.ts_ns)
    changed = bytearray(each.data)
    if what == 8 and len(changed) >= _TCP_AT + 12:
        # Sequence numbers a little off: overlaps, holes, leaps.
        at = _TCP_AT + chance.choice((4, 8))
        (number,) = struct.unpack_from(">I", changed, at)
        off = chance.choice((-9, -1, 1, 9, 1460, 70_000, 2**21))
        struct.pack_into(">I", changed, at, (number + off) & 0xFFFFFFFF)
    else:
        for _ in range(chance.randrange(1, 5)):
            value = chance.choice((*_EDGES, chance.randrange(256)))
            changed[chance.randrange(len(changed))] = value
    return replace(each, data=bytes(changed))


def _grown(before: int | None) -> int | None:
    after = _resident()
    return None if before is None or after is None else after - before


def _size(grown: int | None) -> str:
    return "unknown" if grown is None else f"{grown / 2**20:.0f} MiB"


def _resident() -> int | None:
    """How much memory this process has, in bytes; Linux tells it."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * 4096
    except OSError:
        return None


if __name__ == "__main__":
    main()
