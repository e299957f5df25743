"""Cuts a recording down to a short one on which a decoder is still wrong, for a person to read."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from tests.benchmarks.plants.delivery import RESOLUTION_NS, Adapter
from tests.benchmarks.plants.judging import judge
from tests.benchmarks.plants.knowable import unknowable
from tests.benchmarks.plants.recording import MS, Recording, Role

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.benchmarks.plants.judging import PlantFigures, Told

    Decode = Callable[[Recording, Adapter], Told]

NEAREST = 30
"""How many beginnings next to the end are tried one by one, before the steps double."""


def judged(recording: Recording, adapter: Adapter, decode: Decode) -> PlantFigures:
    unclear = unknowable(recording, RESOLUTION_NS.get(adapter))
    return judge(recording, unclear, decode(recording, adapter))


def shortest_failure(recording: Recording, adapter: Adapter, decode: Decode) -> Recording | None:
    """A piece of the recording on which the decoder is wrong, None if it is right everywhere."""
    if not _fails(recording, adapter, decode):
        return None
    bounds = _bounds(recording)
    few, many = 1, len(bounds) - 1
    while few < many:
        middle = (few + many) // 2
        if _fails(piece(recording, 0, bounds[middle]), adapter, decode):
            many = middle
        else:
            few = middle + 1
    found = piece(recording, 0, bounds[many])
    if not _fails(found, adapter, decode):
        return recording
    for begin in _beginnings(many):
        shorter = piece(recording, bounds[begin], bounds[many])
        if _fails(shorter, adapter, decode):
            return shorter
    return found


def _fails(recording: Recording, adapter: Adapter, decode: Decode) -> bool:
    figures = judged(recording, adapter, decode)
    return figures.sure_wrong > 0 or figures.found < figures.transactions


def _beginnings(end: int) -> Iterator[int]:
    back = 1
    while back < end:
        yield end - back
        back += 1 if back < NEAREST else back


def _bounds(recording: Recording) -> list[int]:
    """Places at which nothing before belongs to something behind."""
    sent = recording.sent
    bounds, lowest = [len(sent)], len(sent)
    for at in range(len(sent) - 1, -1, -1):
        one = sent[at]
        lowest = min(lowest, at, *(to for to in (one.answers, one.copies) if to is not None))
        if lowest == at and one.role is Role.REQUEST and not one.is_retry:
            bounds.append(at)
    return bounds[::-1]


def piece(recording: Recording, begin: int, end: int) -> Recording:
    """What was sent from one place up to another."""
    chosen = recording.sent[begin:end]
    first = chosen[0].offset
    last = chosen[-1].offset + len(chosen[-1].raw)

    def moved(to: int | None) -> int | None:
        return None if to is None else to - begin

    return replace(
        recording,
        sent=[
            replace(
                one, offset=one.offset - first, answers=moved(one.answers), copies=moved(one.copies)
            )
            for one in chosen
        ],
        data=recording.data[first:last],
        times=recording.times[first:last],
    )


def described(recording: Recording, adapter: Adapter, decode: Decode) -> str:
    """The truth of a recording, a row for each frame, and what is wrong with what was told."""
    start_ns = recording.sent[0].start_ns
    unclear = unknowable(recording, RESOLUTION_NS.get(adapter))
    rows = [f"line {recording.line}, {adapter}; times of first and last bit in ms"]
    for at, one in enumerate(recording.sent):
        begin, end = ((ns - start_ns) / MS for ns in (one.start_ns, one.end_ns))
        belongs = "" if one.answers is None else f" to row {one.answers}"
        note = " doubtful" * (at in unclear.doubtful) + " hidden" * (at in unclear.hidden)
        retry = " (retry)" if one.is_retry else ""
        rows.append(
            f"{at:3} @{one.offset:<5} {begin:10.3f} {end:10.3f}  "
            f"{one.role}{belongs}{retry}{note}: {one.raw.hex(' ')}"
        )
    misses = judged(recording, adapter, decode).misses
    return "\n".join([*rows, *(f"  wrong: {miss}" for miss in misses)])
