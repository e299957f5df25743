from __future__ import annotations

from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.replay.traffic import ObservedValues, Sample, ValueKey
from mbtool.replay.wording import DeviceWording, function_text, latency_side, values_text

AT1M8X = load_profile("fa3-at1m8x")


def _observed(*values: int) -> ObservedValues:
    held = ObservedValues()
    for value in values:
        held.add(value)
    return held


def test_a_register_has_the_name_and_the_texts_of_its_device() -> None:
    name, named = DeviceWording(AT1M8X).of(
        ValueKey(Table.HOLDING_REGISTERS, 0x102, is_written=False)
    )
    assert name == "A/D conversion enable/disable setting"
    assert values_text(_observed(0x5C), named) == "CH1 CH2 CH6 CH8 enabled"


def test_without_a_profile_values_are_numbers() -> None:
    words = DeviceWording(None)
    assert words.of(ValueKey(Table.COILS, 5, is_written=False)) == (None, None)
    assert words.reference(Table.COILS, 5, 3) == "coil 5..7"


def test_many_values_are_a_range() -> None:
    assert values_text(_observed(3, 1, 2), None) == "3, 1, 2"
    assert values_text(_observed(*range(5)), None) == "0..4, 5 values"
    assert values_text(_observed(*range(300)), None) == "0..299, more than 256 values"


def test_a_function_has_its_short_name_or_the_makers() -> None:
    assert function_text(3, "read holding registers") == "03 read holding"
    assert function_text(0x42, "read model name") == "42 read model name"
    assert function_text(8, "diagnostics", 4) == "08 diagnostics 04"


def test_latencies_are_shown_by_median_and_95th_percentile() -> None:
    sample = Sample()
    for ms in range(1, 101):
        sample.add(ms * 1_000_000)
    side = latency_side(sample)
    assert (side.text, side.median_ns, side.p95_ns) == (
        "50 ms, p95 96 ms",
        50_000_000,
        96_000_000,
    )
