"""Which profile fits, or that none does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from mbtool.devices import Access, Area, FunctionRule, Profile, builtin_profiles, load_profile
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.ledger.identification import FITS, UNCONFIRMED, identify
from mbtool.modbus import Outcome, Table, Transport, mbap_adu
from tests.devices.transactions import transaction
from tests.ledger.plant import named
from tests.ledger.polled_devices import polled, stranger

if TYPE_CHECKING:
    from mbtool.ledger.inventory_rows import ProfileFit
    from mbtool.modbus.transaction import Transaction

PROFILES = [load_profile(name) for name in builtin_profiles()]
MODELS = [one for one in PROFILES if one.model_code is not None]


def seen(*transactions: Transaction) -> ProfileFit:
    slave = ObservedSlave("", "10.0.0.7:502", 1)
    for one in transactions:
        slave.note(one)
    return identify(slave, PROFILES)


def on_tcp(function: int, address: int | None = None, **fields: Any) -> Transaction:
    quantity = None if address is None else 1
    return transaction(function, address, quantity=quantity, transport=Transport.TCP, **fields)


@pytest.mark.parametrize("probes", [0, 10, 40])
def test_no_profile_fits_a_device_that_nobody_knows(probes: int) -> None:
    for seed in range(12):
        assert identify(polled(stranger(seed), seed, probes=probes), PROFILES).profile is None


@pytest.mark.parametrize("profile", PROFILES, ids=lambda one: one.name)
def test_a_profile_that_fits_is_the_right_one(profile: Profile) -> None:
    for seed in range(3):
        fit = identify(polled(profile, seed, probes=40), PROFILES)
        assert fit.profile in (None, profile.name)
        assert (fit.score > FITS) == (fit.profile is not None)


@pytest.mark.parametrize("profile", MODELS, ids=lambda one: one.name)
def test_a_model_code_and_answers_that_agree_with_it_are_sure(profile: Profile) -> None:
    fit = identify(polled(profile, 1, model=True), PROFILES)
    assert fit.profile == profile.name
    assert fit.score > FITS
    assert fit.why == "its model code and its answers"


def test_a_model_code_alone_names_nothing() -> None:
    code = on_tcp(0x42, response_raw=mbap_adu(0, 1, bytes.fromhex("42 0016")))
    fit = seen(code, on_tcp(3, 0x102), on_tcp(4, 2))
    assert fit.profile is None
    assert fit.why == "3 different requests are too few to tell which device it is"
    assert not fit.why_names_nearest


def test_a_model_code_that_the_answers_contradict_names_nothing() -> None:
    code = on_tcp(0x42, response_raw=mbap_adu(0, 1, bytes.fromhex("42 0016")))
    fit = seen(code, *(on_tcp(3, 16 + at) for at in range(6)))
    assert fit.profile is None
    assert fit.why == (
        "fa3-at1m8x comes nearest, but only 1 of 7 different requests ended as its manual says; "
        "for example, 03 read holding 16 (RWw10) was answered, but its manual has no such address"
    )
    assert fit.why_names_nearest


def test_what_contradicts_a_profile_is_told_with_both_addresses_and_exceptions() -> None:
    def example(*probes: Transaction) -> str:
        code = on_tcp(0x42, response_raw=mbap_adu(0, 1, bytes.fromhex("42 0016")))
        return seen(code, on_tcp(4, 2), on_tcp(4, 3), *probes).why.partition("for example, ")[2]

    def refused(function: int, address: int, exception: int) -> Transaction:
        return on_tcp(function, address, exception=exception, outcome=Outcome.EXCEPTION)

    assert example(*(refused(2, at, 1) for at in (200, 201))) == (
        "02 read discrete 200 (XC8) was refused with exception 01, but its manual has no such "
        "address, which is exception 02 or 03"
    )
    assert example(*(refused(4, at, 2) for at in (4, 5))) == (
        "04 read input 4 (RWr4) was refused with exception 02, but its manual has that address"
    )
    assert example(*(refused(0x16, at, 2) for at in (200, 201))) == (
        "16 write holding 200 (00C8H) was refused with exception 02, but its manual has no "
        "function 16, which is exception 01"
    )


def test_answers_that_other_devices_would_give_too_are_told_as_such() -> None:
    fit = identify(polled(PROFILES[0], 1), PROFILES)
    assert fit.profile is None
    text = "but they would at other devices, too: nothing shows the model"
    assert text in fit.why or " profiles say: " in fit.why


def test_a_few_polls_that_many_devices_answer_fit_nothing() -> None:
    fit = seen(*(on_tcp(3, address) for address in range(6)))
    assert fit.profile is None
    assert fit.score <= UNCONFIRMED


def test_a_model_s_own_name_confirms_it() -> None:
    table = Table.HOLDING_REGISTERS
    own = Profile(
        name="acme-x100",
        title="ACME X100",
        vendor="ACME",
        transports=[Transport.TCP],
        source="none",
        areas=[Area(name="all", table=table, first=0, last=99, access=Access.READ)],
        functions={"03": FunctionRule(), "2B": FunctionRule()},
    )
    slave = ObservedSlave("", "10.0.0.7:502", 1)
    for address in range(12):
        slave.note(on_tcp(3, address))
    assert identify(slave, [own]).profile is None
    slave.note(named("ACME X100"))
    fit = identify(slave, [own])
    assert (fit.profile, fit.why) == ("acme-x100", "its own name for itself and its answers")


def test_exceptions_alone_are_like_no_profile() -> None:
    fit = seen(*(on_tcp(3, at, exception=4, outcome=Outcome.EXCEPTION) for at in range(6)))
    assert (fit.profile, fit.nearest, fit.score) == (None, None, 0)
