"""Paths of segments, and the confidence of each segment."""

from __future__ import annotations

from mbtool.core import Direction
from mbtool.serial_line.bus_state import DOUBT_BITS, BusState
from mbtool.serial_line.paths import (
    Path,
    Segment,
    SegmentKind,
    merge_skipped,
    settled_segments,
    with_confidence,
)

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
EMPTY = Path(0.0, BusState(), None, None)


def frame(place: int, size: int = 8, role: Direction = REQUEST) -> Segment:
    return Segment(SegmentKind.FRAME, place, size, role)


def skipped(place: int, size: int = 1) -> Segment:
    return Segment(SegmentKind.SKIPPED, place, size)


def path(before: Path, segment: Segment, cost: float) -> Path:
    return Path(before.cost + cost, BusState(), before, segment)


def test_adjacent_skipped_bytes_are_one_segment() -> None:
    segments = [skipped(0), skipped(1), frame(2), skipped(10), skipped(11), skipped(12)]
    assert list(merge_skipped(segments)) == [skipped(0, 2), frame(2), skipped(10, 3)]
    assert list(merge_skipped([])) == []


def test_segments_of_the_only_path_are_sure() -> None:
    end = path(path(EMPTY, frame(0), 1.0), frame(8), 1.0)
    assert [segment.confidence for segment in with_confidence([end])] == [1.0, 1.0]


def test_path_nearly_as_cheap_raises_doubt_where_it_differs() -> None:
    common = path(EMPTY, frame(0), 1.0)
    ends = [path(common, frame(8), 1.0), path(common, frame(8, role=RESPONSE), 2.0)]
    first, second = with_confidence(ends)
    assert first.confidence == 1.0
    assert 0.6 < second.confidence < 0.7


def test_path_that_costs_far_more_raises_no_doubt() -> None:
    ends = [path(EMPTY, frame(0), 1.0), path(EMPTY, frame(0, role=RESPONSE), 1.0 + DOUBT_BITS)]
    assert [segment.confidence for segment in with_confidence(ends)] == [1.0]


def test_rival_of_a_partial_path_raises_doubt_too() -> None:
    met = path(EMPTY, frame(0), 1.0)
    met.rivals = (path(EMPTY, frame(0, role=RESPONSE), 1.0),)
    first, second = with_confidence([path(met, frame(8), 1.0)])
    assert (first.confidence, second.confidence) == (0.5, 1.0)


def test_segments_common_to_both_paths_are_settled_and_the_rest_is_incomplete() -> None:
    common = path(EMPTY, frame(0), 1.0)
    incomplete = path(common, Segment(SegmentKind.INCOMPLETE, 8, 4), 0.5)
    end = path(common, skipped(8, 4), 6.0)
    assert settled_segments([end], incomplete, 12) == [
        frame(0),
        Segment(SegmentKind.INCOMPLETE, 8, 4),
    ]


def test_settled_segments_have_the_confidence_of_the_incomplete_path() -> None:
    """A frame is more likely if the bytes after it begin another one."""
    common = path(EMPTY, frame(0), 10.0)
    incomplete = path(common, Segment(SegmentKind.INCOMPLETE, 8, 4), 0.5)
    ends = [path(common, skipped(8, 4), 8.0), path(EMPTY, skipped(0, 12), 18.1)]
    assert next(with_confidence(ends)).confidence < 0.6
    assert settled_segments(ends, incomplete, 12)[0].confidence > 0.99


def test_skipped_bytes_before_an_incomplete_frame_are_not_settled() -> None:
    noise = path(path(EMPTY, frame(0), 1.0), skipped(8), 1.0)
    incomplete = path(noise, Segment(SegmentKind.INCOMPLETE, 9, 3), 0.5)
    end = path(path(path(noise, skipped(9), 2.0), skipped(10), 2.0), skipped(11), 2.0)
    assert settled_segments([end], incomplete, 12) == [
        frame(0),
        Segment(SegmentKind.INCOMPLETE, 8, 4),
    ]


def test_without_a_common_segment_everything_is_incomplete() -> None:
    incomplete = path(EMPTY, Segment(SegmentKind.INCOMPLETE, 0, 5), 0.5)
    nothing_settled = [Segment(SegmentKind.INCOMPLETE, 0, 5)]
    assert settled_segments([path(EMPTY, skipped(0, 5), 9.0)], incomplete, 5) == nothing_settled
    assert settled_segments([], incomplete, 5) == nothing_settled
