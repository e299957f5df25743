from __future__ import annotations

import io
from typing import Any

from rich.console import Console

from mbtool.devices.checking.finding import Finding
from mbtool.troubles.broken_rules import MAX_PLACES, Summaries, where
from mbtool.views.findings_table import finding_line, print_summaries

NOON_NS = 1_767_268_800_000_000_000
"""2026-01-01 12:00 UTC."""


def finding(code: str = "FT1A-Q16", *, at_s: int = 0, **fields: Any) -> Finding:
    at_ns = NOON_NS + at_s * 10**9
    return Finding(
        **{"code": code, "message": "limit is 100", "ts_ns": at_ns, "link": "rs485", **fields}
    )


def shown(*findings: Finding, width: int | None = None, file: str = "") -> str:
    """As in a pipe, or on a terminal of a width."""
    summaries = Summaries()
    for one in findings:
        summaries.add(one, file)
    output = io.StringIO()
    console = Console(
        file=output, width=width or 80, force_terminal=width is not None, color_system=None
    )
    print_summaries(console, summaries)
    return output.getvalue()


def test_each_code_is_shown_with_its_number_and_its_first_and_last_finding() -> None:
    several = [finding(at_s=at, message=f"at {at}", unit=1) for at in (5, 3, 9)]
    assert shown(*several, finding("MB-402", count=7)) == (
        "FT1A-Q16  error    3 times  rs485 unit 1\n"
        "    first 2026-01-01 12:00:03.000: at 3\n"
        "    last  2026-01-01 12:00:09.000: at 9\n"
        "MB-402    warning  7 times  rs485\n"
        "    2026-01-01 12:00:00.000: limit is 100\n"
    )


def test_a_message_that_the_first_and_the_last_share_is_shown_once() -> None:
    assert shown(finding(at_s=1), finding(at_s=2)).splitlines()[1:] == [
        "    first 2026-01-01 12:00:01.000: limit is 100",
        "    last  2026-01-01 12:00:02.000: the same",
    ]


def test_each_place_is_shown_the_worst_first() -> None:
    text = shown(
        finding(unit=1, device="fa3-x0"),
        finding(unit=2, count=3),
        finding(unit=1, device="fa3-x0"),
        file="a.pcap",
    )
    assert [line for line in text.splitlines() if line.startswith("FT1A")] == [
        "FT1A-Q16  error  3 times  rs485 unit 2, a.pcap",
        "FT1A-Q16  error  2 times  rs485 unit 1, fa3-x0, a.pcap",
    ]


def test_an_attack_has_an_entry_for_each_host_that_makes_it() -> None:
    sources = ("10.0.0.9:40000", "10.0.0.9:40001", "10.0.0.8:40000")
    text = shown(*(finding("SEC-201", source=source) for source in sources))
    assert [line.split()[2] for line in text.splitlines() if "SEC" in line] == ["2", "1"]


def test_places_beyond_the_first_five_are_counted_together() -> None:
    text = shown(*(finding(unit=unit) for unit in range(MAX_PLACES + 2)), finding(unit=0))
    assert text.count("FT1A-Q16") == MAX_PLACES
    assert text.endswith("\n    and 2 times at other places\n")


def test_errors_come_first() -> None:
    text = shown(finding("MB-404"), finding("RTU-201"), finding("MB-402"), finding("FT1A-F1"))
    codes = [line.split()[0] for line in text.splitlines()[::2]]
    assert codes == ["FT1A-F1", "MB-402", "RTU-201", "MB-404"]


def test_a_hundred_thousand_findings_of_a_place_are_one_entry() -> None:
    summaries = Summaries()
    one = finding()
    for _ in range(100_000):
        summaries.add(one)
    ((_, summary),) = summaries
    assert [place.number for place in summary.places()] == [100_000]


def test_without_findings_nothing_is_shown() -> None:
    assert not Summaries()
    assert shown() == ""


def test_a_long_message_is_broken_on_a_terminal_only() -> None:
    message = "word " * 30
    assert max(map(len, shown(finding(message=message), width=60).splitlines()[1:])) <= 60
    assert len(shown(finding(message=message)).splitlines()) == 2


def test_what_came_off_a_wire_is_not_obeyed() -> None:
    text = shown(finding(message="[red]\x1b[2J", link="\x1b]0;x"))
    assert "\x1b" not in text
    assert "[red]?[2J" in text


def test_a_finding_is_a_line() -> None:
    line = finding_line(finding("MB-404", unit=3, count=2)).plain
    assert line == "2026-01-01 12:00:00.000  MB-404     rs485 unit 3: limit is 100 (2 times)"


def test_where_names_the_unit_where_one_is_meant() -> None:
    assert where(finding()) == "rs485"
    assert where(finding(unit=0)) == "rs485 unit 0"
