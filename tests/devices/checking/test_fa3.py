from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.devices.checking.fa3 import Fa3Rules, is_fa3
from mbtool.devices.checking.sliding_window import MAX_ENTRIES
from mbtool.devices.loading import load_profile
from mbtool.devices.named_transaction import NamedTransaction
from tests.devices.checking.talk import MASTER, event, opened, transaction

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding

Record = NamedTransaction | WireEvent

AT1M8X = "fa3-at1m8x"
A, B, C = "10.0.0.1:1", "10.0.0.1:2", "10.0.0.1:3"
Y9_ON, Y9_OFF = "05 0009 FF00", "05 0009 0000"


def found(*records: Record, profile: str = AT1M8X) -> list[tuple[str, str]]:
    rules, device = Fa3Rules(), load_profile(profile)
    findings: list[Finding] = []
    for record in records:
        if isinstance(record, WireEvent):
            findings += rules.event(record, device)
        else:
            findings += rules.transaction(record, device)
    findings += rules.close()
    return [(one.code, one.message) for one in findings]


def codes(*records: Record, profile: str = AT1M8X) -> list[str]:
    return [code for code, _ in found(*records, profile=profile)]


def said(*of: Any, profile: str = AT1M8X, **fields: Any) -> NamedTransaction:
    return transaction(*of, profile=profile, **fields)


def closed(*, at_ms: float = 0, source: str = MASTER, how: str = "finished") -> WireEvent:
    message = f"connection closed: {how}"
    return event(EventKind.CLOSED, at_ms=at_ms, source=source, message=message)


def x9(value: int, *, at_ms: float = 0) -> NamedTransaction:
    return said("02 0009 0001", f"02 01 {value:02X}", at_ms=at_ms)


def test_another_protocol_id_gets_no_answer() -> None:
    raw = bytes.fromhex("0001 0001 0006 01 03 0000 0001")
    assert codes(event(EventKind.FOREIGN, raw=raw)) == ["FA3-X1"]
    assert codes(event(EventKind.FOREIGN, raw=b"\x16\x03\x01")) == []


def test_a_reset_with_wrong_data_is_no_reset() -> None:
    assert codes(said("41 00", None)) == ["FA3-X3"]
    assert codes(said("41 01", None)) == []


TWO = (opened(source=A), opened(source=B, at_ms=1), said(source=A, at_ms=50))
THREE = (*TWO, opened(source=C, at_ms=100))
BESIDE = f"{C} connects beside {A} and {B}"


@pytest.mark.parametrize(
    ("after", "told"),
    [
        ((), ("FA3-X2", f"{BESIDE}; the module takes two")),
        (
            (closed(source=B, at_ms=101, how="reset by the slave"),),
            ("FA3-X2", f"{BESIDE}; the module drops {B}"),
        ),
        (
            (closed(source=C, at_ms=101, how="refused"),),
            ("FA3-X9", f"{BESIDE}; the module refuses it, although {B} was silent longest"),
        ),
        (
            (closed(source=A, at_ms=101, how="finished by the slave"),),
            ("FA3-X9", f"{BESIDE}; the module drops {A}, although {B} was silent longest"),
        ),
        (
            (said(source=B, at_ms=1200),),
            ("FA3-X9", f"{BESIDE}; the module goes on with all, also with {B}"),
        ),
    ],
)
def test_a_third_connection_is_told_as_the_module_deals_with_it(
    after: tuple[Record, ...], told: tuple[str, str]
) -> None:
    assert found(*THREE, *after) == [told]


def test_a_third_connection_is_no_finding_if_the_master_makes_room() -> None:
    assert codes(*TWO, closed(source=A, at_ms=60), opened(source=C, at_ms=100)) == []
    assert codes(*THREE, closed(source=A, at_ms=101, how="finished by the master")) == []


def test_a_module_may_refuse_while_it_ends_a_connection_or_restarts() -> None:
    failed = "reset by the slave, 3 keep-alive probes, the last 3 unanswered"
    refused = closed(source="10.0.0.1:4", at_ms=9000, how="refused")
    checked = (*THREE, closed(source=B, at_ms=200, how=failed))
    assert codes(*checked, opened(source="10.0.0.1:4", at_ms=9000), refused) == [
        "FA3-X7", "FA3-X2",
    ]  # fmt: skip


def test_a_module_that_answers_on_after_a_remote_reset_is_found() -> None:
    reset = (opened(source=A), said("41 00", None, source=A, at_ms=10))
    assert found(*reset, said(source=A, at_ms=20))[1:] == [
        ("FA3-X9", "answers read holding RWw0 on the connection of the remote reset")
    ]
    assert codes(*reset, said("03 0000 0001", None, source=A, at_ms=20)) == ["FA3-X3"]
    # The reset has no response, so it is decoded last.
    assert codes(opened(source=A), said(source=A, at_ms=20), reset[1]) == ["FA3-X3", "FA3-X9"]
    assert codes(opened(source=A), said(source=A, at_ms=5), reset[1]) == ["FA3-X3"]


def test_a_remote_reset_is_found_unless_it_is_refused() -> None:
    assert codes(said("41 00", None)) == ["FA3-X3"]
    assert codes(said("41 00", "C1 03")) == []


def test_a_connection_within_two_seconds_after_a_reset_is_found() -> None:
    reset: list[Record] = [
        opened(source=A),
        said("41 00", None, source=A, at_ms=10),
        closed(source=A, at_ms=100),
    ]
    assert found(*reset, opened(source=B, at_ms=1100))[1:] == [
        ("FA3-X4", f"{B} connects 1.0 s after the remote reset")
    ]
    assert codes(*reset, opened(source=B, at_ms=1100), said(source=B, at_ms=1200)) == [
        "FA3-X3",
        "FA3-X4",
    ]
    assert codes(*reset, opened(source=B, at_ms=2101)) == ["FA3-X3"]
    assert codes(*reset, opened(source=B, at_ms=1100, joined=True)) == ["FA3-X3"]


def test_a_request_on_another_connection_after_a_reset_is_found() -> None:
    reset: list[Record] = [said("41 00", None, source=A, at_ms=10), closed(source=A, at_ms=100)]
    assert found(*reset, said(source=B, at_ms=600))[1:] == [
        ("FA3-X4", "read holding RWw0 0.5 s after the remote reset")
    ]


def test_a_reset_that_is_decoded_late_applies_to_requests_since_then() -> None:
    since: list[Record] = [opened(source=B, at_ms=500), said(source=B, at_ms=510)]
    reset = said("41 00", None, source=A, at_ms=10)
    assert codes(*since, reset) == ["FA3-X3", "FA3-X4"]
    assert codes(said(source=B, at_ms=5), reset) == ["FA3-X3"]


def test_settings_take_effect_by_y9_then_x9_then_y9() -> None:
    asked, cleared = said(Y9_ON, Y9_ON), said(Y9_OFF, Y9_OFF)
    assert codes(asked, x9(0), x9(1), cleared) == []
    assert found(asked, x9(0), cleared) == [("FA3-X5", "Y9 is cleared before X9 was seen to be on")]
    assert codes(asked, cleared) == ["FA3-X5"]
    # A flag that was on before says nothing of these settings.
    assert codes(x9(1), asked, cleared) == ["FA3-X5"]


SET_INPUTS = ("06 0102 005C", "06 0102 005C")
READ_INPUTS = ("04 0002 0002", "04 04 0001 0002")


def test_settings_without_y9_are_found_when_values_are_used() -> None:
    written, read = said(*SET_INPUTS), said(*READ_INPUTS)
    assert found(written, read) == [
        ("FA3-X6", "read input RWr2..RWr3, but Y9 was not set since settings were written")
    ]
    assert codes(written, read, read) == ["FA3-X6"]
    assert codes(written, said(Y9_ON, Y9_ON), x9(1), said(Y9_OFF, Y9_OFF), read) == []
    assert codes(said(Y9_ON, Y9_ON), x9(1), said(Y9_OFF, Y9_OFF), written, read) == ["FA3-X6"]
    assert codes(said(SET_INPUTS[0], "86 02"), read) == []
    assert codes(read) == []
    assert codes(written, said("04 0000 0002", "04 04 0000 0000")) == []  # The alarm.


def test_settings_of_an_output_without_y9_are_found() -> None:
    written = said(*SET_INPUTS, profile="fa3-at1m8y")
    value = said("06 0002 0E10", "06 0002 0E10", profile="fa3-at1m8y")
    assert codes(written, value, profile="fa3-at1m8y") == ["FA3-X6"]
    digital = said(*SET_INPUTS, profile="fa3-th1m16y")
    assert codes(digital, value, profile="fa3-th1m16y") == []


def test_a_reset_after_three_unanswered_alive_checks_is_found() -> None:
    def ended(text: str) -> list[tuple[str, str]]:
        return found(event(EventKind.CLOSED, message=f"connection closed: {text}"))

    assert ended("reset, 4 keep-alive probes, the last 3 unanswered") == [
        ("FA3-X7", "a reset after 3 alive checks without an answer; the alarm is 0E30H")
    ]
    assert ended("reset, 4 keep-alive probes, the last 2 unanswered") == []
    assert ended("reset by the master, 3 keep-alive probes, the last 3 unanswered") == []
    assert ended("finished, 3 keep-alive probes, the last 3 unanswered") == []
    assert ended("reset, 3 keep-alive probes") == []


@pytest.mark.parametrize(("count", "unanswered", "is_told"), [(1, 1, True), (2, 1, False)])
def test_the_number_of_alive_checks_is_taken_from_00f4h(
    count: int, unanswered: int, is_told: bool
) -> None:
    write = f"06 00F4 {count:04X}"
    how = f"reset by the slave, 5 keep-alive probes, the last {unanswered} unanswered"
    assert codes(said(write, write), closed(how=how)) == ["FA3-X7"] * is_told
    read = said("03 00F2 0004", f"03 08 0258 000A {count:04X} 001E")
    assert codes(read, closed(how=how)) == ["FA3-X7"] * is_told


@pytest.mark.parametrize(
    ("written", "seconds", "is_told"),
    [(None, 31, True), (None, 29, False), (5, 10, True), (60, 40, False), (0, 2, True)],
)
def test_the_time_for_the_parts_of_a_request_is_taken_from_00f5h(
    written: int | None, seconds: int, is_told: bool
) -> None:
    write = f"06 00F5 {written or 0:04X}"
    before = [] if written is None else [said(write, write)]
    late = msgspec.structs.replace(said(), request_parts_ns=seconds * 1_000_000_000)
    assert codes(*before, late) == ["FA3-X8"] * is_told
    # The module ends the connection before the last part.
    part = event(EventKind.SKIPPED, source=MASTER, raw=b"\0\1\0\0\0\6")
    over = closed(at_ms=seconds * 1000, how="reset by the slave")
    assert codes(*before, opened(), part, over) == ["FA3-X8"] * is_told


def test_a_value_that_is_read_before_its_conversion_is_found() -> None:
    enable = said("06 0102 005C", "06 0102 005C")  # Channels 1, 2, 6 and 8 (10.5).
    start = (said(Y9_ON, Y9_ON), x9(1), said(Y9_OFF, Y9_OFF))
    done, not_yet = (said("02 0010 0008", f"02 01 {bits}") for bits in ("A3", "83"))
    read = said("04 0002 0008", "04 10" + "0000" * 8)
    assert codes(enable, *start, done, read) == []
    assert found(enable, *start, not_yet, read) == [
        ("FA3-X10", "read input RWr2..RWr9, but X15 of CH6 was last read as off")
    ]
    assert codes(not_yet, read) == []  # Nobody knows which channels are enabled.
    assert codes(enable, *start, not_yet, read, read) == ["FA3-X10"]


def test_an_alarm_is_found_with_its_meaning() -> None:
    alarm = said("04 0001 0001", "04 02 0E30")
    none = said("04 0001 0001", "04 02 0000")
    assert found(alarm, alarm) == [("FA3-X11", "RWr1 is 0E30H: alive check error")]
    assert codes(none) == []
    assert codes(alarm, none, alarm) == ["FA3-X11", "FA3-X11"]
    (told,) = found(said("04 0000 0002", "04 04 0000 1234"))
    assert told == ("FA3-X11", "RWr1 is 1234H: see the manual's list of alarm codes")


def test_another_model_than_the_one_that_was_named_is_found() -> None:
    other = said("42 00", "42 0013")
    assert found(other, other) == [
        ("FA3-X12", "42H says 0013H, FA3-TH1M16XC; it was named fa3-at1m8x")
    ]
    assert codes(said("42 00", "42 0016")) == []
    assert codes(said("42 00", "42 0099")) == []  # FA3-M66 tells of it.


def test_y9_that_is_set_twice_or_never_followed_by_x9_is_found() -> None:
    asked = said(Y9_ON, Y9_ON)
    assert found(asked, asked) == [("FA3-X5", "Y9 is set, but it is on already")]
    read = said(*READ_INPUTS)
    assert found(asked, read, read) == [
        ("FA3-X5", "read input RWr2..RWr3, while Y9 is on and X9 was not read")
    ]
    assert codes(asked, x9(0), read) == []


def test_a_handshake_without_its_beginning_is_no_finding() -> None:
    assert codes(said(Y9_OFF, Y9_OFF)) == []
    refused = said(Y9_ON, "85 02")
    assert codes(refused, said(Y9_OFF, Y9_OFF)) == []


def test_writing_all_outputs_again_and_again_is_one_request() -> None:
    all_on = ("0F 0000 0010 02 00 02", "0F 0000 0010")
    all_off = ("0F 0000 0010 02 00 00", "0F 0000 0010")
    everything = said("02 0000 0010", "02 02 00 02")
    assert codes(said(*all_on), everything, said(*all_on), said(*all_off)) == []
    assert codes(said(*all_on), said(*all_off)) == ["FA3-X5"]


@pytest.mark.parametrize("profile", ["fa3-th1m16y", "fa3-th1m16ye"])
def test_on_the_digital_modules_y9_is_an_output(profile: str) -> None:
    on, off = said(Y9_ON, Y9_ON, profile=profile), said(Y9_OFF, Y9_OFF, profile=profile)
    assert codes(on, off, profile=profile) == []


def test_the_family_is_known_by_its_behaviour() -> None:
    assert is_fa3(load_profile("fa3-at1m8y"))
    assert not is_fa3(load_profile("idec-ft1a-touch"))


def test_memory_is_bounded() -> None:
    rules = Fa3Rules()
    for number in range(MAX_ENTRIES + 10):
        one = event(EventKind.OPENED, destination=f"10.1.{number // 256}.{number % 256}:502")
        assert not [*rules.event(one, load_profile(AT1M8X))]
    assert len(rules._modules) == MAX_ENTRIES
    for number in range(500):
        third = opened(source=f"10.0.0.1:{number}")
        assert len([*rules.event(third, load_profile(AT1M8X))]) == (number > 2)
    module = rules._modules["10.0.0.2:502"]
    assert len(module.connections) == 3
    assert len(module.recent) == 64
