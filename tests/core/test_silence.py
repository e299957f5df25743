"""Silences in a user's or a manual's units."""

from __future__ import annotations

import pytest

from mbtool.core.errors import UsageError
from mbtool.core.serial_format import Silence


@pytest.mark.parametrize(
    ("text", "written", "ns"),
    [
        ("28bits", "28bits", 2_916_666),
        ("28 Bits", "28bits", 2_916_666),
        ("3.5chars", "3.5chars", 4_010_416),
        ("5ms", "5ms", 5_000_000),
        ("5.0ms", "5ms", 5_000_000),
        ("750us", "750us", 750_000),
        ("100ms", "100ms", 100_000_000),
    ],
)
def test_reads_a_silence(text: str, written: str, ns: int) -> None:
    silence = Silence.parse(text)
    assert silence.ns(9600, 11) == ns
    assert str(silence) == written
    assert Silence.parse(written) == silence


@pytest.mark.parametrize(
    "text", ["", "5", "ms", "-5ms", "5s", "1e3ms", "٥ms", "9" * 5000 + "ms", "1.2345ms"]
)
def test_an_impossible_silence_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="for example 28bits or 5ms"):
        Silence.parse(text)


@pytest.mark.parametrize("text", ["0ms", "0.0bits", "1001ms", "99999999ms", "2000000bits"])
def test_a_silence_out_of_range_is_told_the_range(text: str) -> None:
    with pytest.raises(UsageError, match="it must be longer than 0 and at most 1 s"):
        Silence.parse(text)
