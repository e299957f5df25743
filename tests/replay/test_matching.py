"""Each way to find an answer, by script."""

from __future__ import annotations

import pytest

from mbtool.replay.matching import (
    ImageMatcher,
    KeyMatcher,
    Matcher,
    MatchStrategy,
    Moment,
    NoAnswer,
    OnEnd,
    SequenceMatcher,
    TimeMatcher,
    matcher_for,
)
from mbtool.replay.recording import Recording
from tests.replay.recorded import MS, answered, unanswered

READ, OTHER = "03 0000 0001", "03 0005 0001"
NOW = Moment(0)
PAUSED = Moment(0, is_paused=True)


def _recording() -> Recording:
    return Recording.of(
        [
            answered(0, READ, "03 02 0001"),
            answered(100, OTHER, "03 02 0009"),
            answered(200, READ, "03 02 0002"),
            unanswered(300, READ),
        ]
    )


def _find(matcher: Matcher, request: str, moment: Moment = NOW) -> int | str | None:
    """The last byte of the answer, None for a recorded silence, or the word."""
    found = matcher.find((1, bytes.fromhex(request)), moment)
    if isinstance(found, NoAnswer):
        return found.value
    pdu = found.answer.pdu
    return pdu[-1] if pdu is not None else None


@pytest.mark.parametrize(
    ("on_end", "then"),
    [
        (OnEnd.LAST, [2, 2]),
        (OnEnd.LOOP, [1, 2]),
        (OnEnd.IMAGE, ["image", "image"]),
        (OnEnd.SILENT, ["silence", "silence"]),
    ],
)
def test_by_key_each_request_has_an_end_of_its_own(on_end: OnEnd, then: list[object]) -> None:
    matcher = KeyMatcher(_recording(), on_end)
    assert [_find(matcher, READ) for _ in range(5)] == [1, 2, None, *then]
    assert _find(matcher, OTHER) == 9
    assert _find(matcher, "03 0000 0002") == "miss"


def test_in_sequence_only_the_next_request_is_answered() -> None:
    matcher = SequenceMatcher(_recording(), OnEnd.LAST)
    assert _find(matcher, OTHER) == "miss"
    assert _find(matcher, READ) == 1
    assert _find(matcher, READ) == "miss"
    assert [_find(matcher, each) for each in (OTHER, READ, READ)] == [9, 2, None]


@pytest.mark.parametrize(
    ("on_end", "then"),
    [
        (OnEnd.LAST, [2, 9, "miss"]),
        (OnEnd.LOOP, [1, 9, "miss"]),
        (OnEnd.IMAGE, ["image", "image", "miss"]),
        (OnEnd.SILENT, ["silence", "silence", "miss"]),
    ],
)
def test_a_sequence_ends_for_all_at_once(on_end: OnEnd, then: list[object]) -> None:
    matcher = SequenceMatcher(_recording(), on_end)
    for each in (READ, OTHER, READ, READ):
        _find(matcher, each)
    assert [_find(matcher, each) for each in (READ, OTHER, "03 0000 0002")] == then


@pytest.mark.parametrize(
    ("at_ms", "value"), [(0, 1), (99, 1), (100, 1), (101, 2), (200, 2), (251, None), (999, None)]
)
def test_by_time_the_nearest_answer_counts(at_ms: int, value: int | None) -> None:
    assert _find(TimeMatcher(_recording(), OnEnd.LAST), READ, Moment(at_ms * MS)) == value


def test_by_time_a_similar_request_gets_the_image_the_exception_or_the_silence() -> None:
    recording = Recording.of(
        [
            answered(0, "03 0000 0004", "03 08 0001 0002 0003 0004"),
            answered(100, "03 0000 0004", "83 06"),
            unanswered(200, "03 0000 0004"),
            answered(200, "06 0009 0001", "06 0009 0001"),
        ]
    )
    matcher = TimeMatcher(recording, OnEnd.LAST)
    found = [_find(matcher, "03 0000 0002", Moment(at * MS)) for at in (0, 100, 200)]
    assert found == ["image", 6, None]
    assert _find(matcher, "06 0009 0007") == "image"
    assert _find(matcher, "06 0008 0007") == "miss"
    assert _find(matcher, "2B 0E 01 00") == "miss"


@pytest.mark.parametrize(
    ("on_end", "then"), [(OnEnd.IMAGE, "image"), (OnEnd.SILENT, "silence"), (OnEnd.LAST, None)]
)
def test_by_time_the_end_is_that_of_the_clock(on_end: OnEnd, then: str | None) -> None:
    matcher = TimeMatcher(_recording(), on_end)
    assert _find(matcher, READ, Moment(999 * MS, is_over=True)) == then


def test_the_image_answers_requests_for_registers_and_others_go_by_key() -> None:
    recording = Recording.of([answered(0, READ, "83 02"), answered(1, "11", "11 02 05 FF")])
    matcher = ImageMatcher(recording, OnEnd.SILENT)
    assert _find(matcher, READ) == "image"
    assert _find(matcher, "11") == 0xFF
    assert _find(matcher, READ, Moment(0, is_over=True)) == "silence"
    assert _find(ImageMatcher(recording, OnEnd.LAST), READ, Moment(0, is_over=True)) == "image"


@pytest.mark.parametrize("matcher", [KeyMatcher, SequenceMatcher])
def test_in_a_pause_the_last_answer_is_repeated(
    matcher: type[KeyMatcher | SequenceMatcher],
) -> None:
    played = matcher(_recording(), OnEnd.LAST)
    assert _find(played, READ) == 1
    assert [_find(played, READ, PAUSED) for _ in range(3)] == [1, 1, 1]
    assert _find(played, OTHER) == 9
    assert _find(played, READ) == 2


def test_each_match_strategy_has_a_matcher() -> None:
    kinds = {match: type(matcher_for(match, _recording(), OnEnd.LAST)) for match in MatchStrategy}
    assert kinds == {
        MatchStrategy.AUTO: KeyMatcher,
        MatchStrategy.KEY: KeyMatcher,
        MatchStrategy.SEQUENCE: SequenceMatcher,
        MatchStrategy.TIME: TimeMatcher,
        MatchStrategy.IMAGE: ImageMatcher,
    }
    assert [match for match in MatchStrategy if match.by_clock] == [
        MatchStrategy.TIME,
        MatchStrategy.IMAGE,
    ]


@pytest.mark.parametrize("match", list(MatchStrategy))
@pytest.mark.parametrize("request_", [b"", b"\x03", b"\x83\x02", bytes(253)])
def test_invalid_requests_have_no_recorded_answer(match: MatchStrategy, request_: bytes) -> None:
    found = matcher_for(match, _recording(), OnEnd.LAST).find((1, request_), NOW)
    assert found in (NoAnswer.MISS, NoAnswer.IMAGE)
