"""The table of polled values for spreadsheets."""

from __future__ import annotations

from mbtool.devices import PointValue
from mbtool.views.polled_values import MAX_HELD, PolledValues

AT_NS = 1_773_738_843_014_000_000


def point(name: str, value: float | None, text: str = "", unit: str | None = None) -> PointValue:
    return PointValue(name=name, reference="", value=value, text=text, unit=unit)


def test_each_round_is_a_row_with_a_column_for_each_value() -> None:
    table = PolledValues([b"a", b"b"])
    flow = [point("Flow", 23.5, unit="degC"), point("State", None, "on")]
    assert table.lines(AT_NS, {b"a": flow, b"b": [point("HR7", 3)]}) == (
        "time,Flow (degC),State,HR7\n2026-03-17 09:14:03.014,23.5,on,3\n"
    )
    assert table.lines(AT_NS, {b"b": [point("HR7", 4)]}) == "2026-03-17 09:14:03.014,,,4\n"


def test_rows_wait_for_the_first_answer_of_every_request_but_not_for_ever() -> None:
    table = PolledValues([b"a", b"b"])
    for _ in range(MAX_HELD - 1):
        assert table.lines(AT_NS, {b"a": [point("HR7", 3)]}) == ""
    lines = table.lines(AT_NS, {b"a": [point("HR7", 3)]}).splitlines()
    assert lines[0] == "time,HR7"
    assert len(lines) == 1 + MAX_HELD


def test_only_the_newest_rows_wait_for_the_first_answer_of_all() -> None:
    table = PolledValues([b"a"])
    for at in range(3 * MAX_HELD):
        assert table.lines(AT_NS + at * 1_000_000_000, {}) == ""
    answered_ns = AT_NS + 3 * MAX_HELD * 1_000_000_000
    lines = table.lines(answered_ns, {b"a": [point("HR7", 3)]}).splitlines()
    assert len(lines) == 1 + MAX_HELD
    assert lines[-1] == "2026-03-17 09:14:33.014,3"


def test_what_is_held_back_is_written_at_the_end() -> None:
    table = PolledValues([b"a", b"b"])
    assert table.lines(AT_NS, {b"a": [point("HR7", 3)]}) == ""
    assert table.take_held_lines() == "time,HR7\n2026-03-17 09:14:03.014,3\n"
    assert PolledValues([b"a"]).take_held_lines() == ""
