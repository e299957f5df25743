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


def test_fitting_response_is_the_cheapest_response() -> None:
    responses = (
        costs.RESPONSE,
        costs.LATE_RESPONSE,
        costs.RESPONSE_AFTER_DAMAGE,
        costs.LATE_RESPONSE_TO_OTHER,
        costs.RESPONSE_AT_START,
        costs.MISMATCHED_RESPONSE,
        costs.UNREQUESTED_RESPONSE,
    )
    assert list(responses) == sorted(responses)


def test_retry_is_likelier_than_another_request_without_a_response() -> None:
    assert costs.SECOND_RETRY < costs.RETRY < costs.PREVIOUS_UNANSWERED


def test_frequency_of_stray_bytes_decides_about_a_zero_at_the_end() -> None:
    """On a line of many stray bytes the 00 is one of them; on a clean line it ends the CRC."""
    assert costs.NOISE_LIMITS[0] < costs.ENDS_IN_ZERO - costs.ZERO_BEFORE_SILENCE
    assert costs.ENDS_IN_ZERO < costs.NOISE <= costs.NOISE_LIMITS[1]
    assert confidence_of(costs.ENDS_IN_ZERO - costs.MIN_NOISE_IN_WINDOW) < SURE


def test_lateness_can_make_an_echo_a_retry() -> None:
    retry = costs.REQUEST + costs.RETRY
    assert retry < costs.RESPONSE + costs.MAX_LATENESS
    assert retry + costs.EARLY_REQUEST > costs.RESPONSE + costs.LATE


def test_lateness_alone_makes_no_improbable_request_a_request() -> None:
    """Not even if it was heard before, and the pending request has timed out."""
    request = costs.REQUEST + costs.REQUEST_FITS_PENDING
    assert confidence_of(request - costs.RESPONSE - costs.MAX_LATENESS) >= SURE


def test_correct_crc_outweighs_noise() -> None:
    found = costs.REQUEST + costs.NEW_REQUEST + costs.GLUED_LIMITS[1]
    assert found < costs.CRC_COINCIDENCE


def test_doubt_is_wider_than_ambiguity() -> None:
    assert confidence_of(DOUBT_BITS) > SURE
    assert DOUBT_BITS < costs.BEAM_MARGIN
