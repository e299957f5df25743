"""The costs: each states its reason, and they keep their order."""

from __future__ import annotations

import ast
from pathlib import Path

from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import SURE
from mbtool.serial_line.bus_state import DOUBT_BITS, confidence_of


def test_every_cost_has_its_reason() -> None:
    body = ast.parse(Path(costs.__file__).read_text()).body
    reasons = {
        one.targets[0].id: isinstance(after, ast.Expr)
        for one, after in zip(body, [*body[1:], None], strict=True)
        if isinstance(one, ast.Assign) and isinstance(one.targets[0], ast.Name)
    }
    assert [name for name, has_one in reasons.items() if not has_one] == []


def test_limits_hold_what_is_learned_between_them() -> None:
    for bits, (least, most) in (
        (costs.SKIP, costs.SKIP_LIMITS),
        (costs.GLUED, costs.GLUED_LIMITS),
        (costs.SPLIT, costs.SPLIT_LIMITS),
        (costs.NOISE, costs.NOISE_LIMITS),
    ):
        assert 0 < least <= bits <= most
    assert (
        costs.REPEAT_AFTER_RESPONSE_LIMITS[0]
        <= costs.REPEAT_AFTER_RESPONSE
        <= costs.REPEAT_AFTER_RESPONSE_LIMITS[1]
    )


def test_answer_that_is_asked_for_is_the_cheapest_of_answers() -> None:
    answers = (
        costs.RESPONSE,
        costs.LATE_RESPONSE,
        costs.RESPONSE_AFTER_DAMAGE,
        costs.LATE_RESPONSE_TO_OTHER,
        costs.RESPONSE_AT_START,
        costs.MISMATCHED_RESPONSE,
        costs.UNREQUESTED_RESPONSE,
    )
    assert list(answers) == sorted(answers)


def test_retry_is_likelier_than_an_answer_that_never_came() -> None:
    assert costs.SECOND_RETRY < costs.RETRY < costs.PREVIOUS_UNANSWERED


def test_stray_bytes_and_the_end_of_a_crc_are_weighed_by_the_line() -> None:
    """The shorter frame and a 00 on a line of many stray bytes, the longer on a clean one."""
    assert costs.NOISE_LIMITS[0] < costs.ENDS_IN_ZERO - costs.ZERO_BEFORE_SILENCE
    assert costs.ENDS_IN_ZERO < costs.NOISE <= costs.NOISE_LIMITS[1]
    assert confidence_of(costs.ENDS_IN_ZERO - costs.MIN_NOISE_IN_WINDOW) < SURE


def test_lateness_can_make_an_echo_a_retry() -> None:
    retry = costs.REQUEST + costs.RETRY
    assert retry < costs.RESPONSE + costs.MAX_LATENESS
    assert retry + costs.EARLY_REQUEST > costs.RESPONSE + costs.LATE


def test_lateness_alone_makes_no_answer_a_request_that_is_none() -> None:
    """Not even one that was heard before, and the turn is over."""
    request = costs.REQUEST + costs.REQUEST_FITS_PENDING
    assert confidence_of(request - costs.RESPONSE - costs.MAX_LATENESS) >= SURE


def test_crc_that_is_right_outweighs_noise() -> None:
    found = costs.REQUEST + costs.NEW_REQUEST + costs.GLUED_LIMITS[1]
    assert found < costs.CRC_COINCIDENCE


def test_doubt_is_wider_than_what_is_called_ambiguous() -> None:
    assert confidence_of(DOUBT_BITS) > SURE
    assert DOUBT_BITS < costs.BEAM_MARGIN
