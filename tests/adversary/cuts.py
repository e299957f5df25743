"""Cuts captures at random places, with loss and snap lengths, and judges what is told of the rest.

`python -m tests.adversary.cuts [FILE...] --cuts 1000` prints a line for each capture and kind of
cut; without FILE it cuts all public captures and simulated plants of pipelining masters.
"""

# The judge of a cut capture is the whole capture, and the acknowledgements of its packets. An ADU
# is known in both by its connection and the sequence number of its first byte, so copies and
# retransmissions of it are one ADU. Pairs that are ambiguous in the whole capture judge nothing.

from __future__ import annotations

import argparse
import random
from bisect import bisect_left
from collections import Counter, defaultdict
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from mbtool.decode.decoder import Decoder
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Transport, Verdict
from tests.adversary.judgement import NO_ANSWER, UNSOLICITED
from tests.adversary.network import simulate
from tests.adversary.removal import packets_of
from tests.adversary.segments import Flow, part_of
from tests.captures import public_folder
from tests.packets.building import cut

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path
    from random import Random

    from mbtool.core import Packet

MOST_PACKETS = 3000
"""A cut has at most this many packets of a capture, as decoding more takes long."""
HEAD = 8
"""The first bytes of a Modbus/TCP ADU that tell its unit and function."""
LONGEST = 2000
"""No ADU has more bytes."""
LOSSES = (0.01, 0.05, 0.2, 0.5)
SNAPLENS = range(60, 121)
KINDS = ("ends", "loss", "snaplen", "loss and snaplen")
PLANTS = ("pipelined constant", "pipelined cycle", "pipelined counting", "cycle")

PORTS = {
    "port10502_stepping0.pcap": (10502,),
    "rtu_over_tcp_flowmeter.pcap": (8899,),
}
"""Captures whose slave is not at port 502."""
RTU_PORTS = {"rtu_over_tcp_brainchild.pcap": (502,), "rtu_over_tcp_flowmeter.pcap": (8899,)}


class Half(NamedTuple):
    """A request or a response: its connection and direction, and the number of its first byte."""

    flow: Flow
    sequence: int


class Cut(NamedTuple):
    """What a cut capture keeps of a capture."""

    kind: str
    start: int
    end: int
    loss: float
    """The share (0 to 1) of packets that are left out."""
    snaplen: int | None
    seed: int


class Told(NamedTuple):
    """What a decoder tells of a request, a response or a pair of both."""

    ask: Half | None
    answer: Half | None
    outcome: str
    is_sure: bool
    number: int
    """The number of the first of its packets in the whole capture, from 1."""


@dataclass(slots=True)
class Cuts:
    """What was wrong with the transactions of cut captures."""

    cuts: int = 0
    pairs: int = 0
    """Pairs told as sure."""
    contradicted: list[tuple[Cut, Told]] = field(default_factory=list)
    """Of these, pairs that the whole capture has otherwise."""
    unacknowledged: list[tuple[Cut, Told]] = field(default_factory=list)
    """Of these, pairs whose response was sent before its sender had received the request, or whose
    request was sent after its sender had received the response."""
    blamed: list[tuple[Cut, Told]] = field(default_factory=list)
    """Requests told as not answered that have a response in the whole capture."""
    unasked: list[tuple[Cut, Told]] = field(default_factory=list)
    """Responses told as unsolicited that have a request in the whole capture."""
    proved: int = 0
    """Pairs of the whole capture of which the cut one has both halves."""
    parted: list[tuple[Cut, Told]] = field(default_factory=list)
    """Of these, pairs that are not joined."""
    doubtful: int = 0
    """Pairs told as ambiguous."""

    def counts(self) -> dict[str, int]:
        return {
            "cuts": self.cuts,
            "pairs": self.pairs,
            "contradicted": len(self.contradicted),
            "unacknowledged": len(self.unacknowledged),
            "blamed": len(self.blamed),
            "unasked": len(self.unasked),
            "proved": self.proved,
            "parted": len(self.parted),
            "doubtful": self.doubtful,
        }


class _HalfBytes(NamedTuple):
    """Where the bytes of an ADU are in a capture."""

    pieces: tuple[tuple[int, int, int], ...]
    """For each packet with bytes of it: the index of the packet, and the part of the ADU."""
    size: int
    head: int
    """The number of first bytes that must be captured for its unit and function to be known."""
    acknowledged: int | None
    """The sequence number that its last segment acknowledges."""


class WholeCapture:
    """A capture and what a decoder tells of it."""

    def __init__(self, packets: Iterable[Packet], name: str = "") -> None:
        self._ports, self._rtu_ports = PORTS.get(name, (502,)), RTU_PORTS.get(name, ())
        self.packets = [
            replace(packet, number=number, link="if0") for number, packet in enumerate(packets, 1)
        ]
        self._parts = [part_of(packet) for packet in self.packets]
        self._sizes: dict[Half, tuple[int, int]] = {}
        self._told = self._tell(self.packets)
        self._answer_of: dict[Half, Told] = {}
        self._ask_of: dict[Half, Told] = {}
        self._unclear: set[Half] = set()
        """Halves that the whole capture has more than once, or in an ambiguous pair."""
        for one in self._told:
            for half, known in ((one.ask, self._answer_of), (one.answer, self._ask_of)):
                if half is None:
                    continue
                if half in known or not one.is_sure:
                    self._unclear.add(half)
                known[half] = one

    def judge(self, cut_: Cut, found: Cuts) -> None:
        """Decode a cut of this capture, and note what is wrong."""
        kept = list(self._kept(cut_))
        told = self._tell(kept)
        found.cuts += 1
        joined = {(one.ask, one.answer) for one in told}
        for one in told:
            ask, answer = one.ask, one.answer
            if ask is not None and answer is not None:
                if not one.is_sure:
                    found.doubtful += 1
                    continue
                found.pairs += 1
                if self._contradicts(ask, answer):
                    found.contradicted.append((cut_, one))
                if not self._is_acknowledged(ask, answer):
                    found.unacknowledged.append((cut_, one))
            elif ask is not None and one.outcome == NO_ANSWER:
                whole = self._answer_of.get(ask)
                if whole is not None and whole.answer is not None and ask not in self._unclear:
                    found.blamed.append((cut_, one))
            elif answer is not None and one.outcome == UNSOLICITED:
                whole = self._ask_of.get(answer)
                if whole is not None and whole.ask is not None and answer not in self._unclear:
                    found.unasked.append((cut_, one))
        for one in self._proved(kept):
            found.proved += 1
            if (one.ask, one.answer) not in joined:
                found.parted.append((cut_, one))

    def _contradicts(self, ask: Half, answer: Half) -> bool:
        """True if the whole capture has another response to a request, or another request."""
        if self._unclear & {ask, answer}:
            return False
        asked, answered = self._answer_of.get(ask), self._ask_of.get(answer)
        return asked is None or answered is None or asked.answer != answer

    def _is_acknowledged(self, ask: Half, answer: Half) -> bool:
        request, response = self._bytes.get(ask), self._bytes.get(answer)
        if request is None or response is None:
            return True
        if response.acknowledged is not None and not _is_at_or_after(
            response.acknowledged, ask.sequence + request.size
        ):
            return False
        return request.acknowledged is None or not _is_at_or_after(
            request.acknowledged, answer.sequence + response.size
        )

    def _proved(self, kept: Sequence[Packet]) -> Iterator[Told]:
        """Give the pairs both of whose halves a cut capture has, as far as it keeps packets."""
        if not kept:
            return
        places = {packet.number - 1: packet for packet in kept}
        first, last = kept[0].number, kept[-1].number
        start = bisect_left(self._pairs, first, key=lambda one: one.number)
        for one in self._pairs[start:]:
            if one.number > last:
                return
            if (
                one.ask is not None
                and one.answer is not None
                and all(self._has(self._bytes[half], places) for half in (one.ask, one.answer))
            ):
                yield one

    def _has(self, half: _HalfBytes, places: dict[int, Packet]) -> bool:
        """True if all packets of an ADU are kept, with the bytes that tell unit and function."""
        whole, seen = [], []
        for place, start, end in half.pieces:
            packet = places.get(place)
            if packet is None:
                continue
            whole.append((start, end))
            seen.append((start, end - (packet.original_length - len(packet.data))))
        return _covers(whole, half.size) and _covers(seen, half.head)

    def _kept(self, cut_: Cut) -> Iterator[Packet]:
        rng = random.Random(cut_.seed)
        for packet in self.packets[cut_.start : cut_.end]:
            if rng.random() >= cut_.loss:
                yield packet if cut_.snaplen is None else cut(packet, cut_.snaplen)

    def _tell(self, packets: Iterable[Packet]) -> list[Told]:
        decoder = Decoder(Namer(), ports=self._ports, rtu_ports=self._rtu_ports)
        records = [record for packet in packets for record in decoder.feed(packet)]
        records += decoder.close()
        again: Counter[tuple[int, bytes]] = Counter()
        found = []
        for one in records:
            if not isinstance(one, NamedTransaction):
                continue
            ask = self._half(one, one.request_raw, one.request_packet, again)
            answer = self._half(one, one.response_raw, one.response_packet, again)
            found.append(
                Told(
                    ask,
                    answer,
                    str(one.outcome),
                    Verdict.AMBIGUOUS not in one.verdicts,
                    min(n for n in (one.request_packet, one.response_packet) if n is not None),
                )
            )
        return found

    def _half(
        self,
        record: NamedTransaction,
        raw: bytes | None,
        number: int | None,
        again: Counter[tuple[int, bytes]],
    ) -> Half | None:
        """An ADU by its connection and first byte. `again` counts equal ADUs of one packet."""
        if raw is None or number is None:
            return None
        part = self._parts[number - 1]
        if part is None:
            return None
        head = HEAD if record.transport is Transport.TCP else len(raw)
        at = -1
        if record.transport is Transport.TCP and len(raw) < 6 + int.from_bytes(raw[4:6]):
            at = part.payload.rfind(raw)  # A cut ADU is the last one of its segment.
        else:
            for _ in range(again[number, raw] + 1):
                at = part.payload.find(raw, at + 1)
            again[number, raw] += 1
        if at < 0:
            sizes = range(len(raw) - 1, 0, -1)
            size = next((size for size in sizes if part.payload.startswith(raw[-size:])), None)
            if size is None:
                return None
            at = size - len(raw)
        half = Half(part.flow, (part.sequence + at) & 0xFFFFFFFF)
        known = self._sizes.get(half)
        if known is None or known[0] < len(raw):
            self._sizes[half] = len(raw), head
        return half

    @cached_property
    def _pairs(self) -> list[Told]:
        """The pairs that the whole capture has once and surely, by their first packet."""
        return sorted(
            (
                one
                for one in self._told
                if one.ask in self._bytes
                and one.answer in self._bytes
                and not self._unclear & {one.ask, one.answer}
            ),
            key=lambda one: one.number,
        )

    @cached_property
    def _bytes(self) -> dict[Half, _HalfBytes]:
        """Where the bytes of each ADU are."""
        by_flow: defaultdict[Flow, list[int]] = defaultdict(list)
        for place, part in enumerate(self._parts):
            if part is not None and part.payload:
                by_flow[part.flow].append(place)
        found = {}
        for flow, places in by_flow.items():
            halves = sorted(half for half in self._sizes if half.flow == flow)
            starts = [half.sequence for half in halves]
            pieces: defaultdict[Half, list[tuple[int, int, int]]] = defaultdict(list)
            for place in places:
                part = self._parts[place]
                assert part is not None
                length = len(part.payload)
                for half in _near(halves, starts, part.sequence, length):
                    start = _distance(part.sequence, half.sequence)
                    if start + length > 0 and start < self._sizes[half][0]:
                        pieces[half].append((place, start, start + length))
            for half, of_half in pieces.items():
                size, head = self._sizes[half]
                last = max(of_half, key=lambda one: min(one[2], size))
                last_part = self._parts[last[0]]
                acknowledged = None if last_part is None else last_part.acknowledgement
                found[half] = _HalfBytes(tuple(of_half), size, head, acknowledged)
        return found


def cuts_of(packets: int, count: int, rng: Random) -> Iterator[Cut]:
    """Draw random cuts of a capture with so many packets, as many of each kind."""
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        start = rng.randrange(packets)
        end = start + rng.randint(1, min(packets - start, MOST_PACKETS))
        loss = rng.choice(LOSSES) if "loss" in kind else 0.0
        snaplen = rng.choice(SNAPLENS) if "snaplen" in kind else None
        yield Cut(kind, start, end, loss, snaplen, rng.getrandbits(32))


def cut_capture(whole: WholeCapture, count: int, seed: int) -> dict[str, Cuts]:
    """Judge random cuts of a capture, by kind of cut."""
    found = {kind: Cuts() for kind in KINDS}
    for one in cuts_of(len(whole.packets), count, random.Random(seed)):
        whole.judge(one, found[one.kind])
    return found


def captures() -> list[Path]:
    """The public captures with TCP packets."""
    folder = public_folder()
    found = sorted(
        path
        for path in folder.rglob("*.pcap*")
        if path.suffix != ".csv" and not path.name.endswith((".user0.pcap", ".rtac.pcap"))
    )
    return [path for path in found if packets_of(path)]


def plant(master: str, seed: int) -> list[Packet]:
    """The packets of a simulated plant whose capture lacks nothing."""
    return simulate(master, (), seed, requests=120).packets


def _covers(parts: list[tuple[int, int]], size: int) -> bool:
    """True if parts have all bytes from 0 to `size`."""
    at = 0
    for start, end in sorted(parts):
        if start > at:
            return False
        at = max(at, end)
    return at >= size


def _near(
    halves: Sequence[Half], starts: Sequence[int], sequence: int, length: int
) -> Iterator[Half]:
    """Give the ADUs that may have bytes in a segment; `starts` are their sequence numbers."""
    for turn in (-(1 << 32), 0, 1 << 32):  # Behind 2^32 - 1, sequence numbers go on with 0.
        first = bisect_left(starts, sequence - LONGEST + turn)
        last = bisect_left(starts, sequence + length + turn)
        yield from halves[first:last]


def _distance(one: int, other: int) -> int:
    """How far a sequence number is behind another one; negative if it is before it."""
    distance = (one - other) & 0xFFFFFFFF
    return distance if distance < 1 << 31 else distance - (1 << 32)


def _is_at_or_after(one: int, other: int) -> bool:
    return (one - other) & 0xFFFFFFFF < 1 << 31


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--cuts", type=int, default=1000, help="how many cuts of each capture")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plants", type=int, default=0, help="how many plants of each master")
    parser.add_argument("--no-captures", action="store_true", help="cut the plants only")
    parser.add_argument("--show", type=int, default=0, help="show so many of each kind of error")
    options = parser.parse_args()
    columns = tuple(Cuts().counts())
    print("".join(f"{column:>15}" for column in columns) + "  capture")
    totals: Counter[tuple[str, str]] = Counter()

    def show(name: str, whole: WholeCapture) -> None:
        for kind, found in cut_capture(whole, options.cuts, options.seed).items():
            counts = found.counts()
            totals.update({(kind, column): count for column, count in counts.items()})
            print("".join(f"{counts[column]:15}" for column in columns) + f"  {kind}, {name}")
            for column in ("contradicted", "unacknowledged", "blamed", "unasked", "parted"):
                for cut_, told in getattr(found, column)[: options.show]:
                    ask, answer = (half and half.sequence for half in (told.ask, told.answer))
                    print(f"    {column}: {ask} {answer} {told.outcome} {told.number} {cut_}")

    for path in options.files or ([] if options.no_captures else captures()):
        name = str(path).rsplit("/", 1)[-1]
        show(name, WholeCapture(packets_of(path), name))
    for master in PLANTS if options.plants else ():
        for seed in range(options.seed, options.seed + options.plants):
            show(f"{master} {seed}", WholeCapture(plant(master, seed)))
    for kind in KINDS:
        print("".join(f"{totals[kind, column]:15}" for column in columns) + f"  {kind}, all")


if __name__ == "__main__":
    main()
