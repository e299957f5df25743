from __future__ import annotations

from typing import Any

from mbtool.devices import NamedTransaction, PointValue
from mbtool.modbus import Outcome
from mbtool.modbus.adu import DirectionBy, Transport
from mbtool.values.values import MAX_OF_POLL, SeriesKey, Values


def seen(at_ns: int, function: int, values: list[int], **more: Any) -> NamedTransaction:
    writes = function in (5, 6, 15, 16)
    fields: dict[str, Any] = {
        "address": 10,
        "quantity": len(values),
        "outcome": Outcome.OK,
        "request_values" if writes else "response_values": values,
    }
    return NamedTransaction(
        link="rs485",
        transport=Transport.RTU,
        unit=1,
        function=function,
        function_name="",
        request_ns=at_ns,
        response_ns=at_ns,
        retries=0,
        direction_by=DirectionBy.PORT,
        confidence=1.0,
        **{**fields, **more},
    )


def samples(values: Values, name: str) -> list[tuple[int, float]]:
    return [(one.ts_ns, one.value) for one in values.series[SeriesKey("rs485", 1, name)].samples]


def test_reads_and_writes_of_a_register_are_one_series() -> None:
    values = Values()
    for one in (seen(1, 3, [7, 8]), seen(2, 3, [7, 8]), seen(3, 16, [9]), seen(4, 3, [9, 8])):
        values.add(one)
    assert samples(values, "holding 10") == [(1, 7), (3, 9)]
    assert samples(values, "holding 11") == [(1, 8)]


def test_a_value_that_a_write_changed_changes_back_when_it_is_read_as_before() -> None:
    values = Values()
    for at_ns in range(0, 40, 20):
        values.add(seen(at_ns + 1, 1, [0]))
        values.add(seen(at_ns + 11, 5, [1]))
    assert samples(values, "coil 10") == [(1, 0), (11, 1), (21, 0), (31, 1)]


def test_bits_are_marked_as_bits() -> None:
    values = Values()
    values.add(seen(1, 1, [1, 0]))
    assert values.series[SeriesKey("rs485", 1, "coil 10")].bit
    assert samples(values, "coil 11") == [(1, 0)]


def test_a_slave_with_a_profile_has_points_with_their_units() -> None:
    values = Values()
    point = PointValue(name="CH1", reference="RWr2", value=27.5, text="27.5 s", unit="s")
    values.add(seen(1, 4, [275], points=[point]))
    (series,) = values.series.values()
    assert (series.name, series.reference, series.unit) == ("CH1", "RWr2", "s")
    assert samples(values, "CH1") == [(1, 27.5)]


def test_what_took_no_effect_is_no_value() -> None:
    values = Values()
    values.add(seen(1, 6, [7], outcome=Outcome.NO_ANSWER))
    values.add(seen(2, 0x16, [0xFFFF, 0]))
    values.add(seen(3, 0x2B, [1]))
    assert values.series == {}


def test_memory_is_bounded_and_what_is_left_out_is_counted() -> None:
    values = Values(most=3)
    values.add(seen(1, 3, list(range(100))))
    assert len(values.series) == 3
    assert values.left_out == 97


def test_what_another_poll_collects_is_not_left_out() -> None:
    values = Values()
    values.add(seen(1, 3, list(range(100))))
    assert values.left_out == 100 - MAX_OF_POLL
    values.add(seen(2, 3, [7, 8], address=10 + MAX_OF_POLL))
    assert values.left_out == 100 - MAX_OF_POLL - 2


def test_thousands_of_values_that_are_left_out_are_counted() -> None:
    values = Values(most=3)
    for address in range(5000):
        values.add(seen(1, 3, [7], address=address))
    assert values.left_out == 4997
