"""The weights, each with its reason, and what they have to be to each other."""

from __future__ import annotations

import ast
from pathlib import Path

from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import SURE
from mbtool.serial_line.bus_state import DOUBT, likelihood

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
    body = ast.parse(Path(costs.__file__).read_text()).body
    reasons = {
        one.targets[0].id: isinstance(after, ast.Expr)
        for one, after in zip(body, [*body[1:], None], strict=True)
        if isinstance(one, ast.Assign) and isinstance(one.targets[0], ast.Name)
    }
    assert {name for name, has_one in reasons.items() if not has_one} == TOLD_BY_ANOTHER


def test_limits_hold_what_is_learned_between_them() -> None:
    for bits, (least, most) in (
        (costs.SKIP, costs.SKIP_LIMITS),
        (costs.GLUED, costs.GLUED_LIMITS),
        (costs.TORN, costs.TORN_LIMITS),
        (costs.NOISE, costs.NOISE_LIMITS),
    ):
        assert 0 < least <= bits <= most
    assert costs.ASKED_AGAIN_LIMITS[0] <= costs.ASKED_AGAIN <= costs.ASKED_AGAIN_LIMITS[1]


def test_answer_that_is_asked_for_is_the_cheapest_of_answers() -> None:
    answers = (
        costs.ANSWER,
        costs.LATE_ANSWER,
        costs.ANSWER_WHEN_LOST,
        costs.LATE_ELSEWHERE,
        costs.ANSWER_AT_START,
        costs.WRONG_ANSWER,
        costs.STRAY_ANSWER,
    )
    assert list(answers) == sorted(answers)


def test_retry_is_likelier_than_an_answer_that_never_came() -> None:
    assert costs.REPEATED_AGAIN < costs.REPEATED < costs.UNANSWERED


def test_stray_bytes_and_the_end_of_a_crc_are_weighed_by_the_line() -> None:
    """The shorter frame and a 00 on a line of many stray bytes, the longer on a clean one."""
    assert costs.NOISE_LIMITS[0] < costs.ENDS_IN_ZERO - costs.ADHERES
    assert costs.ENDS_IN_ZERO < costs.NOISE <= costs.NOISE_LIMITS[1]
    assert likelihood(costs.ENDS_IN_ZERO - costs.NOISE_AT_ONCE) < SURE


def test_lateness_can_make_an_echo_a_retry() -> None:
    retry = costs.REQUEST + costs.REPEATED
    assert retry < costs.ANSWER + costs.MOST_FOR_LATENESS
    assert retry + costs.EARLY_REPEAT > costs.ANSWER + costs.LATE


def test_lateness_alone_makes_no_answer_a_request_that_is_none() -> None:
    """Not even one that was heard before, and the turn is over."""
    request = costs.REQUEST + costs.FITS_AS_ANSWER
    assert likelihood(request - costs.ANSWER - costs.MOST_FOR_LATENESS) >= SURE


def test_crc_that_is_right_outweighs_noise() -> None:
    found = costs.REQUEST + costs.NEW_REQUEST + costs.GLUED_LIMITS[1]
    assert found < costs.COINCIDENCE


def test_doubt_is_wider_than_what_is_called_ambiguous() -> None:
    assert likelihood(DOUBT) > SURE
    assert DOUBT < costs.MARGIN
