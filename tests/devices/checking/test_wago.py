from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.devices.checking.responses import WagoRules, is_wago
from mbtool.devices.checking.sliding_window import MAX_ENTRIES
from mbtool.devices.loading import load_profile
from tests.devices.checking.talk import transaction

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction


def found(*transactions: NamedTransaction) -> list[str]:
    rules = WagoRules()
    return [finding.message for one in transactions for finding in rules.transaction(one)]


def failed(*, at_ms: float = 0) -> NamedTransaction:
    return transaction(response="83 04", at_ms=at_ms)


def test_two_failures_in_a_row_are_the_watchdog() -> None:
    assert found(failed(), failed(at_ms=10), failed(at_ms=20)) == [
        "exception 04 to read holding 0, and to the request after it"
    ]


def test_a_single_failure_is_no_finding() -> None:
    assert found(failed(), transaction(), failed(), transaction(response="83 02"), failed()) == []


def test_a_request_without_answer_between_two_failures_changes_nothing() -> None:
    assert len(found(failed(), transaction(response=None), failed())) == 1


def test_each_expiry_of_the_watchdog_is_found() -> None:
    assert len(found(failed(), failed(), transaction(), failed(), failed())) == 2


def test_a_profile_that_extends_the_family_belongs_to_it() -> None:
    wago = load_profile("wago-750")
    assert is_wago(wago)
    assert is_wago(msgspec.structs.replace(wago, name="wago-750-line7"))
    assert not is_wago(load_profile("idec-ft1a-touch"))


def test_memory_is_bounded() -> None:
    rules = WagoRules()
    for number in range(MAX_ENTRIES + 10):
        one = msgspec.structs.replace(failed(), destination=f"10.1.{number}:502")
        assert not [*rules.transaction(one)]
    assert len(rules._couplers) == MAX_ENTRIES
