"""Numbers that a user writes."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.core.numbers import parse_number, parse_unit


@pytest.mark.parametrize(("text", "unit"), [("0", 0), ("5", 5), ("005", 5), ("255", 255)])
def test_a_unit_is_0_to_255(text: str, unit: int) -> None:
    assert parse_unit(text, "--unit") == unit


@pytest.mark.parametrize("text", ["256", "-1", "+1", "x", "", " 1", "²", "٥", "0005", "9" * 5000])
def test_a_unit_that_is_none_is_refused_with_what_is_right(text: str) -> None:
    with pytest.raises(UsageError) as raised:
        parse_unit(text, "--unit", ", or all")
    assert str(raised.value) == (
        f"--unit: {text!r} is no unit; write a number from 0 to 255, or all"
    )


def test_the_range_may_begin_above_0() -> None:
    assert parse_number("65535", "port", range(1, 65536), "--port") == 65535
    with pytest.raises(UsageError, match="--port: '0' is no port; write a number from 1 to 65535"):
        parse_number("0", "port", range(1, 65536), "--port")
