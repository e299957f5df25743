from __future__ import annotations

from mbtool.views.statistics_columns import (
    StatisticsColumn,
    StatisticsRow,
    StyledLine,
    more_line,
    shorten,
    table_lines,
    wrapped,
)

COLUMNS = (StatisticsColumn("n", 5), StatisticsColumn("ms", 5, 1), StatisticsColumn("max", 5, 2))
ROWS = (
    StatisticsRow("unit 1", ("1", "2.5", "9")),
    StatisticsRow("u" * 40, ("10", "", "99"), "red"),
)


def texts(width: int | None) -> list[str]:
    return [line.text for line in table_lines("poll", COLUMNS, ROWS, width)]


def test_the_first_column_is_as_wide_as_its_longest_text() -> None:
    assert texts(80) == [
        "poll                                         n    ms   max",
        "unit 1                                       1   2.5     9",
        "uuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuuu    10          99",
    ]


def test_columns_of_the_highest_rank_go_first_where_there_is_little_room() -> None:
    assert texts(46)[0].split() == ["poll", "n", "ms"]
    assert texts(42)[0].split() == ["poll", "n"]
    assert texts(20)[0].split() == ["poll", "n"]


def test_a_text_that_is_too_long_for_the_terminal_ends_in_two_dots() -> None:
    assert texts(30)[2] == "u" * 22 + "..    10"
    assert max(map(len, texts(30))) == 30


def test_a_pipe_has_all_columns_at_fixed_places_and_cuts_nothing() -> None:
    few = table_lines("poll", COLUMNS, ROWS[:1], None)
    assert few[0].text == texts(None)[0]
    long = StatisticsRow("x" * 60, ("1", "2", "3"))
    assert table_lines("poll", COLUMNS, (long,), None)[1].text.startswith("x" * 60 + " ")


def test_a_row_keeps_its_style_and_the_titles_are_bold() -> None:
    assert [line.style for line in table_lines("poll", COLUMNS, ROWS, 80)] == ["bold", "", "red"]


def test_control_characters_do_not_reach_the_terminal() -> None:
    hostile = StatisticsRow("\x1b[2J\nunit", ("1", "", ""))
    assert "\x1b" not in table_lines("poll", COLUMNS, (hostile,), 80)[1].text
    assert shorten("a\x07b", None) == "a?b"
    assert wrapped(StyledLine("a\x1bb"), None) == [StyledLine("a?b")]


def test_what_is_not_shown_is_counted() -> None:
    assert more_line(10, 10, "polls") == []
    (line,) = more_line(1300, 100, "polls")
    assert (line.text, line.hint) == ("  ... 1,200 more polls", "1300 shows all")


def test_a_sentence_goes_on_below_and_keeps_a_percent_sign_with_its_number() -> None:
    lines = wrapped(StyledLine("rtu rs485: 11 requests, 100 % answered", "bold"), 28)
    assert [line.text for line in lines] == ["rtu rs485: 11 requests,", "  100 % answered"]
    assert {line.style for line in lines} == {"bold"}
