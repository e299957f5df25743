"""Reading what a user saw on a display."""

from __future__ import annotations

import pytest

from mbtool.core.errors import UsageError
from mbtool.core.moments import DAY_NS, SECOND_NS
from mbtool.values.sightings import MAX_SEEN, parse_seen, parse_table, wanted_of

FIRST_NS = 1_790_000_000 * SECOND_NS
"""2026-09-21 14:13:20 UTC."""


def test_a_number_means_what_a_display_rounds_to_it() -> None:
    assert (parse_seen("23.4").value, parse_seen("23.4").tolerance) == (23.4, 0.05)
    assert parse_seen("1200").tolerance == 0.5
    assert parse_seen("-0.419").tolerance == pytest.approx(0.0005)


def test_name_tolerance_unit_and_time_are_read() -> None:
    seen = parse_seen("Flow temp=23.4+-0.2 degC@90s")
    assert (seen.name, seen.value, seen.tolerance, seen.unit) == ("Flow temp", 23.4, 0.2, "degC")
    assert seen.time is not None
    assert seen.time.at_ns(FIRST_NS) == FIRST_NS + 90 * SECOND_NS


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("@14:14", 40),
        ("@14:13:20.5", 0.5),
        ("@2026-09-21T14:13:30", 10),
        ("@00:00:00", 35_200),
        ("@14:13", -20),
        ("@14:12:20", -60),
        ("@14:12:19", 86_339),
        ("@09:00", 67_600),
    ],
)
def test_times_are_moments_or_times_of_day(text: str, seconds: float) -> None:
    time = parse_seen(f"5{text}").time
    assert time is not None
    assert time.at_ns(FIRST_NS) - FIRST_NS == seconds * SECOND_NS


def test_a_time_of_day_right_before_midnight_is_of_the_day_before() -> None:
    time = parse_seen("5@23:59:50").time
    assert time is not None
    midnight_ns = FIRST_NS // DAY_NS * DAY_NS
    assert time.at_ns(midnight_ns + 30 * SECOND_NS) == midnight_ns - 10 * SECOND_NS


@pytest.mark.parametrize("text", ["", "x", "23,4", "--wrong", "23.4@noon", "5@25:00", "=", "1=2=x"])
def test_other_texts_are_refused_in_one_line(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_seen(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "1e9999999",
        "1e400",
        "-1e31",
        "1e-31",
        "1e99999999999999999999",
        "9" * 400,
        f"5+-{'9' * 400}",
    ],
)
def test_numbers_of_no_size_that_a_device_has_are_refused_in_one_line(text: str) -> None:
    assert parse_seen("1e30").value == 1e30
    assert parse_seen("1e-30").tolerance == 5e-31
    with pytest.raises(UsageError, match="at most 1e30") as caught:
        parse_seen(text)
    assert len(str(caught.value)) < 200


def test_numbers_of_one_name_or_with_times_are_one_display() -> None:
    texts = ["U=230.1@1s", "U=230.4@9s", "23.4@1s", "23.9@9s", "7", "7"]
    wanted = wanted_of([parse_seen(text) for text in texts], FIRST_NS)
    assert [(one.name, len(one.sightings)) for one in wanted] == [
        ("U", 2),
        ("", 2),
        ("", 1),
        ("", 1),
    ]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_file_has_a_time_and_a_number_for_each_display(separator: str) -> None:
    text = "time,Flow,Return\n14:13:21,23.4,19.9\n14:13:30,23.9,\n".replace(",", separator)
    seen = parse_table(text, "seen.csv")
    assert [(one.name, one.value) for one in seen] == [
        ("Flow", 23.4),
        ("Return", 19.9),
        ("Flow", 23.9),
    ]
    (plain,) = parse_table(f"10s{separator}5.5\n", "seen.csv")
    assert plain.name == "value"


def test_an_empty_file_is_told() -> None:
    with pytest.raises(UsageError, match="no numbers"):
        parse_table("# nothing\n", "seen.csv")


def test_a_field_without_end_is_told() -> None:
    with pytest.raises(UsageError, match=r"seen\.csv: row 2: field larger than"):
        parse_table(f"time,Flow\n1s,{'1' * 131_073}\n", "seen.csv")


def test_the_reading_of_too_many_numbers_ends_at_the_first_one_too_many() -> None:
    text = f"1s{',5' * MAX_SEEN}\n"
    assert len(parse_table(text, "seen.csv")) == MAX_SEEN
    with pytest.raises(UsageError, match="more numbers than 10,000"):
        parse_table(f"{text}2s,not read", "seen.csv")
