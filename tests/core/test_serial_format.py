"""Line settings and the times that follow from them."""

from __future__ import annotations

import pytest

from mbtool.core.errors import UsageError
from mbtool.core.serial_format import SerialFormat, Silence


@pytest.mark.parametrize(
    ("baud", "t1_5_us", "t3_5_us"),
    [  # Serial Line V1.02, 2.5.1.1: 11 bits a character, fixed above 19200.
        (1200, 13_750, 32_083),
        (2400, 6_875, 16_041),
        (4800, 3_437, 8_020),
        (9600, 1_718, 4_010),
        (19200, 859, 2_005),
        (38400, 750, 1_750),
        (57600, 750, 1_750),
        (115200, 750, 1_750),
    ],
)
def test_silences_follow_from_the_baud_rate(baud: int, t1_5_us: int, t3_5_us: int) -> None:
    line = SerialFormat(baud)
    assert line.t1_5_ns // 1000 == t1_5_us
    assert line.t3_5_ns // 1000 == t3_5_us


@pytest.mark.parametrize(("baud", "microseconds"), [(38400, 286), (57600, 190), (115200, 95)])
def test_character_time_follows_from_the_baud_rate(baud: int, microseconds: int) -> None:
    assert SerialFormat(baud).character_ns // 1000 == microseconds


@pytest.mark.parametrize(
    ("text", "bits"), [("9600-8E1", 11), ("9600-8N1", 10), ("9600-8N2", 11), ("9600-7E1", 10)]
)
def test_character_has_start_data_parity_and_stop_bits(text: str, bits: int) -> None:
    assert SerialFormat.parse(text).character_bits == bits


@pytest.mark.parametrize(
    ("text", "t1_5_us", "t3_5_us"),
    [
        ("9600-8E1,t3.5=28bits", 1718, 2916),  # CHINO LT830: 2.9 ms at 9600 baud.
        ("19200-8E1,t3.5=28bits", 859, 1458),  # and 1.4 ms at 19200.
        ("115200-8N1,t3.5=5ms", 750, 5000),
        ("115200-8N1,t3.5=200us", 200, 200),  # t1.5 is never longer.
        ("9600-8N1,t1.5=2chars,t3.5=4chars", 2083, 4166),
        ("9600-8N1,t1.5=2.5ms", 2500, 3645),
    ],
)
def test_silences_can_be_given(text: str, t1_5_us: int, t3_5_us: int) -> None:
    line = SerialFormat.parse(text)
    assert (line.t1_5_ns // 1000, line.t3_5_ns // 1000) == (t1_5_us, t3_5_us)
    assert str(line) == text
    assert SerialFormat.parse(str(line)) == line


def test_given_silences_replace_earlier_ones() -> None:
    line = SerialFormat.parse("9600-8E1,t1.5=1ms,t3.5=5ms")
    assert str(line.with_silences(None, Silence.parse("6ms"))) == "9600-8E1,t1.5=1ms,t3.5=6ms"
    assert line.with_silences(None, None) == line


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("9600-8E1,t3.5", "'t3.5' is neither"),
        ("9600-8E1,", "'' is neither"),
        ("9600-8E1,t3.5=0ms", "silence '0ms'"),
        ("9600-8E1,t3.5=2s", "silence '2s'"),
        ("9600-8E1,t3.5=2000ms", "silence '2000ms': it must be longer than 0 and at most 1 s"),
        ("9600-8E1,t1.5=6ms,t3.5=5ms", "t1.5 of 6ms is longer than t3.5, 5ms"),
        ("9600-8E1,t1.5=6ms", "t1.5 of 6ms is longer than t3.5"),
    ],
)
def test_impossible_silences_are_usage_errors(text: str, why: str) -> None:
    with pytest.raises(UsageError) as caught:
        SerialFormat.parse(text)
    assert why in str(caught.value)


@pytest.mark.parametrize("text", ["19200-8E1", "9600-7O2", "115200-8N1"])
def test_settings_are_written_as_they_are_read(text: str) -> None:
    assert str(SerialFormat.parse(text)) == text


def test_letters_may_be_lower_case_and_the_format_may_be_left_out() -> None:
    assert SerialFormat.parse("9600-8n1") == SerialFormat(9600, 8, "N", 1)
    assert SerialFormat.parse("38400") == SerialFormat(38400, 8, "E", 1)


@pytest.mark.parametrize(
    "text", ["", "fast", "0", "9600-", "9600-8E", "9600-9N1", "9600-8N3", "9600 8N1", "9" * 5000]
)
def test_impossible_settings_are_usage_errors(text: str) -> None:
    with pytest.raises(UsageError, match="for example 19200-8E1"):
        SerialFormat.parse(text)


@pytest.mark.parametrize("baud", ["0", "1", "49", "4000001", "99999999"])
def test_a_rate_that_no_port_has_is_a_usage_error(baud: str) -> None:
    with pytest.raises(UsageError, match=f"no port has {baud} baud; write 50 to 4000000"):
        SerialFormat.parse(f"{baud}-8E1")


@pytest.mark.parametrize("baud", [50, 300, 4_000_000])
def test_a_rate_that_a_port_has_is_accepted(baud: int) -> None:
    assert SerialFormat.parse(str(baud)).baud == baud


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ((0, 8, "E", 1), "baud must be positive"),
        ((9600, 9, "E", 1), "no character format"),
        ((9600, 8, "e", 1), "no character format"),
        ((9600, 8, "NE", 1), "no character format"),
        ((9600, 8, "E", 3), "stop bits are 1 or 2"),
    ],
)
def test_no_impossible_format_can_be_made(settings: tuple[int, int, str, int], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        SerialFormat(*settings)
