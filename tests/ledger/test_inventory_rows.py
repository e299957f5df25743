"""The rows of an inventory."""

from __future__ import annotations

from mbtool.ledger.inventory_rows import iso_time, shown_host


def test_times_are_iso_to_the_microsecond() -> None:
    assert iso_time(1_700_000_000_123_456_789) == "2023-11-14T22:13:20.123456Z"
    assert iso_time(0) == "1970-01-01T00:00:00.000000Z"


def test_a_time_that_no_calendar_has_is_empty() -> None:
    assert iso_time(2**70) == ""


def test_a_host_has_its_port_unless_that_is_502() -> None:
    assert shown_host("10.0.0.7", 502) == shown_host("10.0.0.7", None) == "10.0.0.7"
    assert shown_host("10.0.0.7", 1502) == "10.0.0.7:1502"
    assert shown_host("fd00::7", 1502) == "[fd00::7]:1502"
