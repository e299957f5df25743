"""Cuts the captured bytes of a link into frames and the bytes between frames, for `convert`."""

# A stream is the bytes that one tap heard, or one direction of a TCP connection, in the order of
# the reads of its port. The caller also gives the frames that were decoded from it, in their order.
# The position of a frame in the stream is known if one tap hears the whole line. Otherwise the
# frame's bytes are searched in the stream.
#
# The bytes between frames are cut where the bytes of the decoder's events about them end, or, if
# there is no event, where a read ends. No byte is lost: all pieces together are all bytes read.
#
# Memory: the bytes of an incomplete frame; while a frame is searched, the bytes of SEARCH_NS, at
# most MAX_WAITING bytes.

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Chunk, Connection, Direction, EventKind

if TYPE_CHECKING:
    from mbtool.modbus import Transport

SEARCH_NS = 10_000_000_000
"""The search for the bytes of a frame ends when the stream has a read this much (ns) later than the
frame."""
MAX_WAITING = 1 << 20


class StreamKey(NamedTuple):
    """Identifies a stream of bytes in a capture: its link, its direction (UNKNOWN if one tap hears
    both), and its TCP connection (None on a serial line).
    """

    link: str
    direction: Direction
    connection: Connection | None


class WireFrame(NamedTuple):
    """A frame that decoding has found, with facts about it from its transaction."""

    raw: bytes
    is_request: bool
    number: int
    """The number of the frame's transaction in the output, from 1."""
    unit: int
    transport: Transport
    ts_ns: int
    """The time (UTC ns) that the frame gets in the output: the end of a request, the beginning of a
    response."""
    comments: tuple[str, ...] = ()
    is_kept: bool = True
    """False if the options --start, --end or --where exclude the frame's transaction."""
    begin: int | None = None
    """The number of bytes of the stream before the frame; None if it is unknown, so that the
    frame's bytes must be searched."""


class SkippedBytes(NamedTuple):
    """Bytes that belong to no frame, with the kind, the message and the time (UTC ns) of the event
    about them.
    """

    raw: bytes
    kind: EventKind
    message: str
    ts_ns: int


class WirePiece(NamedTuple):
    """Consecutive bytes of a stream: one frame, or bytes between frames."""

    key: StreamKey
    data: bytes
    reads: list[tuple[int, int]]
    """For each read of the port that returned bytes of this piece: the number of these bytes, and
    the time of the read (UTC ns)."""
    is_open: bool
    """True if the last read in `reads` also returned bytes of the next piece."""
    chunk: Chunk
    """The last of these reads. It has the fields that all reads of the stream share, such as the
    direction."""
    frame: WireFrame | None = None
    skipped: SkippedBytes | None = None

    @property
    def ts_ns(self) -> int:
        """The time of the piece (UTC ns): that of its frame, or of the event about its bytes, or
        else of its last read.
        """
        about = self.frame or self.skipped
        return self.reads[-1][1] if about is None else about.ts_ns


class WireStream:
    """Cuts one stream of bytes: takes the reads of a port, and yields the frames and the bytes
    between them.
    """

    def __init__(
        self, key: StreamKey, frames: Iterable[WireFrame], skipped: Iterable[SkippedBytes] = ()
    ) -> None:
        """`frames` are the frames in the stream, and `skipped` the bytes that events are about;
        both in the order of the stream.
        """
        self._key = key
        self._frames = deque(frames)
        self._skipped = deque(skipped)
        self._held = bytearray()
        self._position = 0
        """The number of bytes of the stream that were yielded. The bytes in `_held` come behind
        them."""
        self._reads: deque[tuple[int, Chunk]] = deque()
        """For each read that has bytes in `_held`: the number of these bytes, and the read
        itself."""

    def feed(self, chunk: Chunk) -> Iterator[WirePiece]:
        """Take the bytes of a read; yield the pieces that later reads cannot change any more."""
        if chunk.data:
            self._held += chunk.data
            self._reads.append((len(chunk.data), chunk))
            yield from self._pieces(chunk.ts_ns)

    def close(self) -> Iterator[WirePiece]:
        """End the stream: yield all bytes that are left as pieces."""
        yield from self._pieces(None)

    def _pieces(self, now_ns: int | None) -> Iterator[WirePiece]:
        """Yield the pieces that later reads cannot change any more.

        `now_ns` is the time (UTC ns) of the last read; None at the end of the stream.
        """
        while self._held:
            frame = self._frames[0] if self._frames else None
            if frame is None:
                yield from self._pieces_without_frame(len(self._held), is_last=now_ns is None)
                return
            begin = self._begin(frame)
            if begin < 0 or begin + len(frame.raw) > len(self._held):
                if begin > 0:
                    yield from self._pieces_without_frame(
                        min(begin, len(self._held)), is_last=False
                    )
                if self._waits_for(frame, now_ns):
                    return
                self._frames.popleft()
                continue
            yield from self._pieces_without_frame(begin, is_last=True)
            self._frames.popleft()
            yield self._take(len(frame.raw), frame=frame)

    def _begin(self, frame: WireFrame) -> int:
        """The index in `_held` at which the frame begins.

        It is negative if the frame's bytes are not found, or were already yielded.
        """
        if frame.begin is None:
            return self._held.find(frame.raw)
        return frame.begin - self._position

    def _waits_for(self, frame: WireFrame, now_ns: int | None) -> bool:
        """True if bytes of the frame that are missing may still come with a later read.

        `now_ns` is the time (UTC ns) of the last read; None at the end of the stream.
        """
        if now_ns is None:
            return False
        if frame.begin is not None:
            return True
        return now_ns - frame.ts_ns < SEARCH_NS and len(self._held) < MAX_WAITING

    def _pieces_without_frame(self, size: int, *, is_last: bool) -> Iterator[WirePiece]:
        """Yield the first `size` bytes in `_held` as pieces that are no frame.

        If `is_last` is False, more bytes that are no frame may follow. Then the last of the `size`
        bytes are kept if they may be the beginning of the bytes of one event.
        """
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
