"""How the bytes of a plant come to a decoder."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from tests.benchmarks import adapters

if TYPE_CHECKING:
    from tests.benchmarks.adapters import Read
    from tests.benchmarks.plants.recording import Recording

FLUSH_NS = 200_000_000


class Adapter(StrEnum):
    """What reads a line, and so how the times look."""

    EXACT = "exact"
    """A logic analyser, or a UART without a FIFO."""
    GRID = "1 ms"
    """A USB adapter that is asked each millisecond."""
    FTDI = "FTDI 16 ms"
    """The default of FTDI's driver: each 16 ms, or as soon as there are 62 bytes."""
    BACK = "steps back"
    """A UART whose driver gives one of twenty reads a time 1 to 3 ms too early."""
    BURST_32 = "bursts of 32"
    BURST_62 = "bursts of 62"
    BURST_64 = "bursts of 64"
    """A buffer that is given when it is full, or 255 ms after its first byte."""
    BURST_8K = "bursts of 8 KB"
    """A buffer that is given only when it is full."""
    FLUSHED = "64 or 0.2 s"
    """A program that reads 64 bytes with a timeout of 0.2 s, again and again: it tears frames."""
    NO_TIMES = "no times"
    """A file of bytes."""


RESOLUTION_NS: dict[Adapter, int] = {
    Adapter.EXACT: 0,
    Adapter.GRID: adapters.POLL_NS,
    Adapter.FTDI: adapters.FTDI_TIMER_NS,
}
"""By how much a time may be late; the other adapters hide silences."""


def delivered(recording: Recording, adapter: Adapter) -> list[Read]:
    """The reads that a program makes."""
    data, times = bytes(recording.data), recording.times
    match adapter:
        case Adapter.EXACT:
            return [(data[at : at + 1], times[at]) for at in range(len(data))]
        case Adapter.GRID:
            return list(adapters.by_timer(data, times, adapters.POLL_NS, len(data)))
        case Adapter.FTDI:
            return list(adapters.by_timer(data, times, adapters.FTDI_TIMER_NS, adapters.FTDI_BYTES))
        case Adapter.BACK:
            return list(adapters.with_steps_back(data, times))
        case Adapter.BURST_32 | Adapter.BURST_62 | Adapter.BURST_64:
            return list(adapters.by_count(data, times, int(adapter.rpartition(" ")[2])))
        case Adapter.BURST_8K:
            return list(adapters.by_count(data, times, 8192, flush_ns=None))
        case Adapter.FLUSHED:
            return list(adapters.by_timer(data, times, FLUSH_NS, 64))
        case Adapter.NO_TIMES:
            return list(adapters.untimed(data, times[0], recording.line))
