"""The counts of a group of transactions."""

from __future__ import annotations

from mbtool.ledger.request_tally import RequestTally
from mbtool.modbus import Outcome
from tests.ledger.requests import request


def test_a_code_of_the_standard_has_its_name_whatever_the_first_manual_calls_it() -> None:
    tally = RequestTally()
    for code, name in ((2, "device address error"), (2, "illegal data address"), (0x11, "range")):
        tally.add(request(0, outcome=Outcome.EXCEPTION, exception=code, exception_name=name))
    assert tally.exception_names == {2: "illegal data address", 0x11: "range"}
