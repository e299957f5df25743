"""Ways to feed the same bytes: whole, byte by byte, in cuts, with trailing bytes, two in a row."""

# A stream's bytes may all have one time. On a line each byte has its own, when its last bit
# arrived, and a read has the time of its last byte: so a read can be cut anywhere, but never holds
# a silence.

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain, repeat
from typing import TYPE_CHECKING, Protocol, TypeVar

from mbtool.core import SerialFormat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

Event = TypeVar("Event")
Read = tuple[bytes, int]
"""Bytes and the time of the last of them."""

START_NS = 1_700_000_000_000_000_000


class Feedable(Protocol[Event]):
    """Any splitter, and Bus."""

    def feed(self, data: bytes, ts_ns: int) -> list[Event]: ...

    def close(self) -> list[Event]: ...


class Advancing(Feedable[Event], Protocol[Event]):
    """What listens on a line."""

    def advance(self, now_ns: int) -> list[Event]: ...


def feed_all(fed: Feedable[Event], reads: Iterable[Read]) -> list[Event]:
    """Feed reads in order and close."""
    events: list[Event] = []
    for data, ts_ns in reads:
        events += fed.feed(data, ts_ns)
    return events + fed.close()


def pieces(data: bytes, sizes: Iterable[int]) -> Iterator[bytes]:
    """Cut bytes into pieces of the given sizes; what they leave is the last piece."""
    for size in sizes:
        if not data:
            return
        yield data[:size]
        data = data[size:]
    if data:
        yield data


def whole(fed: Feedable[Event], data: bytes, ts_ns: int = START_NS) -> list[Event]:
    return feed_all(fed, [(data, ts_ns)])


def byte_by_byte(fed: Feedable[Event], data: bytes, ts_ns: int = START_NS) -> list[Event]:
    return feed_all(fed, [(bytes([byte]), ts_ns) for byte in data])


def in_cuts(
    fed: Feedable[Event], data: bytes, sizes: Iterable[int], ts_ns: int = START_NS
) -> list[Event]:
    return feed_all(fed, [(piece, ts_ns) for piece in pieces(data, sizes)])


def every_way(make: Callable[[], Feedable[Event]], data: bytes) -> list[Event]:
    """Feed a stream whole, byte by byte and in threes, and say what came out, the same each way."""
    events = whole(make(), data)
    assert byte_by_byte(make(), data) == events
    assert in_cuts(make(), data, repeat(3)) == events
    return events


@dataclass
class Line:
    """Writes down what a tap hears: bytes and silences."""

    format: SerialFormat
    now_ns: int = START_NS
    """When the last byte ended."""
    bytes_: list[tuple[int, int]] = field(default_factory=list)
    """Each byte and its time."""

    @property
    def data(self) -> bytes:
        return bytes(byte for byte, _ in self.bytes_)

    def silence(self, silence_ns: int) -> Line:
        self.now_ns += silence_ns
        return self

    def send(self, data: bytes) -> Line:
        for byte in data:
            self.now_ns += self.format.character_ns
            self.bytes_.append((byte, self.now_ns))
        return self

    def frame(self, data: bytes, before_ns: int | None = None) -> Line:
        """Bytes behind a silence, twice t3.5 where nothing else is said."""
        return self.silence(2 * self.format.t3_5_ns if before_ns is None else before_ns).send(data)

    def reads(self, sizes: Iterable[int] = ()) -> list[Read]:
        """The line as reads: cut at every silence, and into the given sizes as far as they go."""
        sizes = chain(sizes, repeat(1 << 20))
        return [
            (bytes(byte for byte, _ in part), part[-1][1])
            for burst in self._bursts()
            for part in _cut(burst, sizes)
        ]

    def silences(self) -> list[tuple[int, int]]:
        """From when to when nobody spoke, ends included."""
        return [
            (burst[-1][1], following[0][1] - self.format.character_ns)
            for burst, following in zip(self._bursts(), self._bursts()[1:], strict=False)
        ]

    def _bursts(self) -> list[list[tuple[int, int]]]:
        bursts: list[list[tuple[int, int]]] = []
        for byte, ts_ns in self.bytes_:
            if bursts and ts_ns - bursts[-1][-1][1] == self.format.character_ns:
                bursts[-1].append((byte, ts_ns))
            else:
                bursts.append([(byte, ts_ns)])
        return bursts


def _cut(
    burst: Sequence[tuple[int, int]], sizes: Iterator[int]
) -> Iterator[Sequence[tuple[int, int]]]:
    while burst:
        size = next(sizes)
        yield burst[:size]
        burst = burst[size:]
