"""Paths (explanations of the bytes of an RTU window), and the confidence of each segment."""

# A path is a linked list of segments: each path knows its last segment and the path before it, so
# that paths share their common beginning. If several paths reach the same offset in the same bus
# state, only the cheapest is continued. Paths that cost almost as little are kept with it as
# rivals; they lower the confidence of the segments that they do not contain.

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import StrEnum
from itertools import groupby, takewhile

import msgspec
from msgspec.structs import replace

from mbtool.core import Direction
from mbtool.serial_line.bus_state import DOUBT_BITS, BusState, confidence_of


class SegmentKind(StrEnum):
    """The meaning that a path gives to the bytes of a segment."""

    FRAME = "frame"
    DAMAGED = "damaged"
    SKIPPED = "skipped"
    INCOMPLETE = "incomplete"


class Segment(msgspec.Struct, frozen=True, gc=False):
    """Consecutive bytes of the window with one meaning, such as a frame."""

    kind: SegmentKind
    offset: int
    size: int
    role: Direction = Direction.UNKNOWN
    roles: tuple[Direction, ...] = ()
    """The directions that the frame can have by its function and size; empty if it is no frame."""
    repaired: bytes = b""
    """A damaged frame as it was sent, if one wrong bit explains the damage; empty otherwise."""
    confidence: float = 1.0
    """The probability that no other path explains these bytes better."""

    @property
    def identity(self) -> tuple[SegmentKind, int, int, Direction]:
        """The segment's kind, offset, size and direction: all but its confidence."""
        return self.kind, self.offset, self.size, self.role


class Path(msgspec.Struct, eq=False):
    """A chain of segments from the first byte of the window to an offset, with its cost in bits."""

    cost: float
    state: BusState
    previous: Path | None
    segment: Segment | None
    skipped: int = 0
    """The number of skipped bytes in a row at the end of the path."""
    is_noise: bool = False
    """True if the bytes skipped at the end of the path directly follow a frame and are all noise,
    as receivers hear it when the bus changes direction."""
    runs: int = 0
    """The number of times that the path skips bytes, bytes in a row counted once. A line that has
    skipped bytes probably has more, so each time lowers the cost of the next by one bit."""
    ends_frame: bool = False
    """True if the path ends with a frame, so that another frame probably begins behind it."""
    rivals: tuple[Path, ...] = ()
    """Paths to the same offset and bus state that cost more and were dropped in favour of this one.
    Rivals that cost less than DOUBT_BITS more lower the confidence of its segments."""

    @property
    def end(self) -> int:
        """The offset in the window at which the path ends."""
        return self.segment.offset + self.segment.size if self.segment is not None else 0


def with_confidence(ends: list[Path]) -> Iterator[Segment]:
    """Yield the segments of the first and cheapest path of `ends`, in order.

    A frame has less confidence if it is missing in a path that costs little more.
    """
    best = list(_chain(ends[0]))
    known = {id(one) for one in best}
    doubts: dict[int, float] = {}
    for path in best:
        for rival in path.rivals if path is not ends[0] else (*path.rivals, *ends[1:]):
            more = rival.cost - path.cost
            if more < DOUBT_BITS:
                for offset in _differences(known, path, rival):
                    doubts[offset] = min(doubts.get(offset, 1.0), confidence_of(more))
    for path in reversed(best):
        segment = path.segment
        if segment is not None:
            doubt = doubts.get(segment.offset) if segment.kind is SegmentKind.FRAME else None
            yield segment if doubt is None else replace(segment, confidence=doubt)


def as_doubtful(segment: Segment) -> Segment:
    """Return the segment with a confidence of at most 0.5, so that its frame is ambiguous."""
    return replace(segment, confidence=min(segment.confidence, 0.5))


def _chain(end: Path) -> Iterator[Path]:
    """Yield a path, the path before it, and so on back to the first."""
    path: Path | None = end
    while path is not None:
        yield path
        path = path.previous


def common_end(ends: list[Path]) -> int:
    """Return the offset behind the last frame up to which all paths are the same; 0 if none is."""
    common = list(_chain(ends[0])) if ends else []
    for path in ends[1:]:
        known = {id(one) for one in _chain(path)}
        common = [one for one in common if id(one) in known]
    return next((one.end for one in common if one.ends_frame), 0)


def settled_segments(ends: list[Path], incomplete: Path, end: int) -> list[Segment]:
    """Return the first segments of the cheapest path that the second cheapest path also has.

    `incomplete` is the cheapest path; it ends in an incomplete frame. The others are in `ends`, the
    cheapest first. All bytes behind the returned segments, up to the offset `end`, become one
    incomplete segment.
    """
    other = {one.identity for one in merge_skipped(with_confidence(ends))} if ends else set()
    segments = merge_skipped(with_confidence([incomplete, *ends]))
    settled = list(takewhile(lambda segment: segment.identity in other, segments))
    while settled and settled[-1].kind is SegmentKind.SKIPPED:
        settled.pop()  # More skipped bytes may follow.
    offset = settled[-1].offset + settled[-1].size if settled else 0
    return [*settled, Segment(SegmentKind.INCOMPLETE, offset, end - offset)]


def _differences(known: set[int], path: Path, rival: Path) -> list[int]:
    """Return the offsets of the segments that `path` contains and its `rival` does not.

    `known` are the ids of the cheapest path and all paths before it, `path` among them. The
    beginning that `path` and `rival` have in common is left out.
    """
    others = set()
    for other in _chain(rival):
        if id(other) in known:
            common = other
            break
        others.add(other.segment)
    differing = takewhile(lambda one: one is not common, _chain(path))
    return [one.segment.offset for one in differing if one.segment and one.segment not in others]


def merge_skipped(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Yield the segments, with skipped bytes in a row joined into one segment."""
    for kind, group in groupby(segments, key=lambda segment: segment.kind):
        if kind is SegmentKind.SKIPPED:
            first = next(group)
            yield Segment(kind, first.offset, first.size + sum(segment.size for segment in group))
        else:
            yield from group
