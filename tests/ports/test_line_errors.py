"""Errors on a line, gathered into few words."""

from __future__ import annotations

from mbtool.ports.line_errors import GATHER_NS, SHOWN, ErrorCounts, LineErrors, LineTrouble

CHARACTER_NS = 1000
S = GATHER_NS


class Driver:
    """Counters that a test sets."""

    def __init__(self) -> None:
        self.counts: ErrorCounts | None = ErrorCounts()

    def __call__(self) -> ErrorCounts | None:
        return self.counts


def errors(driver: Driver | None = None) -> LineErrors:
    return LineErrors(driver or Driver(), CHARACTER_NS, 0)


def test_a_single_error_is_told_at_once_with_its_byte_and_time() -> None:
    one = errors()
    one.note_damaged(b"\x01\xf8\x02\x03", [1], 50_000)
    (told,) = one.tell(50_000)
    assert (told.ts_ns, told.text) == (48_000, "parity or framing error at byte F8H")
    assert one.tell_all(60_000) == []


def test_a_damaged_zero_may_be_a_break() -> None:
    one = errors()
    one.note_damaged(b"\x00", [0], 50_000)
    assert one.tell(50_000)[0].text == "break, or parity or framing error at byte 00H"


def test_a_flood_is_told_at_once_and_then_once_a_second() -> None:
    one = errors()
    told: list[LineTrouble] = []
    for at_ns in range(0, 10 * S, S // 100):
        one.note_damaged(b"\xff\x00\x1c", [0, 1, 2], at_ns)
        told += one.tell(at_ns)
        assert len(one._first) <= SHOWN
    assert len(told) == 10
    assert told[0].text.startswith("3 bytes with")
    assert told[1].text == (
        "300 bytes with a parity or framing error within 0.990 s: "
        "FFH 00H 1CH FFH 00H 1CH FFH 00H ... (00H also for a break)"
    )


def test_an_error_after_a_second_without_any_is_told_at_once_again() -> None:
    one = errors()
    for at_ns in (0, 2 * S, 3 * S):
        one.note_damaged(b"\x41", [0], at_ns)
        assert len(one.tell(at_ns)) == 1


def test_counters_that_stay_are_not_told_and_are_read_once_a_second() -> None:
    driver = Driver()
    driver.counts = ErrorCounts(parity=7)
    one = errors(driver)
    driver.counts = ErrorCounts(parity=8, frame=2)
    assert not one.tell(S - 1)
    (told,) = one.tell(S)
    assert (told.ts_ns, told.text) == (S, "the driver counts 1 parity error, 2 framing errors")
    assert not one.tell(2 * S)


def test_marks_and_counters_are_told_together() -> None:
    driver = Driver()
    one = errors(driver)
    driver.counts = ErrorCounts(breaks=1)
    one.note_damaged(b"\x00", [0], 5)
    assert one.tell(5)[0].text == (
        "break, or parity or framing error at byte 00H; the driver counts 1 break"
    )


def test_lost_bytes_are_told_by_their_number_and_counters_may_wrap() -> None:
    driver = Driver()
    driver.counts = ErrorCounts(overrun=-1)
    one = errors(driver)
    driver.counts = ErrorCounts(overrun=1, buffer_overrun=3)
    (told,) = one.tell(S)
    assert (told.text, told.lost) == ("", 5)


def test_a_driver_without_counters_is_none_the_worse() -> None:
    driver = Driver()
    driver.counts = None
    one = errors(driver)
    assert not one.tell(S)
    driver.counts = ErrorCounts(parity=3)
    assert not one.tell(2 * S)
