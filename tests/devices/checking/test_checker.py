from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.checker import Checker
from mbtool.devices.checking.rules import rule_of
from mbtool.devices.loading import builtin_profiles
from mbtool.modbus.adu import Transport, Verdict
from mbtool.modbus.transaction import Outcome
from tests.devices.checking.talk import (
    LINE,
    LINK,
    MASTER,
    SLAVE,
    START_NS,
    assigned,
    event,
    named_by,
    opened,
    transaction,
)
from tests.devices.transactions import transaction as bare

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.devices.named_transaction import NamedTransaction

FOREIGN_MESSAGE = bytes.fromhex("0001 0001 0006 01 03 0000 0001")


def codes(*records: NamedTransaction | WireEvent, profile: str | None = None) -> list[str]:
    checker = Checker(CaptureContext(assigned(profile), lambda _: SerialFormat(19200)))
    found = [one for record in records for one in checker.feed(record)]
    return [one.code for one in (*found, *checker.close())]


def test_all_kinds_of_rules_are_checked() -> None:
    assert codes(transaction("05 0000 0001", "85 03")) == ["MB-103"]
    assert codes(transaction(), transaction("", "83 02")) == ["MB-403"]
    assert codes(transaction(), event(EventKind.OVERLAP)) == ["TCP-203"]
    assert codes(transaction("03 0000 0001", None, unit=0, on_a_line=True)) == ["MB-302"]
    polls = [transaction(at_ms=100 * at + 80 * (at % 6 == 5)) for at in range(60)]
    assert codes(*polls) == ["MB-404"]
    failed = [transaction(response="83 04", at_ms=at, profile="wago-750") for at in (0, 20)]
    assert codes(*failed, profile="wago-750") == ["WAGO-X1"]


def test_an_ambiguous_frame_breaks_no_rule_about_content() -> None:
    frames: list[dict[str, Any]] = [
        {"quantity": 0, "outcome": Outcome.NO_ANSWER},
        {"quantity": 1, "exception": 0x55, "outcome": Outcome.EXCEPTION},
        {"quantity": 1, "outcome": Outcome.UNSOLICITED},
        {"quantity": 1, "outcome": Outcome.BROADCAST, "unit": 0},
    ]
    namer = named_by("idec-ft1a-touch")
    for verdicts in ([], [Verdict.AMBIGUOUS]):
        for fields in frames:
            one = bare(3, 9999, **fields, link=LINE, request_ns=START_NS, verdicts=verdicts)
            again = transaction(at_ms=8000, on_a_line=True)
            found = codes(again, namer.name(one), again, profile="idec-ft1a-touch")
            assert bool(found) is not bool(verdicts), (fields, found)


def test_too_few_cases_for_a_finding_are_a_remark() -> None:
    checker = Checker(CaptureContext(assigned(None), lambda _: SerialFormat(19200)))
    doubtful = bare(3, 0, quantity=0, link=LINE, verdicts=[Verdict.AMBIGUOUS])
    late = transaction(on_a_line=True, verdicts=(Verdict.T1_5_BROKEN,))
    for one in (named_by(None).name(doubtful), late, *[transaction(on_a_line=True)] * 9):
        assert not [*checker.feed(one)]
    assert checker.remarks == []
    assert not [*checker.close()]
    assert checker.remarks == [
        "1 transaction is ambiguous; its contents were not checked",
        "rs485: a silence longer than t1.5 inside a frame in 1 of 11 transactions; so few are "
        "probably late reads, and no fault of the line",
    ]


def test_a_response_to_a_broadcast_is_one_finding() -> None:
    sent = transaction("10 0000 0001 02 1234", None, unit=0, on_a_line=True)
    answer = transaction("", "10 0000 0001", at_ms=10, on_a_line=True)
    assert codes(transaction(at_ms=-500, on_a_line=True), sent, answer) == ["MB-301"]


def test_rules_of_a_family_are_for_its_devices() -> None:
    foreign = event(EventKind.FOREIGN, raw=FOREIGN_MESSAGE)
    assert codes(foreign) == ["TCP-103"]
    assert codes(foreign, profile="fa3-at1m8x") == ["FA3-X1"]
    three = [opened(source=f"10.0.0.1:{port}") for port in range(3)]
    assert codes(*three, profile="fa3-th1m16xc") == ["FA3-X2"]
    assert codes(*three, profile="wago-750") == []
    assert codes(*three) == []


def test_without_times_there_are_no_findings_about_times() -> None:
    polls = [transaction(at_ms=100 * at + 80 * (at % 6 == 5), on_a_line=True) for at in range(60)]
    assert codes(*polls) == ["MB-404"]
    checker = Checker()
    assert not [one for record in polls for one in checker.feed(record)]
    assert not [*checker.close()]


TRANSACTIONS = st.builds(
    bare,
    st.sampled_from([0, 1, 2, 3, 5, 6, 0x0F, 0x10, 0x16, 0x17, 0x2B, 0x41, 0x83, 255]),
    st.none() | st.integers(0, 0xFFFF),
    link=st.sampled_from([LINE, LINK]),
    transport=st.sampled_from(Transport),
    source=st.sampled_from([None, MASTER]),
    destination=st.sampled_from([None, SLAVE, "", "[::1]:502"]),
    unit=st.sampled_from([0, 1, 255]),
    transaction_id=st.none() | st.integers(0, 2),
    quantity=st.none() | st.integers(0, 0xFFFF),
    write_address=st.none() | st.just(0xFFFF),
    request_values=st.none() | st.lists(st.integers(0, 0xFFFF), max_size=3),
    response_values=st.none() | st.lists(st.integers(0, 0xFFFF), max_size=3),
    exception=st.none() | st.integers(0, 255),
    outcome=st.sampled_from(Outcome),
    request_ns=st.none() | st.integers(START_NS, START_NS + 10**10) | st.integers(-5, 5),
    response_ns=st.none() | st.integers(START_NS, START_NS + 10**10) | st.integers(-5, 5),
    request_raw=st.none() | st.binary(max_size=12),
    response_raw=st.none() | st.binary(max_size=12),
    retries=st.integers(0, 3),
    verdicts=st.lists(st.sampled_from(Verdict), max_size=3),
)
EVENTS = st.builds(
    WireEvent,
    ts_ns=st.integers(START_NS, START_NS + 10**10) | st.integers(-5, 5),
    link=st.sampled_from(["", LINE, LINK]),
    kind=st.sampled_from(EventKind),
    message=st.sampled_from(["", "connection joined"]),
    source=st.sampled_from(["", MASTER, SLAVE]),
    destination=st.sampled_from(["", MASTER, SLAVE]),
    raw=st.binary(max_size=12) | st.just(FOREIGN_MESSAGE),
)


@given(
    records=st.lists(TRANSACTIONS | EVENTS, max_size=30),
    profile=st.sampled_from([*builtin_profiles()]),
)
def test_whatever_is_decoded_gives_findings_of_known_rules(
    records: list[NamedTransaction | WireEvent], profile: str
) -> None:
    assert all(rule_of(code) is not None for code in _codes_of_any(records, profile))


def _codes_of_any(records: list[NamedTransaction | WireEvent], profile: str) -> Iterable[str]:
    namer = named_by(profile)
    named = [one if isinstance(one, WireEvent) else namer.name(one) for one in records]
    return codes(*named, profile=profile)
