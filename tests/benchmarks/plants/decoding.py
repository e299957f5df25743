"""Has the decoder read a plant: its class, as other programs use it."""

from __future__ import annotations

from collections import defaultdict, deque
from typing import TYPE_CHECKING

from mbtool.decode.connections import Bus
from mbtool.modbus import Adu, Transaction, Verdict
from tests.benchmarks.plants.delivery import Adapter, delivered
from tests.benchmarks.plants.judging import Told, ToldFrame, ToldTransaction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core import SerialFormat, WireEvent
    from tests.benchmarks.adapters import Read
    from tests.benchmarks.plants.recording import Recording

COPIES = ("echo", "repeated")
"""The kinds of events of frames that come a second time."""


def hear(recording: Recording, adapter: Adapter) -> Told:
    """Decode what an adapter delivers of a recording."""
    reads = delivered(recording, adapter)
    return decode(recording.line, reads, timed=adapter is not Adapter.NO_TIMES)


def decode(line: SerialFormat, reads: Sequence[Read], *, timed: bool) -> Told:
    """Decode with `Bus`."""
    told = Told(transactions=[])
    assert told.transactions is not None
    transactions = []
    places: dict[tuple[bytes, int], deque[int]] = defaultdict(deque)
    offset = 0
    for one in decoded(line, reads, timed=timed):
        if isinstance(one, Transaction):
            transactions.append(one)
            continue
        if isinstance(one, Adu):
            told.frames.append(ToldFrame(offset, one.raw, one.direction, one.confidence))
            places[one.raw, one.end_ns].append(offset)
        elif str(one.kind) in COPIES:
            told.echoes.append(offset)
        offset += len(one.raw)
    # No byte disappears, so all bytes before a frame say where it begins.
    assert offset == sum(len(data) for data, _ in reads), "bytes are missing from what was told"

    def place(raw: bytes | None, end_ns: int | None) -> tuple[int, bytes] | None:
        if raw is None or end_ns is None:
            return None
        return places[raw, end_ns].popleft(), raw

    told.transactions += [
        ToldTransaction(
            place(one.request_raw, one.request_ns),
            place(one.response_raw, one.response_ns),
            one.outcome,
            one.confidence,
            Verdict.AMBIGUOUS in one.verdicts,
        )
        for one in transactions
    ]
    return told


def decoded(
    line: SerialFormat, reads: Sequence[Read], *, timed: bool
) -> list[Adu | Transaction | WireEvent]:
    bus = Bus("line", line, timed=timed)
    told: list[Adu | Transaction | WireEvent] = []
    for data, ts_ns in reads:
        told += bus.feed(data, ts_ns)
    return told + bus.close()
