"""What the FA3 modules' own functions 41H to 44H mean (their manual, 10.4)."""

from __future__ import annotations

import pytest

from mbtool.ledger.request_tally import RequestTally
from mbtool.modbus import Outcome
from tests.devices.checking.talk import transaction


@pytest.mark.parametrize(
    ("request_", "response", "codes"),
    [
        ("43 00", "C3 01", ["FA3-C1"]),
        ("43 00", "C3 02", ["FA3-C2"]),
        ("42 00", "C2 02", ["FA3-C2"]),
        ("42 00", "C2 03", ["FA3-C3"]),
        ("44 00", "C4 01", ["FA3-C1"]),
        ("41 00", "C1 01", ["FA3-C1"]),
        ("41 00", "C1 02", ["FA3-C2"]),
        ("41 00", "C1 03", []),  # What a reset that fails has for an answer is not stated.
        ("43 01", "C3 03", ["FA3-D67"]),
        ("43 00", "43 00", []),
        ("41 00", None, []),
    ],
)
def test_an_exception_to_a_request_that_the_manual_fixes_is_wrong(
    request_: str, response: str | None, codes: list[str]
) -> None:
    assert transaction(request_, response, profile="fa3-at1m8x").findings == codes


@pytest.mark.parametrize(
    ("profile", "outcome", "unanswered"),
    [("fa3-th1m16y", Outcome.OK, 0), (None, Outcome.NO_ANSWER, 1)],
)
def test_the_silence_after_a_remote_reset_is_its_success(
    profile: str | None, outcome: Outcome, unanswered: int
) -> None:
    reset = transaction("41 00", None, profile=profile)
    assert reset.outcome is outcome
    tally = RequestTally()
    tally.add(reset)
    assert tally.count(Outcome.NO_ANSWER) == unanswered
