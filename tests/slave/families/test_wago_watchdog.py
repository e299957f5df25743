"""A WAGO coupler's watchdog, on a clock of the test's own."""

from __future__ import annotations

import pytest

from mbtool.devices import load_profile
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device

WAGO = load_profile("wago-750")
MS = 1_000_000
READ_OUTPUT = "03 0200 0001"


class _Coupler:
    """A coupler, and the time."""

    def __init__(self) -> None:
        self.device = make_device(WAGO, RegisterImage.of(WAGO))
        self.now_ns = 0

    def ask(self, request: str, after_ms: int = 0) -> str:
        self.now_ns += after_ms * MS
        answer = self.device.respond(1, bytes.fromhex(request), self.now_ns)
        assert answer is not None
        return answer.pdu.hex(" ")

    def word(self, address: int) -> str:
        return self.ask(f"03 {address:04X} 0001")[6:]


def _watching(mask: str = "0000") -> _Coupler:
    """A coupler whose watchdog runs for 500 ms."""
    coupler = _Coupler()
    coupler.ask("06 1000 0005")
    coupler.ask(f"06 1001 {mask}")
    coupler.ask("06 1003 0001")
    assert coupler.word(0x1006) == "00 01"
    return coupler


def test_it_begins_off_and_a_trigger_without_a_time_leaves_it_off() -> None:
    coupler = _Coupler()
    assert coupler.word(0x1006) == "00 00"
    assert coupler.word(0x1004) == "ff ff"
    assert coupler.ask("06 1003 0001") == "06 10 03 00 01"
    assert coupler.word(0x1006) == "00 00"


def test_after_a_trip_every_request_gets_exception_04_also_one_that_is_wrong() -> None:
    coupler = _watching()
    assert coupler.ask(READ_OUTPUT, after_ms=499) == "03 02 00 00"
    assert coupler.ask(READ_OUTPUT, after_ms=1) == "83 04"
    for request in ("03 1006 0001", "05 0000 FF00", "07", "2B 0E 01 00", "03 9999 0001"):
        code = int(request[:2], 16) | 0x80
        assert coupler.ask(request) == f"{code:02x} 04"


def test_a_trip_is_told_once() -> None:
    coupler = _watching()
    for _ in range(3):
        coupler.ask(READ_OUTPUT, after_ms=500)
    rules = coupler.device.behaviour.rules
    assert rules is not None
    assert list(rules.notes) == [
        "the watchdog expired: requests get exception 04 until it is ended or restarted"
    ]


def test_a_read_that_was_answered_before_is_refused_after_a_trip_like_any_other() -> None:
    coupler = _watching()
    for _ in range(3):
        assert coupler.ask(READ_OUTPUT) == "03 02 00 00"
    assert coupler.ask(READ_OUTPUT, after_ms=500) == "83 04"


def test_a_new_value_that_is_not_0_triggers_it_and_no_other_does() -> None:
    coupler = _watching()
    assert coupler.ask("06 1003 0002", after_ms=400) == "06 10 03 00 02"
    assert coupler.ask(READ_OUTPUT, after_ms=400) == "03 02 00 00"
    assert coupler.ask("06 1003 0002") == "06 10 03 00 02"
    assert coupler.ask("06 1003 0000") == "06 10 03 00 00"
    assert coupler.ask(READ_OUTPUT, after_ms=100) == "83 04"


def test_a_function_in_its_mask_triggers_it_and_another_does_not() -> None:
    coupler = _watching("0004")  # function 3
    for _ in range(5):
        assert coupler.ask(READ_OUTPUT, after_ms=400) == "03 02 00 00"
    assert coupler.ask("01 0000 0001", after_ms=400) == "01 01 00"
    assert coupler.ask(READ_OUTPUT, after_ms=100) == "83 04"


def test_the_second_mask_is_for_functions_17_to_32() -> None:
    coupler = _Coupler()
    coupler.ask("10 1000 0003 06 0005 0000 0020")  # function 22
    coupler.ask("06 1003 0001")
    assert coupler.ask("16 0000 FFFF 0000", after_ms=400) == "16 00 00 ff ff 00 00"
    assert coupler.ask(READ_OUTPUT, after_ms=400) == "03 02 00 00"
    assert coupler.ask(READ_OUTPUT, after_ms=400) == "83 04"


@pytest.mark.parametrize(
    ("writes", "status"),
    [
        (["06 1005 AAAA", "06 1005 5555"], "00 00"),
        (["06 1005 AAAA", "06 1005 AAAA", "06 1005 5555"], "00 00"),
        (["06 1008 55AA"], "00 00"),
        (["06 1008 AA55"], "00 00"),
        (["10 1007 0001 02 0001"], "00 01"),
    ],
)
def test_what_ends_or_restarts_it_does_so_after_a_trip_too(writes: list[str], status: str) -> None:
    for wait_ms in (0, 600):
        coupler = _watching()
        coupler.now_ns += wait_ms * MS
        for write in writes:
            assert coupler.ask(write)[:2] == write[:2]
        assert coupler.word(0x1006) == status


@pytest.mark.parametrize(
    "writes",
    [
        ["06 1005 5555", "06 1005 AAAA"],
        ["06 1005 AAAA", "06 1005 1234", "06 1005 5555"],
        ["06 1008 1234"],
        ["06 1007 0002"],
        ["10 1007 0002 04 0001 55AA"],
        ["06 1003 0005"],
    ],
)
def test_nothing_else_ends_a_trip(writes: list[str]) -> None:
    coupler = _watching()
    coupler.now_ns += 600 * MS
    for write in writes:
        coupler.ask(write)
    assert coupler.ask(READ_OUTPUT) == "83 04"


def test_the_least_time_that_was_left_is_kept_and_0_after_a_trip() -> None:
    coupler = _watching()
    coupler.ask("06 1003 0002", after_ms=150)
    assert coupler.word(0x1004) == "00 03"
    coupler.ask("06 1003 0003", after_ms=50)
    assert coupler.word(0x1004) == "00 03"
    coupler.ask(READ_OUTPUT, after_ms=500)
    coupler.ask("06 1008 55AA")
    assert coupler.word(0x1004) == "00 00"


def test_the_mask_cannot_be_changed_while_it_runs() -> None:
    coupler = _watching()
    for write in ("06 1001 FFFF", "06 1002 FFFF", "10 1000 0002 04 0007 FFFF"):
        assert coupler.ask(write)[3:] == "04"
    assert coupler.word(0x1000) == "00 05"
    coupler.ask("06 1008 55AA")
    assert coupler.ask("06 1001 FFFF") == "06 10 01 ff ff"


def test_the_alternative_one_runs_anew_with_any_request_and_clears_the_outputs() -> None:
    coupler = _Coupler()
    coupler.ask("06 1000 0005")
    coupler.ask("06 100A 0001")
    coupler.ask("10 0000 0002 04 1111 2222")
    coupler.ask("0F 0000 0008 01 FF")
    for _ in range(4):
        assert coupler.ask("03 0200 0002", after_ms=400) == "03 04 11 11 22 22"
    assert coupler.ask("03 0200 0002", after_ms=500) == "03 04 00 00 00 00"
    assert coupler.ask("01 0200 0008") == "01 01 00"
    coupler.ask("06 0000 3333")
    assert coupler.ask(READ_OUTPUT) == "03 02 33 33"
