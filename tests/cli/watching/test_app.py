"""The full screen on records that the test gives; the keys are in test_keys.py."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from textual.widgets import OptionList

from mbtool.cli import exit_codes
from mbtool.cli.watching.app import key_name
from mbtool.core import EventKind, OutputError, WireEvent
from mbtool.devices import PointValue
from mbtool.watching.value_formats import ValueFormat
from tests.cli.watching.screens import GivenFeed, run, screen
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import LINE, request, unanswered

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.watching.watched_rows import Record
    from tests.cli.watching.screens import Screen


def read(at_ms: float, *values: int, **fields: Any) -> Record:
    defaults = {"reference": "holding 0..1", "response_values": list(values), "quantity": 2}
    return request(at_ms, **{**defaults, **fields})


def line() -> GivenFeed:
    """A slave that answers, one that does not, and noise."""
    return GivenFeed([
        read(0, 10, 20),
        read(100, 10, 21),
        WireEvent(
            ts_ns=START_NS + 150 * MS, link="line", kind=EventKind.SKIPPED, message="noise",
            raw=b"\xfe\xfd",
        ),
        unanswered(200, unit=2, reference="holding 0..9"),
        read(300, 7, 7, address=100, reference="holding 100..101", findings=["MB-101"]),
    ])  # fmt: skip


@pytest.mark.usefixtures("_one_line_of_troubles")
def test_the_polls_are_shown_first_with_what_changed_lit() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            assert "1 polls" in seen.lines[0]
            assert "4 transactions, 1 event" in seen.lines[1]
            assert seen.lines[4].split()[:5] == ["1", "03", "holding", "0..1", "10"]
            (strip,) = [one for one in seen.app.table.render_line(1)._segments if one.text == "21"]
            assert strip.style is not None
            assert strip.style.reverse
            assert "no answer" in seen.lines[5]

    run(test)


def test_slaves_in_trouble_and_whose_row_it_is_stand_in_each_view() -> None:
    feed = GivenFeed(
        [
            *(read(at, 1, link="10.0.0.2") for at in range(3)),
            *(unanswered(at, link="10.0.0.7", reference="holding 0..9") for at in range(3)),
        ]
    )

    async def test() -> None:
        async with screen(feed) as seen:
            for key in "31":
                await seen.press(key)
                assert seen.lines[2].startswith("! unit 1 at 10.0.0.7 never answers (3 requests)")
                assert any(".7     1 03 " in line for line in seen.lines)
            feed.give(*(read(at, 1, link="10.0.0.7") for at in range(900, 1300)))
            seen.app._next_look_s = 0
            await seen.redraw()
            assert "request" in seen.lines[2]

    run(test)


def test_the_line_of_slaves_in_trouble_judges_all_records_under_a_filter() -> None:
    feed = GivenFeed([*(read(at, 1) for at in range(6)), *(unanswered(at) for at in range(6, 9))])

    async def test() -> None:
        async with screen(feed) as seen:
            seen.app.apply_filter('outcome != "ok"')
            seen.app._next_look_s = 0
            await seen.redraw()
            assert "3 pass" in seen.lines[1]
            assert seen.lines[2].startswith("! unit 1 leaves 3 of its 9 requests (33 %)")

    run(test)


def test_transactions_follow_the_newest_until_the_cursor_goes_up() -> None:
    async def test() -> None:
        feed = line()
        async with screen(feed) as seen:
            await seen.press("3")
            feed.give(*(read(1000 + at, 1, 2) for at in range(30)))
            await seen.redraw()
            assert seen.number() == 34
            await seen.press("up")
            feed.give(read(2000, 1, 2))
            await seen.redraw()
            assert seen.number() == 33
            await seen.press("end")
            feed.give(read(3000, 1, 2))
            await seen.redraw()
            assert seen.number() == 36
            await seen.press("home")
            assert seen.number() == 1
            await seen.press("pagedown")
            assert seen.app.table.cursor == seen.app.table.page

    run(test)


def test_space_freezes_the_view_while_counting_goes_on() -> None:
    async def test() -> None:
        feed = line()
        async with screen(feed) as seen:
            await seen.press("space")
            feed.give(read(400, 99, 99))
            await seen.redraw()
            assert "FROZEN" in seen.lines[1]
            assert "5 transactions" in seen.lines[1]
            assert "99" not in seen.lines[3]
            await seen.press("3")
            assert len(seen.rows) == 5
            await seen.press("space")
            assert len(seen.rows) == 6
            assert "FROZEN" not in seen.text

    run(test)


def test_a_filter_is_applied_as_one_types_and_kept_with_enter() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("slash")
            await seen.type("unit == 2")
            await seen.until(lambda: len(seen.rows) == 1)
            await seen.press("enter")
            assert "1 passes: unit == 2" in seen.lines[1]
            assert not seen.app.prompt.has_focus
            assert seen.app.settings.filters == ["unit == 2"]

    run(test)


def test_a_filter_that_comes_too_late_for_some_says_of_how_many_it_counts() -> None:
    async def test() -> None:
        feed = GivenFeed([read(at, 1, unit=at) for at in range(3)], kept=2)
        async with screen(feed) as seen:
            seen.app.apply_filter("unit == 2")
            assert "3 transactions, 0 events  1 of the last 2 passes: unit == 2" in seen.lines[1]
            feed.give(read(9, 1, unit=2))
            seen.app.apply_filter("unit == 2 and latency_ms > 1 and address < 999")
            feed.give(read(19, 1, unit=2))
            await seen.redraw()
            assert seen.lines[1].startswith("5 transactions  3 of last 3 pass: unit == 2 and ")

    run(test)


def test_what_is_watched_is_seen_beside_a_filter() -> None:
    async def test() -> None:
        feed = GivenFeed([read(at, 1, unit=1 + at % 3) for at in range(60)])
        async with screen(feed) as seen:
            long = "unit == 2 and address >= 0 and outcome"
            longer = "unit == 2 and address >= 0 and function in (1, 2, 3, 4)"
            for where, told in (
                ("unit == 2", "60 transactions, 0 events  20 pass: unit == 2  line"),
                (f'{long} == "ok"', f'60 transactions  20 pass: {long} == "ok"  line'),
                (longer, f"20 of 60 pass: {longer}  line"),
            ):
                seen.app.apply_filter(where)
                assert seen.lines[1] == told
            seen.app.apply_filter(f"{longer} and unit == 2")
            assert seen.lines[1] == f"{f'20 of 60 pass: {longer} …':<74}  line"

    run(test)


def test_the_view_of_the_bus_says_why_it_has_no_histogram() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("6")
            assert seen.rows[-1].text == "latency of all: shown from 20 answers on; here 3"
        async with screen(GivenFeed()) as seen:
            await seen.press("6")
            assert [row.text for row in seen.rows] == ["no transactions so far"]

    run(test)


def test_a_wrong_filter_says_where_and_leaves_the_rows_as_they_are() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("slash")
            await seen.type("unit == 2 and foo == 1")
            await seen.until(lambda: "there is no 'foo'" in seen.note)
            assert seen.note.index("^") == "unit == 2 and foo".index("foo")
            assert len(seen.rows) == 3
            await seen.until(lambda: seen.lines[-2].endswith("docs/filters.md"))
            await seen.press("enter")
            assert seen.app.prompt.has_focus

    run(test)


def test_escape_gives_the_earlier_filter_back() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("slash")
            await seen.type("unit == 2")
            await seen.until(lambda: len(seen.rows) == 1)
            await seen.press("escape")
            await seen.until(lambda: len(seen.rows) == 3)
            assert seen.app.where == ""

    run(test)


def test_f_finds_a_text_and_bytes_and_n_goes_on() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("3", "home", "f")
            await seen.type("10, 2")
            await seen.press("enter")
            assert seen.number() == 2
            await seen.press("n")
            assert seen.number() == 1
            await seen.press("N")
            assert seen.number() == 2
            await seen.press("f")
            await seen.type("fe fd")
            await seen.press("enter")
            assert seen.number() is None
            await seen.press("f")
            await seen.type("nowhere")
            await seen.press("enter")
            assert "not found" in seen.note

    run(test)


def test_a_view_that_has_only_the_last_records_says_so_and_so_does_find() -> None:
    async def test() -> None:
        feed = GivenFeed((read(at, at, 0) for at in range(8)), kept=5)
        async with screen(feed) as seen:
            assert "last" not in seen.lines[0]
            await seen.press("3", "o", "down", "enter")
            await seen.pilot.pause()
            assert seen.lines[0].endswith("6 bus              last 5 of 8")
            await seen.press("f")
            await seen.type("holding 0..1 -> 0, 0")
            await seen.press("enter")
            told = "not found as text among the last 5 of 8: holding 0..1 -> 0, 0"
            assert seen.note == told
            feed.is_live = False
            await seen.press("n")
            assert seen.note == f"{told}; --where filters all"
            await seen.press("4")
            assert seen.lines[0].endswith("more rules: mbtool check")
            feed.give(read(9, 1, 2, findings=["MB-101"]))
            await seen.redraw()
            await seen.press("f")
            await seen.type("mb-101")
            await seen.press("enter")
            assert seen.note == "mb-101: row 1 of 1 kinds of events and findings; n next, N back"

    run(test)


def test_bad_hexadecimal_is_told_to_be_searched_as_text() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            for text, told in (("01 03 0g", "as text"), ("aa bb", "as text or bytes")):
                await seen.press("f")
                await seen.type(text)
                await seen.press("enter")
                assert seen.note == f"not found {told}: {text}"

    run(test)


@pytest.mark.usefixtures("_one_line_of_troubles")
def test_o_sorts_by_a_column_and_turns_the_order() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("o")
            await seen.pilot.pause()
            await seen.press(*["down"] * 3, "enter")
            await seen.pilot.pause()
            assert seen.app.settings.sorted_by == {"polls": ("unit", False)}
            assert [row.poll.unit for row in seen.rows] == [1, 1, 2]
            assert "un^" in seen.lines[3]
            await seen.press("o", "enter")
            await seen.pilot.pause()
            assert [row.poll.unit for row in seen.rows] == [2, 1, 1]
            await seen.press("o", "home", "enter")
            assert seen.app.settings.sorted_by == {}

    run(test)


@pytest.mark.usefixtures("_one_line_of_troubles")
def test_c_chooses_columns_and_they_are_remembered(config_folder: Path) -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("c", "space", "enter")
            await seen.pilot.pause()
            assert "link" in seen.lines[3]
            await seen.press("c")
            assert "[x] link" in "\n".join(
                str(one.prompt) for one in seen.app.screen.query_one(OptionList).options
            )
            await seen.press("escape")
        async with screen(line()) as seen:
            assert "link" in seen.lines[3]
            await seen.press("c", "u")
            await seen.pilot.pause()
            assert "link" not in seen.lines[3]

    run(test)
    assert (config_folder / "mbtool" / "watch.json").exists()


def test_c_says_which_columns_have_no_room_and_enter_alone_changes_nothing() -> None:
    async def test() -> None:
        values = [40_000 + at for at in range(60)]
        async with screen(GivenFeed([read(0, *values)]), (64, 24)) as seen:
            await seen.press("c")
            await seen.pilot.pause()
            assert "[x] trend  no room at this width" in seen.text
            assert "[x] values " in seen.text
            await seen.press("enter")
            await seen.pilot.pause()
            assert seen.app.settings.columns == {}

    run(test)


def test_damaged_settings_are_told_in_the_screen(config_folder: Path) -> None:
    (config_folder / "mbtool").mkdir()
    (config_folder / "mbtool" / "watch.json").write_text("{")

    async def test() -> None:
        async with screen(line()) as seen:
            assert "watch.json: damaged: Input data was truncated; columns" in seen.note

    run(test)


def test_settings_of_columns_that_are_not_there_change_nothing(config_folder: Path) -> None:
    (config_folder / "mbtool").mkdir()
    (config_folder / "mbtool" / "watch.json").write_text(
        '{"columns": {"polls": ["gone"]}, "sorted_by": {"polls": ["gone", true]}}'
    )

    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("o")
            await seen.pilot.pause()
            assert seen.app.screen.query_one(OptionList).highlighted == 0

    run(test)


@pytest.mark.usefixtures("_one_line_of_troubles")
def test_x_shows_the_row_in_the_next_format() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            for form in (ValueFormat.DECIMAL, ValueFormat.HEX):
                await seen.press("x")
                assert form.value in seen.note
            assert "000AH 0015H" in seen.lines[4]
            await seen.press("2", "down", "x", "x")
            assert "0015H" in seen.lines[5]
            await seen.press("5", "x")

    run(test)


def test_an_answer_to_a_key_goes_with_its_view_and_a_warning_stays() -> None:
    async def test() -> None:
        feed = line()
        async with screen(feed) as seen:
            await seen.press("x")
            assert "shown decimal" in seen.note
            await seen.press("2")
            assert not seen.note
            feed.remarks.append("eth0: lost 3 packets")
            await seen.until(lambda: "lost 3 packets" in seen.note)
            await seen.press("3")
            assert "lost 3 packets" in seen.note

    run(test)


def test_enter_shows_the_bytes_by_field_and_why_this_direction() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("down", "down", "enter")
            await seen.redraw()
            text = "\n".join(
                "".join(part for part, _ in spans) for spans in seen.app.detail_lines(78)
            )
            assert "unit 1 function 03H address 100 quantity" in text
            assert "only one direction can have this form; sure to 100 %" in text
            assert "MB-101" in text
            assert "request  01 03 00 64" in seen.text
            await seen.press("right_square_bracket", "left_square_bracket", "5")
            await seen.redraw()
            assert "asked 3, answered 3" in seen.text
            await seen.press("escape")
            await seen.redraw()
            assert "asked 3, answered 3" not in seen.text

    run(test)


def test_the_detail_of_a_request_shows_its_damaged_response() -> None:
    frame = WireEvent(
        ts_ns=START_NS + 12 * MS, link="line", kind=EventKind.BAD_CHECK, message="x", raw=b"\xfe"
    )

    async def test() -> None:
        async with screen(GivenFeed([read(0, 1, 2), frame, unanswered(10)])) as seen:
            for keys in (("3", "up"), ("1", "down")):
                await seen.press(*keys)
                (response,) = (
                    line for line in seen.app.detail_lines(78) if line[0][0] == "response "
                )
                assert response[1][0] == "fe"

    run(test)


def test_a_view_without_rows_has_no_detail() -> None:
    async def test() -> None:
        async with screen(GivenFeed()) as seen:
            for key in "123456":
                await seen.press(key, "down", "pageup", "end", "m", "x")
            await seen.press("enter")
            await seen.redraw()
            assert "no transaction here" in seen.text

    run(test)


def test_a_signal_or_the_end_of_the_duration_ends_the_screen() -> None:
    async def test() -> None:
        async with screen(line(), is_asked_to_end=lambda: True) as seen:
            await seen.until(lambda: seen.app.return_value is not None)
            assert seen.app.return_value == exit_codes.DONE

    run(test)


def test_remarks_and_the_error_that_ended_the_feed_are_told() -> None:
    async def test() -> None:
        feed = line()
        async with screen(feed) as seen:
            feed.remarks.append("eth0: lost 3 packets")
            await seen.until(lambda: "lost 3 packets" in seen.note)
            await seen.press("escape")
            feed.error = OutputError("the log is full")
            await seen.until(lambda: "the log is full; q ends" in seen.note)

    run(test)


def test_text_from_a_wire_is_no_markup() -> None:
    async def test() -> None:
        feed = GivenFeed([read(0, 1, 2, reference="[bold]x[/bold]\x1b[2J")])
        async with screen(feed, (120, 40)) as seen:
            assert "[bold]x[/bold]?[2J" in seen.text
            await seen.press("3", "enter")
            await seen.redraw()
            assert "[bold]x[/bold]?[2J" in seen.text

    run(test)


@pytest.mark.usefixtures("_one_line_of_troubles")
def test_without_colours_the_row_of_the_cursor_and_what_changed_are_reversed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("NO_COLOR", "1")

    async def test() -> None:
        async with screen(line()) as seen:
            reversed_at = [
                [one.text.strip() for one in strip if one.style and one.style.reverse]
                for strip in seen.app.screen._compositor.render_strips()
            ]
            assert reversed_at[0] == ["1 polls"]
            assert not any("21" in text for text in reversed_at[4])
            assert any("holding 0..1" in text for text in reversed_at[4])
            assert not reversed_at[6]
            await seen.press("down")
            assert "21" in [
                one.text for one in seen.app.table.render_line(1) if one.style and one.style.reverse
            ]
            await seen.press("o")
            await seen.pilot.pause()
            styles = {
                str(colour)
                for strip in seen.app.screen._compositor.render_strips()
                for one in strip
                if one.style
                for colour in (one.style.color, one.style.bgcolor)
                if colour is not None and not colour.is_default
            }
            assert not styles
            chosen, other = map(seen.app.screen.query_one(OptionList).render_line, (0, 1))
            assert [bool(one.style and one.style.underline) for one in chosen] == [True, True]
            assert not any(one.style and one.style.underline for one in other)

    run(test)


def test_a_view_without_rows_says_why() -> None:
    async def test() -> None:
        feed = GivenFeed()
        async with screen(feed) as seen:
            for key, text in (("1", "no requests heard yet"), ("2", "no values read or written")):
                await seen.press(key)
                assert text in seen.text
            feed.give(read(0, 1, 2))
            seen.app.apply_filter("unit == 9")
            assert "no values read or written pass the filter; \\ switches it off" in seen.text

    run(test)


def differs(seen: Screen, line: str) -> bool:
    return seen.lines[3] != line


def test_the_help_begins_with_the_views_and_all_of_it_can_be_reached() -> None:
    async def test() -> None:
        async with screen(line()) as seen:
            await seen.press("question_mark")
            await seen.until(lambda: "Keys and signs" in seen.lines[1])
            assert "1 View polls" in seen.lines[3]
            read_lines = [*seen.lines]
            while "a broken rule" not in seen.text:
                top = seen.lines[3]
                await seen.press("pagedown")
                await seen.until(partial(differs, seen, top))
                read_lines += seen.lines
            for binding in seen.app.BINDINGS:
                keys = f" {key_name(binding)} {binding.description}"
                assert any(keys in one for one in read_lines), keys
            assert not any("Focus" in one for one in read_lines)

    run(test)


def test_the_view_of_the_bus_names_no_option_that_watch_lacks() -> None:
    feed = GivenFeed(read(at, 1, address=at, reference=f"holding {at}") for at in range(52))

    async def test() -> None:
        async with screen(feed) as seen:
            await seen.press("6")
            (more,) = (row.text for row in seen.rows if "more polls" in row.text)
            assert more == "  ... 2 more polls: key 1 lists all"
            assert not any("--top" in row.text for row in seen.rows)

    run(test)


def test_at_80_columns_the_state_of_a_slave_has_room_when_it_changes() -> None:
    feed = GivenFeed((read(at, 1) for at in range(0, 9000, 500)), format_=LINE)

    async def test() -> None:
        async with screen(feed) as seen:
            await seen.press("5")
            assert "answers" in seen.lines[3]
            for at in range(9000, 12000, 500):
                feed.give(unanswered(at), read(at + 100, 1))
            seen.app._next_look_s = 0
            await seen.redraw()
            assert any(line.endswith(" 50 % unanswered since 00:00:09") for line in seen.lines)

    run(test)


def test_at_80_columns_values_with_long_names_are_shown() -> None:
    names = [f"CH{number} digital operation value" for number in range(1, 9)]
    points = [
        PointValue(name=name, reference=f"RWr{at}", value=4000 + at, text=str(4000 + at))
        for at, name in enumerate(names)
    ]
    feed = GivenFeed([read(0, *range(8), reference="RWr0..RWr7", points=points, device="x")])

    async def test() -> None:
        async with screen(feed) as seen:
            assert "RWr0..RWr7 CH1 4000, CH2 4001" in seen.text
            await seen.press("2")
            assert [line.split()[2:6] for line in seen.lines[3:5]] == [
                ["CH1", "digital", "operation", "value"],
                ["CH2", "digital", "operation", "value"],
            ]
            await seen.press("3")
            assert "read RWr0..RWr7 -> CH1 4000, CH2 4001, " in seen.text

    run(test)
