"""Removes one packet of a capture and compares what a decoder makes of the rest.

`python -m tests.adversary.removal FILE... [--sample N]` prints a line for each file.
"""

# This needs no truth. A transaction without a byte in the removed packet stays as it was. A pair
# with a byte in it loses one half, and the other half is told neither as unanswered nor as
# unsolicited. No new pair is made. A capture of more than BLOCK packets is compared block by
# block.

from __future__ import annotations

import argparse
import contextlib
import random
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import CutError
from tests.adversary.judgement import NO_ANSWER, UNSOLICITED, decode, whole_adu
from tests.adversary.segments import is_at_or_after, part_of
from tests.captures import read_packets

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from mbtool.core import Packet
    from tests.adversary.segments import Part

BLOCK = 1000
NEAR_BYTES = 3000
"""The parts of an ADU that is cut over segments are at most this far apart in the stream."""
ALL_UNDER, SAMPLE = 2000, 500
COPY_NS = 10_000_000_000
"""Equal segments that follow each other sooner, in ns, are copies: seen twice, or retransmitted."""

Half = tuple[bytes, int]
"""The bytes of an ADU, and the place of the packet that completed it."""
Pair = tuple[Half, Half]


@dataclass(slots=True)
class Removals:
    """What went wrong when packets were removed, one at a time. Each is named with its packet."""

    removed: int = 0
    joined: list[tuple[int, Pair]] = field(default_factory=list)
    """Pairs that the whole capture does not have."""
    parted: list[tuple[int, Pair]] = field(default_factory=list)
    """Pairs that are gone although both halves are there."""
    changed: list[tuple[int, Half]] = field(default_factory=list)
    """Transactions that have another outcome, or are gone."""
    blamed: list[tuple[int, Half]] = field(default_factory=list)
    """Requests that are told as unanswered since their response was removed."""
    unasked: list[tuple[int, Half]] = field(default_factory=list)
    """Responses that are told as unsolicited since their request was removed."""

    def counts(self) -> dict[str, int]:
        return {
            "removed": self.removed,
            "joined": len(self.joined),
            "parted": len(self.parted),
            "changed": len(self.changed),
            "blamed": len(self.blamed),
            "unasked": len(self.unasked),
        }


@dataclass(frozen=True, slots=True)
class Reading:
    """A decoder's transactions of a capture: pairs with their outcomes, and single halves."""

    pairs: Counter[tuple[Pair, str]]
    asks: Counter[tuple[Half, str]]
    answers: Counter[tuple[Half, str]]


class Block:
    """Some packets of a capture, and what a decoder makes of all of them."""

    def __init__(self, packets: Sequence[Packet], ports: Sequence[int]) -> None:
        self._packets = packets
        self._ports = ports
        self._parts = [part_of(packet) for packet in packets]
        self._at: defaultdict[int, list[int]] = defaultdict(list)
        for place, packet in enumerate(packets):
            self._at[packet.ts_ns].append(place)
        self._first_copies = self._find_copies()
        """For each place of a segment with data, the place of its first copy."""
        self._copies = Counter(self._first_copies.values())
        self._whole = self._read(packets)

    def remove(self, place: int, found: Removals, number: int) -> None:
        """Decode without the packet at a place, and note what is wrong under its number."""
        rest = self._read([*self._packets[:place], *self._packets[place + 1 :]])
        gone, new = self._whole.pairs - rest.pairs, rest.pairs - self._whole.pairs
        if self._has_copy(place):
            _take_out_delayed(gone, new)
        found.removed += 1
        found.joined += [(number, pair) for pair, _ in _without_outcomes(new - gone, gone)]
        is_known = self._is_known_from_others(place)
        for pair, _ in gone.elements():
            ask, answer = pair
            if self._hits(place, answer):
                if is_known and _more(rest.asks, self._whole.asks, ask, NO_ANSWER):
                    found.blamed.append((number, ask))
            elif self._hits(place, ask):
                if is_known and _more(rest.answers, self._whole.answers, answer, UNSOLICITED):
                    found.unasked.append((number, answer))
            elif any(one == pair for one, _ in new):
                found.changed.append((number, ask))
            else:
                found.parted.append((number, pair))
        if not self._has_copy(place):
            for whole, now in ((self._whole.asks, rest.asks), (self._whole.answers, rest.answers)):
                found.changed += [(number, half) for half in self._changed(place, whole, now)]

    def _changed(
        self, place: int, whole: Counter[tuple[Half, str]], now: Counter[tuple[Half, str]]
    ) -> list[Half]:
        """Single halves without a byte in the removed packet that are gone, or told as worse."""
        still = Counter(half for half, _ in now.elements())
        return [
            half
            for half, _ in (whole - now).elements()
            if not self._hits(place, half)
            and (not still[half] or now[half, NO_ANSWER] + now[half, UNSOLICITED])
        ]

    def _read(self, packets: Iterable[Packet]) -> Reading:
        reading = Reading(Counter(), Counter(), Counter())
        for record in decode(packets, self._ports):
            ask = self._half(whole_adu(record, record.request_raw), record.request_ns)
            answer = self._half(whole_adu(record, record.response_raw), record.response_ns)
            outcome = str(record.outcome)
            if ask is not None and answer is not None:
                reading.pairs[(ask, answer), outcome] += 1
            elif ask is not None:
                reading.asks[ask, outcome] += 1
            elif answer is not None:
                reading.answers[answer, outcome] += 1
        return reading

    def _half(self, raw: bytes | None, ts_ns: int | None) -> Half | None:
        """An ADU by its bytes and the first copy of the packet that completed it."""
        if raw is None or ts_ns is None:
            return None
        for place in self._at[ts_ns]:
            part = self._parts[place]
            if (
                part is not None
                and raw[-1:] in part.payload
                and (raw in part.payload or _ends_within(raw, part.payload))
            ):
                return raw, self._first_copies[place]
        return raw, self._at[ts_ns][0] if self._at[ts_ns] else -1

    def _has_copy(self, place: int) -> bool:
        return self._copies[self._first_copies.get(place, -1)] > 1

    def _find_copies(self) -> dict[int, int]:
        first_copies: dict[int, int] = {}
        latest: dict[tuple[object, ...], int] = {}
        for place, part in enumerate(self._parts):
            if part is None or not part.payload:
                continue
            before = latest.get(_content(part), place)
            is_copy = self._packets[place].ts_ns - self._packets[before].ts_ns < COPY_NS
            first_copies[place] = first_copies.get(before, place) if is_copy else place
            latest[_content(part)] = place
        return first_copies

    def _hits(self, place: int, half: Half) -> bool:
        """True if an ADU may have bytes in the packet at a place, and in no copy of it."""
        part = self._parts[place]
        raw, completed_by = half
        if part is None or not part.payload or self._has_copy(place):
            return False
        if place == completed_by:
            return True
        other = self._parts[completed_by]
        if completed_by < 0 or other is None or other.flow != part.flow or raw in other.payload:
            return False
        distance = (part.sequence - other.sequence) & 0xFFFFFFFF
        return min(distance, (1 << 32) - distance) < NEAR_BYTES

    def _is_known_from_others(self, place: int) -> bool:
        """True if other segments tell that the bytes of the one at a place were sent."""
        part = self._parts[place]
        if part is None:
            return False
        earlier = later = False
        for number, other in enumerate(self._parts):
            if other is None or number == place:
                continue
            if other.flow == part.flow:
                earlier |= number < place
                later |= number > place and is_at_or_after(other.sequence, part.end)
            elif other.flow == part.is_sent_back and other.acknowledgement is not None:
                earlier |= number < place
                later |= number > place and is_at_or_after(other.acknowledgement, part.end)
        return earlier and later


def remove_one_at_a_time(
    packets: Sequence[Packet], ports: Sequence[int] = (502,), sample: int | None = None
) -> Removals:
    """Remove each packet of a capture, or `sample` of them by chance."""
    chosen = list(range(len(packets)))
    if sample is not None and sample < len(chosen):
        chosen = sorted(random.Random(sample).sample(chosen, sample))
    found = Removals()
    block, start = None, -1
    for number in chosen:
        if block is None or number // BLOCK * BLOCK != start:
            start = number // BLOCK * BLOCK
            block = Block(packets[start : start + BLOCK], ports)
        block.remove(number - start, found, number)
    return found


def packets_of(name: str | Path) -> list[Packet]:
    """The packets of a capture file, as far as it can be read."""
    packets: list[Packet] = []
    with contextlib.suppress(CutError):
        packets.extend(read_packets(name))
    return packets


def _more(
    rest: Counter[tuple[Half, str]], whole: Counter[tuple[Half, str]], half: Half, outcome: str
) -> bool:
    """True if a half has this outcome more often than in the whole capture."""
    return rest[half, outcome] > whole[half, outcome]


def _content(part: Part) -> tuple[object, ...]:
    return part.flow, part.sequence, part.payload


def _ends_within(raw: bytes, payload: bytes) -> bool:
    """True if the payload begins with the end of an ADU whose start is in another segment."""
    return any(payload.startswith(raw[-size:]) for size in range(1, len(raw)))


def _take_out_delayed(gone: Counter[tuple[Pair, str]], new: Counter[tuple[Pair, str]]) -> None:
    """Leave out pairs that only changed their time, since the second copy came later."""
    for (pair, outcome), _ in list(new.items()):
        for (other, other_outcome), count in list(gone.items()):
            same = pair[0][0] == other[0][0] and pair[1][0] == other[1][0]
            if same and outcome == other_outcome and count:
                gone[other, other_outcome] -= 1
                new[pair, outcome] -= 1
                break
    for counter in (gone, new):
        for key in [key for key, count in counter.items() if count <= 0]:
            del counter[key]


def _without_outcomes(
    new: Counter[tuple[Pair, str]], gone: Counter[tuple[Pair, str]]
) -> list[tuple[Pair, str]]:
    """The pairs that are new whatever their outcome."""
    known = {pair for pair, _ in gone}
    return [one for one in new.elements() if one[0] not in known]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--sample", type=int, help="remove only so many packets, by chance")
    parser.add_argument("--port", type=int, action="append", help="a TCP port of Modbus (502)")
    options = parser.parse_args()
    columns = tuple(Removals().counts())
    print("".join(f"{column:>9}" for column in columns) + "  file")
    for name in options.files:
        packets = packets_of(name)
        if all(part_of(packet) is None for packet in packets):
            print(f"{'no TCP packets':>{9 * len(columns)}}  {name.rsplit('/', 1)[-1]}")
            continue
        sample = options.sample
        if sample is None and len(packets) >= ALL_UNDER:
            sample = SAMPLE
        counts = remove_one_at_a_time(packets, options.port or (502,), sample).counts()
        print("".join(f"{counts[column]:9}" for column in columns) + f"  {name.rsplit('/', 1)[-1]}")


if __name__ == "__main__":
    main()
