"""Where a filter is wrong, and what is found."""

from __future__ import annotations

import pytest

from mbtool.cli.watching.prompt import hex_bytes, read_filter, why_wrong
from mbtool.core import UsageError


@pytest.mark.parametrize(
    ("text", "place", "reason"),
    [
        ("unit == 1 and foo == 2", 14, "there is no 'foo'"),
        ("unit == 300", 0, "unit is never 300"),
        ("outcome == 'fine'", 11, "outcome is never 'fine'"),
        ("unit ==", 7, "not complete"),
        ("unit == 1 and", 13, "not complete"),
        ("unit == 1 and )", 14, "not an expression from here"),
        ("link == '=' and unit = 5", 21, "write =="),
        ("outcome == no-answer", 11, 'write "no-answer"'),
    ],
)
def test_an_error_has_a_place_in_the_text(text: str, place: int, reason: str) -> None:
    with pytest.raises(UsageError) as caught:
        read_filter(text)
    at, why = why_wrong(text, caught.value)
    assert reason in why
    assert abs(at - place) <= 1, (at, why)


def test_beside_the_nearest_name_the_others_are_left_out() -> None:
    with pytest.raises(UsageError) as caught:
        read_filter("latncy > 4")
    assert why_wrong("latncy > 4", caught.value) == (
        0,
        "there is no 'latncy', did you mean 'latency_ms'?",
    )


def test_no_text_is_no_filter() -> None:
    assert read_filter("  ") is None


@pytest.mark.parametrize(
    ("text", "data"),
    [("01 03", b"\1\3"), ("0x0103", b"\1\3"), ("01:03", b"\1\3"), ("read", b""), ("013", b"")],
)
def test_bytes_in_hexadecimal(text: str, data: bytes) -> None:
    assert hex_bytes(text) == data
