from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices import (
    Assignments,
    Difference,
    Namer,
    Side,
    Span,
    load_profile,
    parse_assignment,
)
from mbtool.devices import DifferenceKind as Kind
from mbtool.modbus import Table
from mbtool.replay import traffic as room
from mbtool.replay.comparing import Ignored, differences
from mbtool.replay.traffic import Traffic
from tests.replay.recorded import MS, answered, unanswered

if TYPE_CHECKING:
    import random
    from collections.abc import Iterable, Sequence

    from mbtool.modbus import Transaction

AT1M8X = load_profile("fa3-at1m8x")


def _compared(
    a: Iterable[Transaction],
    b: Iterable[Transaction],
    ignored: Ignored | None = None,
    device: str | None = None,
) -> list[Difference]:
    namer = Namer(Assignments([parse_assignment(f"all={device}")] if device else []))
    one, other = (Traffic.of(namer.name(each) for each in side) for side in (a, b))
    return differences(one, other, {AT1M8X.name: AT1M8X}, ignored or Ignored())


def _told(found: Sequence[Difference]) -> list[tuple[str, str | None, str, str]]:
    return [(one.kind.value, one.reference, one.a.text, one.b.text) for one in found]


def _poll(at_ms: int, values: str, latency_ms: float = 5, unit: int = 1) -> Transaction:
    count = len(values.split())
    return answered(
        at_ms,
        f"03 000A {count:04X}",
        f"03 {2 * count:02X} {values}",
        latency_ns=round(latency_ms * MS),
        unit=unit,
    )


@given(st.lists(st.integers(0, 9), max_size=30), st.randoms(use_true_random=False))
def test_order_and_times_do_not_count(values: list[int], chance: random.Random) -> None:
    a = [_poll(number * 10, f"{value:04X} 0001") for number, value in enumerate(values)]
    b = [_poll(number * 99, f"{value:04X} 0001") for number, value in enumerate(values)]
    chance.shuffle(b)
    assert _compared(a, b) == []


@given(st.integers(0, 9), st.integers(1, 0xFFFF))
def test_one_register_that_changed_is_found_and_only_that(place: int, change: int) -> None:
    before = [7] * 10
    after = before.copy()
    after[place] ^= change
    a, b = (
        [_poll(at, " ".join(f"{one:04X}" for one in values)) for at in range(0, 50, 10)]
        for values in (before, after)
    )
    assert _told(_compared(a, b)) == [("value", f"holding {10 + place}", "7", str(after[place]))]


def test_a_value_that_the_other_never_had_counts() -> None:
    a, b = [_poll(0, "0000"), _poll(9, "0000")], [_poll(0, "0000"), _poll(9, "0001")]
    assert _told(_compared(a, b)) == [("value", "holding 10", "0", "0, 1")]


def test_neighbours_that_change_in_both_are_one_difference() -> None:
    a = [_poll(at, f"{at:04X} {at + 5:04X} 0001") for at in range(8)]
    b = [_poll(at, f"{at:04X} {at + 6:04X} 0002") for at in range(1, 9)]
    assert _told(_compared(a, b)) == [
        ("value", "holding 10..11", "0..12, 16 values", "1..14, 16 values"),
        ("value", "holding 12", "1", "2"),
    ]


def test_values_that_may_differ_are_not_compared() -> None:
    ignored = Ignored(spans=[Span(Table.HOLDING_REGISTERS, 10, 11)])
    found = _compared([_poll(0, "0001 0001 0001")], [_poll(0, "0002 0002 0002")], ignored)
    assert _told(found) == [("value", "holding 12", "1", "2")]


def test_a_request_in_one_capture_only_is_reported() -> None:
    both = [_poll(0, "0001")]
    found = _compared([*both, answered(9, "06 0001 0002", "06 0001 0002")], both)
    assert _told(found) == [("request", "holding 1", "1 transaction", "")]
    assert found[0].what == "06 write register"


def test_a_slave_in_one_capture_only_is_reported_once() -> None:
    found = _compared([_poll(0, "0001")], [_poll(0, "0001"), _poll(9, "0001", unit=7)])
    assert [(one.kind, one.unit, one.b.count) for one in found] == [(Kind.SLAVE, 7, 1)]


def test_an_exception_in_one_capture_only_is_reported() -> None:
    a = [_poll(at, "0001") for at in range(5)]
    found = _compared(a, [*a, answered(99, "03 000A 0001", "83 06")])
    assert _told(found) == [("outcome", "holding 10", "ok", "ok 5 of 6, exception 06 1 of 6")]


def test_one_missing_answer_in_hundreds_is_chance() -> None:
    a = [_poll(at, "0001") for at in range(300)]
    assert _compared(a, [*a, unanswered(999, "03 000A 0001")]) == []


def test_many_missing_answers_are_a_difference() -> None:
    a = [_poll(at, "0001") for at in range(60)]
    b = [*a[:30], *(unanswered(at, "03 000A 0001") for at in range(900, 930))]
    (found,) = _compared(a, b)
    assert found.kind is Kind.OUTCOME
    assert found.p is not None
    assert found.p < 1e-6
    assert found.b.text == "no answer 30 of 60, ok 30 of 60"


def test_a_shift_of_latencies_is_reported_with_its_p_value() -> None:
    a = [_poll(at, "0001", 5 + at % 7) for at in range(100)]
    b = [_poll(at, "0001", 9 + at % 7) for at in range(100)]
    (found,) = _compared(a, b)
    assert (found.kind, found.a.text, found.b.text) == (
        Kind.LATENCY,
        "8 ms, p95 11 ms",
        "12 ms, p95 15 ms",
    )
    assert found.p is not None
    assert found.p < 1e-6
    assert _compared(a, b, Ignored(latency=True)) == []


def test_a_small_shift_of_latencies_is_no_difference() -> None:
    a = [_poll(at, "0001", 5 + at % 20) for at in range(4000)]
    b = [_poll(at, "0001", 6 + at % 20) for at in range(4000)]
    assert _compared(a, b) == []


def test_equal_units_on_several_links_are_distinguished_by_link() -> None:
    import msgspec

    a = [_poll(0, "0001"), msgspec.structs.replace(_poll(0, "0002"), link="other")]
    found = _compared(a, a[:1])
    assert [(one.kind, one.unit, one.link) for one in found] == [(Kind.SLAVE, 1, "other")]


def test_a_unique_unit_is_matched_although_its_link_has_another_name() -> None:
    import msgspec

    a = _poll(0, "0001")
    assert _compared([a], [msgspec.structs.replace(a, link="127.0.0.1:1502")]) == []


def test_registers_are_named_by_their_device() -> None:
    a = [answered(0, "06 0102 005C", "06 0102 005C")]
    b = [answered(0, "06 0102 00FF", "06 0102 00FF")]
    (found,) = _compared(a, b, device="fa3-at1m8x")
    assert (found.reference, found.name, found.what) == (
        "0102H",
        "A/D conversion enable/disable setting",
        "written",
    )
    assert (found.a.text, found.b.text) == ("CH1 CH2 CH6 CH8 enabled", "none enabled")


def _polls(latencies_ms: dict[int, float]) -> list[Transaction]:
    """Forty polls of one register at each address, with latencies around the given median."""
    return [
        answered(
            100 * number + address,
            f"03 {address:04X} 0001",
            "03 02 0001",
            latency_ns=round(median * (1 + (number % 5 - 2) / 100) * MS),
        )
        for address, median in latencies_ms.items()
        for number in range(40)
    ]


def _shifts(factors: dict[int, float]) -> list[tuple[list[str], str, str]]:
    """What is said of requests whose latencies of 20 ms change by these factors."""
    before, after = dict.fromkeys(factors, 20.0), {at: 20 * by for at, by in factors.items()}
    found = _compared(_polls(before), _polls(after))
    assert {one.kind for one in found} <= {Kind.LATENCY}
    return [([one.reference or "", *one.alike], _median(one.a), _median(one.b)) for one in found]


def _median(side: Side) -> str:
    return side.text.partition(",")[0]


def test_a_slower_and_a_faster_request_of_one_function_are_named_each() -> None:
    assert _shifts({1: 2.0, 2: 0.5, 3: 1.0}) == [
        (["holding 1"], "20 ms", "40 ms"),
        (["holding 2"], "20 ms", "10 ms"),
    ]


def test_requests_that_changed_by_other_factors_are_named_each() -> None:
    assert _shifts({1: 1.1, 2: 3.0, 3: 3.1, 4: 0.3, 5: 0.9}) == [
        (["holding 3", "holding 2"], "20 ms", "62 ms"),
        (["holding 1"], "20 ms", "22 ms"),
        (["holding 4"], "20 ms", "6 ms"),
        (["holding 5"], "20 ms", "18 ms"),
    ]


@given(st.dictionaries(st.integers(1, 8), st.sampled_from([0.2, 0.5, 0.9, 1.0, 1.1, 2.0, 5.0])))
def test_each_request_that_changed_is_named_once_with_its_direction(
    factors: dict[int, float],
) -> None:
    shifts = _shifts(factors)
    named = [name for names, _, _ in shifts for name in names]
    assert sorted(named) == [f"holding {at}" for at in sorted(factors) if factors[at] != 1.0]
    for names, before, after in shifts:
        of_group = {factors[int(name.split()[1])] for name in names}
        assert len(of_group) == 1
        assert (float(after.split()[0]) > float(before.split()[0])) == (of_group.pop() > 1)


def test_requests_of_a_function_without_references_are_named_by_their_address() -> None:
    a, b = (
        [
            answered(at * 10 + n, f"18 {at:04X}", "18 0004 0001 0007", latency_ns=ms * MS + n)
            for at in (1, 2)
            for n in range(20)
        ]
        for ms in (10, 20)
    )
    (found,) = _compared(a, b)
    assert (found.reference, found.alike) == ("address 1", ["address 2"])


@pytest.mark.parametrize("limit", ["MAX_SLAVES", "MAX_REQUESTS"])
def test_what_was_left_out_of_one_capture_is_no_difference(
    limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = 2 if limit == "MAX_SLAVES" else 1
    other = answered(20, "03 0001 0001", "03 02 0005", unit=unit)
    one = _poll(10, "0001")
    assert len(_compared([one, other], [one])) == 1
    monkeypatch.setattr(room, limit, 1)
    assert _compared([one, other], [other, one]) == []
