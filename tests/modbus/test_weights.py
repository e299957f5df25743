"""The weights, each with its reason, and what they have to be to each other."""

from __future__ import annotations

import ast
from pathlib import Path

from mbtool.modbus import weights
from mbtool.modbus.turn import DOUBT, likelihood
from mbtool.modbus.turns import SURE

TOLD_BY_ANOTHER = {
    "FLIPPED_LIMITS",
    "REPEATED_LIMITS",
    "SKIP_LIMITS",
    "NOISE_LIMITS",
    "GLUED_LIMITS",
    "TORN_LIMITS",
    "ASKED_AGAIN_LIMITS",
    "MOST_FOR_LATENESS",
}


def test_every_weight_has_its_reason() -> None:
    body = ast.parse(Path(weights.__file__).read_text()).body
    reasons = {
        one.targets[0].id: isinstance(after, ast.Expr)
        for one, after in zip(body, [*body[1:], None], strict=True)
        if isinstance(one, ast.Assign) and isinstance(one.targets[0], ast.Name)
    }
    assert {name for name, has_one in reasons.items() if not has_one} == TOLD_BY_ANOTHER


def test_limits_hold_what_is_learned_between_them() -> None:
    for bits, (least, most) in (
        (weights.SKIP, weights.SKIP_LIMITS),
        (weights.GLUED, weights.GLUED_LIMITS),
        (weights.TORN, weights.TORN_LIMITS),
        (weights.NOISE, weights.NOISE_LIMITS),
    ):
        assert 0 < least <= bits <= most
    assert weights.ASKED_AGAIN_LIMITS[0] <= weights.ASKED_AGAIN <= weights.ASKED_AGAIN_LIMITS[1]


def test_answer_that_is_asked_for_is_the_cheapest_of_answers() -> None:
    answers = (
        weights.ANSWER,
        weights.LATE_ANSWER,
        weights.ANSWER_WHEN_LOST,
        weights.LATE_ELSEWHERE,
        weights.ANSWER_AT_START,
        weights.WRONG_ANSWER,
        weights.STRAY_ANSWER,
    )
    assert list(answers) == sorted(answers)


def test_retry_is_likelier_than_an_answer_that_never_came() -> None:
    assert weights.REPEATED_AGAIN < weights.REPEATED < weights.UNANSWERED


def test_stray_bytes_and_the_end_of_a_crc_are_weighed_by_the_line() -> None:
    """The shorter frame and a 00 on a line of many stray bytes, the longer on a clean one."""
    assert weights.NOISE_LIMITS[0] < weights.ENDS_IN_ZERO - weights.ADHERES
    assert weights.ENDS_IN_ZERO < weights.NOISE <= weights.NOISE_LIMITS[1]
    assert likelihood(weights.ENDS_IN_ZERO - weights.NOISE_AT_ONCE) < SURE


def test_lateness_can_make_an_echo_a_retry() -> None:
    retry = weights.REQUEST + weights.REPEATED
    assert retry < weights.ANSWER + weights.MOST_FOR_LATENESS
    assert retry + weights.EARLY_REPEAT > weights.ANSWER + weights.LATE


def test_lateness_alone_makes_no_answer_a_request_that_is_none() -> None:
    """Not even one that was heard before, and the turn is over."""
    request = weights.REQUEST + weights.FITS_AS_ANSWER
    assert likelihood(request - weights.ANSWER - weights.MOST_FOR_LATENESS) >= SURE


def test_crc_that_is_right_outweighs_noise() -> None:
    found = weights.REQUEST + weights.NEW_REQUEST + weights.GLUED_LIMITS[1]
    assert found < weights.COINCIDENCE


def test_doubt_is_wider_than_what_is_called_ambiguous() -> None:
    assert likelihood(DOUBT) > SURE
    assert DOUBT < weights.MARGIN
