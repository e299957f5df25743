"""Cuts the bytes of a link into frames and the bytes between them, and says how each was read."""

# A stream is what one side of a link heard: the bytes of reads of a port, in order. It is given the
# frames that decoding has found, in the order of the line. The place of a frame is known where one
# tap hears the whole line; elsewhere it is where its bytes are found next.
#
# Bytes between frames are cut where the decoder's events about them end; without events, where a
# read ends. No byte is lost: all pieces together are the bytes of the reads.
#
# Memory: the bytes that wait for the rest of a frame: those of SEARCH_NS, at most MAX_WAITING.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.core import Chunk, Connection, Direction, EventKind
    from mbtool.modbus import Transport

SEARCH_NS = 10_000_000_000
"""A frame whose bytes are not found in so many ns of the capture after it is given up."""
MAX_WAITING = 1 << 20


class StreamKey(NamedTuple):
    """What tells the streams of a capture apart."""

    link: str
    direction: Direction
    connection: Connection | None


class WireFrame(NamedTuple):
    """A frame, as decoding has found it."""

    raw: bytes
    is_request: bool
    number: int
    """The number of its transaction in the file, from 1."""
    unit: int
    transport: Transport
    ts_ns: int
    """When it is shown: the end of a request, the beginning of a response."""
    comments: tuple[str, ...] = ()
    is_kept: bool = True
    """False if --start, --end or --where leave it out."""
    begin: int | None = None
    """The number of bytes before it in its stream; None if unknown."""


class SkippedBytes(NamedTuple):
    """What an event says of bytes that are no frame."""

    raw: bytes
    kind: EventKind
    message: str
    ts_ns: int


class WirePiece(NamedTuple):
    """Bytes of a stream: a frame, or bytes between frames."""

    key: StreamKey
    data: bytes
    reads: list[tuple[int, int]]
    """How many of the bytes each read brought, and its time in UTC ns."""
    is_open: bool
    """True if the last read brought bytes of the next piece, too."""
    chunk: Chunk
    """A read that brought bytes of it, for what all reads of the stream have in common."""
    frame: WireFrame | None = None
    skipped: SkippedBytes | None = None

    @property
    def ts_ns(self) -> int:
        """When it is shown, in UTC ns."""
        about = self.frame or self.skipped
        return self.reads[-1][1] if about is None else about.ts_ns


class WireStream:
    """One stream: takes reads, gives pieces."""

    def __init__(
        self, key: StreamKey, frames: Iterable[WireFrame], skipped: Iterable[SkippedBytes] = ()
    ) -> None:
        """Take the frames of the stream in its order, and the events about other bytes."""
        self._key = key
        self._frames = deque(frames)
        self._skipped = deque(skipped)
        self._held = bytearray()
        self._position = 0
        """The number of bytes of the stream before those that are held."""
        self._reads: deque[tuple[int, Chunk]] = deque()
        """Of each read with bytes that are held, how many these are."""

    def feed(self, chunk: Chunk) -> Iterator[WirePiece]:
        """Take a read; give the pieces that are known to be whole."""
        if chunk.data:
            self._held += chunk.data
            self._reads.append((len(chunk.data), chunk))
            yield from self._pieces(chunk.ts_ns)

    def close(self) -> Iterator[WirePiece]:
        """Give the rest."""
        yield from self._pieces(None)

    def _pieces(self, now_ns: int | None) -> Iterator[WirePiece]:
        """Give what is known; `now_ns` is None at the end of the stream."""
        while self._held:
            frame = self._frames[0] if self._frames else None
            if frame is None:
                yield from self._between(len(self._held), is_last=now_ns is None)
                return
            begin = self._begin(frame)
            if begin < 0 or begin + len(frame.raw) > len(self._held):
                if begin > 0:
                    yield from self._between(min(begin, len(self._held)), is_last=False)
                if self._waits_for(frame, now_ns):
                    return
                self._frames.popleft()
                continue
            yield from self._between(begin, is_last=True)
            self._frames.popleft()
            yield self._take(len(frame.raw), frame=frame)

    def _begin(self, frame: WireFrame) -> int:
        """Where a frame begins in the bytes that are held; -1 if that is not known."""
        if frame.begin is None:
            return self._held.find(frame.raw)
        return frame.begin - self._position

    def _waits_for(self, frame: WireFrame, now_ns: int | None) -> bool:
        """True if the bytes of a frame may still come."""
        if now_ns is None:
            return False
        if frame.begin is not None:
            return True
        return now_ns - frame.ts_ns < SEARCH_NS and len(self._held) < MAX_WAITING

    def _between(self, size: int, *, is_last: bool) -> Iterator[WirePiece]:
        """Give bytes that are no frame; unless `is_last`, more of them may follow."""
        while size:
            about = self._skipped[0] if self._skipped else None
            if about is not None and not about.raw.startswith(self._held[: len(about.raw)]):
                about = None
            if about is None:
                piece = min(size, self._reads[0][0])
            elif len(about.raw) <= size:
                self._skipped.popleft()
                piece = len(about.raw)
            elif is_last:
                about, piece = None, min(size, self._reads[0][0])
            else:
                return
            size -= piece
            yield self._take(piece, skipped=about)

    def _take(
        self, size: int, frame: WireFrame | None = None, skipped: SkippedBytes | None = None
    ) -> WirePiece:
        data = bytes(self._held[:size])
        del self._held[:size]
        self._position += size
        reads: list[tuple[int, int]] = []
        is_open = False
        while True:
            left, chunk = self._reads.popleft()
            taken = min(left, size)
            reads.append((taken, chunk.ts_ns))
            size -= taken
            if left > taken:
                self._reads.appendleft((left - taken, chunk))
                is_open = True
            if not size:
                return WirePiece(self._key, data, reads, is_open, chunk, frame, skipped)
