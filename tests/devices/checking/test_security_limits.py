from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.devices.checking.rules import RULES
from mbtool.devices.checking.security_limits import SecurityLimit, SecurityLimits


def test_a_limit_is_a_number_of_cases_and_a_time() -> None:
    limits = SecurityLimits.parse(["SEC-201=20/60s", " sec-205=3/1.5 min "])
    assert limits.host_scan == SecurityLimit(20, 60_000_000_000)
    assert limits.identification == SecurityLimit(3, 90_000_000_000)
    assert limits.unit_scan == SecurityLimits().unit_scan


@pytest.mark.parametrize(
    ("text", "window_ns"),
    [("1ms", 10**6), ("250ms", 250 * 10**6), ("2s", 2 * 10**9), ("5min", 300 * 10**9),
     ("24h", 86400 * 10**9)],
)  # fmt: skip
def test_a_time_has_a_unit(text: str, window_ns: int) -> None:
    assert SecurityLimits.parse([f"SEC-202=5/{text}"]).unit_scan == SecurityLimit(5, window_ns)


def test_the_limit_of_writes_holds_for_networks_and_lines() -> None:
    usual = SecurityLimits()
    assert usual.write_flood.number > usual.line_write_flood.number
    limits = SecurityLimits.parse(["SEC-102=7/1s"])
    assert limits.write_flood == limits.line_write_flood == SecurityLimit(7, 10**9)


def test_each_rule_about_attacks_has_a_limit() -> None:
    usual = SecurityLimits()
    codes = [code for code in RULES if code.startswith("SEC-")]
    assert len(codes) == 8
    for code in codes:
        assert SecurityLimits.parse([f"{code}=4096/23h"]) != usual


@pytest.mark.parametrize(
    ("texts", "says"),
    [
        (["SEC-201"], "'SEC-201' is no limit; write CODE=NUMBER/TIME, for example SEC-201=20/60s"),
        (["SEC-201=20"], "is no limit"),
        (["SEC-201=20/60"], "is no limit; .* with a time in ms, s, min or h"),
        (["SEC-201=-1/60s"], "is no limit"),
        (["SEC-201=٢/60s"], "is no limit"),
        (["SEC-201=20/60s,SEC-202=1/1s"], "is no limit"),
        (["SEC-206=20/60s"], "'SEC-206' has no limit; those that have: SEC-101, .*, SEC-205"),
        (["MB-101=20/60s"], "'MB-101' has no limit"),
        (["SEC-201=0/60s"], "the number is from 1 to 4096"),
        (["SEC-201=4097/60s"], "the number is from 1 to 4096"),
        (["SEC-201=20/0s"], "the time is from 1ms to 24h"),
        (["SEC-201=20/25h"], "the time is from 1ms to 24h"),
        (["SEC-102=20/1s", "sec-102=30/1s"], "SEC-102 is named twice"),
    ],
)  # fmt: skip
def test_a_wrong_limit_is_told_in_one_line(texts: list[str], says: str) -> None:
    with pytest.raises(UsageError, match=says) as caught:
        SecurityLimits.parse(texts)
    assert str(caught.value).startswith("--limit: ")
    assert "\n" not in str(caught.value)
