"""Which profile explains a slave."""

from __future__ import annotations

from typing import Any

import pytest

from mbtool.devices.loading import builtin_profiles, load_profile
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.devices.profile_match import (
    MatchResult,
    ProfileMatch,
    match_profiles,
    model_function,
    models_of,
)
from mbtool.modbus import mbap_adu, rtu_adu
from mbtool.modbus.adu import Transport
from mbtool.modbus.transaction import Outcome, Transaction
from tests.devices.transactions import transaction

PROFILES = [load_profile(name) for name in builtin_profiles()]
MODELS = [profile for profile in PROFILES if profile.model_code is not None]


def on_tcp(function: int, address: int | None = None, **fields: Any) -> Transaction:
    ends = {"destination": "192.168.3.250:502", "transport": Transport.TCP, "unit": 0}
    return transaction(function, address, **{**ends, **fields})


def model_answer(code: int) -> Transaction:
    return on_tcp(0x42, response_raw=mbap_adu(0, 0, b"\x42" + code.to_bytes(2)))


def verdict(*transactions: Transaction) -> MatchResult:
    seen = ObservedSlave("line", transactions[0].destination, transactions[0].unit)
    for one in transactions:
        seen.note(one)
    return match_profiles(seen, PROFILES)


def best(found: MatchResult) -> list[str]:
    return [one.profile for one in found.best]


def of(found: MatchResult, name: str) -> ProfileMatch:
    return next(one for one in found.matches if one.profile == name)


@pytest.mark.parametrize("profile", MODELS, ids=lambda profile: profile.name)
def test_a_model_code_decides(profile: Any) -> None:
    assert profile.model_code is not None
    found = verdict(model_answer(profile.model_code), on_tcp(3, 0x0102, response_values=[0]))
    assert best(found) == [profile.name]
    assert found.matches[0].score == 100
    assert f"42H was answered {profile.model_code:04X}H, its model code" in (
        found.matches[0].reasons
    )
    others = [of(found, one.name) for one in MODELS if one is not profile]
    assert [one.score for one in others] == [0] * len(others)
    assert all("and its model code is" in one.against[0] for one in others)


def test_models_without_a_code_are_told_apart_by_their_addresses() -> None:
    digital = {"fa3-th1m16xc", "fa3-th1m16y", "fa3-th1m16ye"}
    analog = {"fa3-at1m8x", "fa3-at1m8y"}
    buffer = on_tcp(3, 0x0120, response_values=[0])
    fields: dict[str, Any] = {"quantity": 16, "request_values": [1] * 16}
    assert set(best(verdict(buffer, on_tcp(15, 0x10, **fields)))) == analog
    refused = on_tcp(15, 0x10, **fields, exception=2, outcome=Outcome.EXCEPTION)
    assert set(best(verdict(buffer, refused))) == digital


def test_names_of_points_are_no_evidence() -> None:
    found = verdict(transaction(3, 205, quantity=3, response_values=[30, 120, 20]))
    assert of(found, "chino-lt830").named == 3
    assert of(found, "idec-ft1a-touch").named == 0
    assert best(found) == ["chino-lt830", "idec-ft1a-smartaxis", "idec-ft1a-touch"]
    assert {of(found, name).score for name in best(found)} == {90}
    (more,) = [on_tcp(3, 0x0102, response_values=[0])]
    assert len(verdict(more).best) >= len(MODELS)  # They all have that buffer memory.


@pytest.mark.parametrize(
    ("fields", "winner"),
    [
        ({"function": 8, "response_raw": rtu_adu(1, bytes(5))}, "chino-lt830"),
        (
            {"function": 3, "address": 1, "quantity": 27, "exception": 3},
            "chino-lt830",
        ),
        (
            {"function": 15, "address": 0, "quantity": 8, "request_values": [1] * 8},
            "idec-ft1a-smartaxis",
        ),
        (
            {"function": 3, "address": 1, "quantity": 65, "response_values": [1] * 65},
            "idec-ft1a-touch",
        ),
        ({"function": 6, "address": 205, "quantity": 1, "exception": 0x11}, "chino-lt830"),
        ({"function": 1, "address": 0, "quantity": 2, "response_values": [1, 1]}, None),
    ],
)
def test_devices_are_distinguished_by_their_differences(
    fields: dict[str, Any], winner: str | None
) -> None:
    if "exception" in fields:
        fields = {**fields, "outcome": Outcome.EXCEPTION}
    other = transaction(fields.pop("function"), fields.pop("address", None), **fields)
    found = verdict(transaction(3, 205, quantity=3, response_values=[1, 2, 3]), other)
    if winner is None:
        assert best(found) == ["idec-ft1a-smartaxis", "idec-ft1a-touch"]
    else:
        assert best(found) == [winner]


def test_a_unit_number_that_is_too_high_counts_against_a_profile() -> None:
    found = verdict(transaction(3, 205, quantity=3, response_values=[1, 2, 3], unit=100))
    assert best(found) == ["idec-ft1a-smartaxis", "idec-ft1a-touch"]
    assert of(found, "chino-lt830").against == ("it can be unit 1 to 99, and this is 100",)
    at_99 = verdict(transaction(3, 205, quantity=3, response_values=[1, 2, 3], unit=99))
    assert "chino-lt830" in best(at_99)


def test_a_refusal_for_another_reason_counts_against_a_profile() -> None:
    lacking = transaction(15, 0, quantity=1, exception=2, outcome=Outcome.EXCEPTION)
    touch = of(verdict(lacking), "idec-ft1a-touch")
    assert (touch.explained, touch.contradicted) == (0, 1)
    assert touch.against == (
        "0F C1 refused with exception 02, though its manual has no function 0F",
    )


def test_a_refused_value_is_no_evidence_about_its_address() -> None:
    refused = on_tcp(6, 0x00F2, quantity=1, exception=3, outcome=Outcome.EXCEPTION)
    model = of(verdict(refused), "fa3-at1m8x")
    assert (model.explained, model.contradicted) == (0, 0)


def test_a_refused_17h_is_no_evidence() -> None:
    fields: dict[str, Any] = {"quantity": 1, "write_address": 3, "outcome": Outcome.EXCEPTION}
    refused = on_tcp(0x17, 0, **fields, request_values=[1] * 101, exception=3)
    wago = of(verdict(refused), "wago-750")
    assert (wago.explained, wago.contradicted) == (0, 0)
    lacking = on_tcp(0x17, 0, **fields, request_values=[1], exception=1)
    assert of(verdict(lacking), "wago-750").against == (
        "17 %IW0 refused, though its manual has that address",
        "17 %QW3 refused, though its manual has that address",
    )


def test_a_write_is_described_in_the_notation_for_writing() -> None:
    bits = on_tcp(15, 0, quantity=257, request_values=[1] * 257)
    assert of(verdict(bits), "wago-750").against[0].startswith("0F DO0..256 answered")


def test_a_match_without_confirmation_says_so() -> None:
    reads = [transaction(1, at, quantity=8, response_values=[1] * 8) for at in range(9)]
    written = transaction(15, 0, quantity=8, request_values=[1] * 8)
    found = verdict(*reads, written)
    assert found.sentence == (
        "explained best by idec-ft1a-smartaxis, though no refusal, model code or name confirms it"
    )
    refused = transaction(3, 5000, quantity=2, exception=2, outcome=Outcome.EXCEPTION)
    assert "confirms" not in verdict(*reads, written, refused).sentence


def test_equal_matches_are_a_tie() -> None:
    found = verdict(transaction(3, 5, quantity=1, response_values=[1]))
    assert len(found.best) > 1
    assert found.sentence == (
        "a tie of chino-lt830, idec-ft1a-smartaxis and idec-ft1a-touch: nothing in one request "
        "tells them apart"
    )


def test_a_predicted_refusal_counts_for_a_profile() -> None:
    found = verdict(
        transaction(3, 0, quantity=4, response_values=[1, 2, 3, 4]),
        transaction(15, 0, quantity=1, exception=1, outcome=Outcome.EXCEPTION),
    )
    assert best(found) == ["idec-ft1a-touch"]
    assert "0F C1 refused, as its manual has no function 0F" in of(found, "idec-ft1a-touch").reasons


def test_an_accepted_request_outside_the_areas_counts_against_a_profile() -> None:
    found = verdict(transaction(3, 60_000, quantity=1, response_values=[1]))
    touch = of(found, "idec-ft1a-touch")
    assert (touch.explained, touch.contradicted) == (0, 1)
    assert touch.against == ("03 HR460001 answered, though its manual has no such address",)


def test_an_undocumented_exception_counts_against_a_profile() -> None:
    busy = transaction(3, 0, quantity=1, exception=0x55, outcome=Outcome.EXCEPTION)
    found = verdict(busy, transaction(3, 1, quantity=1, response_values=[1]))
    assert "exception 55 is none of its manual's" in of(found, "idec-ft1a-touch").against


def test_another_transport_excludes_a_profile_except_behind_a_gateway() -> None:
    on_line = verdict(transaction(3, 0, quantity=1, response_values=[1]))
    assert not of(on_line, "fa3-at1m8x").is_plausible
    reads = [on_tcp(3, at, quantity=1, response_values=[1]) for at in range(4_000, 4_040)]
    behind = of(verdict(*reads), "idec-ft1a-touch")
    assert behind.is_plausible
    assert "only behind a gateway" in behind.against[0]


def test_a_reported_name_counts_for_a_profile() -> None:
    pdu = bytes.fromhex("2b 0e 01 01 00 00 01 00 04") + b"WAGO"
    named = on_tcp(0x2B, response_raw=mbap_adu(1, 0, pdu))
    found = verdict(named, on_tcp(3, 0, quantity=1, response_values=[1]))
    assert found.matches[0].profile == "wago-750"
    assert "it says of itself: vendor 'WAGO'" in found.matches[0].reasons
    assert found.matches[0].score == 50  # 45 as one of two requests is explained, 5 for its name.


def test_missing_responses_are_no_evidence() -> None:
    found = verdict(transaction(3, 0, quantity=1, outcome=Outcome.NO_ANSWER))
    assert found.sentence == "never answered, so nothing tells what it is"
    assert {one.score for one in found.matches} == {0}


def test_a_slave_that_no_profile_explains_is_reported() -> None:
    found = verdict(transaction(0x65, response_raw=rtu_adu(1, b"\x65\x00")))
    assert found.sentence == "none of the profiles explains it"
    assert not found.best


def test_scores_are_between_0_and_100_and_fall() -> None:
    found = verdict(
        transaction(3, 0, quantity=4, response_values=[1, 2, 3, 4]),
        transaction(1, 0, quantity=200, response_values=[1] * 200),
        transaction(16, 0, quantity=2, request_values=[1, 2]),
    )
    assert all(0 <= one.score <= 100 for one in found.matches)
    assert [one.rank for one in found.matches] == sorted(
        (one.rank for one in found.matches), reverse=True
    )


def test_the_models_of_all_profiles_are_found_by_their_codes() -> None:
    models = models_of(PROFILES)
    assert {code: profile.model_code for (_, code), profile in models.items()} == {
        code: code for code in (0x13, 0x14, 0x15, 0x16, 0x17)
    }
    assert {function for function, _ in models} == {0x42}
    assert model_function(load_profile("idec-ft1a-touch")) is None
