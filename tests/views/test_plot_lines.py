"""Charts of few values, whose every character was reckoned by hand."""

from __future__ import annotations

from mbtool.values.value_series import SeriesSample, ValueSeries
from mbtool.values.values import SeriesKey
from mbtool.views.plot_lines import PlotSize, extents, plot_lines

KEY = SeriesKey("rs485", 5, "x")


def series_of(*values: tuple[int, float], bit: bool = False) -> ValueSeries:
    made = ValueSeries("holding 7", bit=bit)
    for ts_ns, value in values:
        made.add(ts_ns, value)
    return made


def drawn(one: ValueSeries, *, unicode: bool = False, width: int = 13) -> list[str]:
    return [line.text for line in plot_lines([(KEY, one)], 0, 80, PlotSize(width, 3, unicode))]


def test_a_column_shows_all_from_the_least_to_the_greatest_value() -> None:
    samples = [SeriesSample(10, 1), SeriesSample(40, 9), SeriesSample(42, 2), SeriesSample(80, 4)]
    assert extents(samples, 0, 80, 8) == [
        None, (1, 1), (1, 1), (1, 1), (1, 9), (2, 2), (2, 2), (2, 4),
    ]  # fmt: skip


def test_numbers_are_steps_with_the_extremes_beside_them() -> None:
    title, *chart, _ = drawn(series_of((0, 0), (40, 10)))
    assert title == "holding 7, un"
    assert chart == ["10      *****", "        *", " 0 ******"]


def test_braille_has_two_columns_and_four_rows_a_character() -> None:
    _, *chart, _ = drawn(series_of((0, 0), (40, 10)), unicode=True)
    assert chart == ["10      ⡏⠉⠉⠉⠉", "        ⡇", " 0 ⣀⣀⣀⣀⣀⡇"]


def test_a_bit_is_a_band() -> None:
    one = series_of((0, 0), (40, 1), (72, 0), bit=True)
    _, ascii_band, _ = drawn(one, width=11)
    assert ascii_band == " _____+###+"
    _, band, _ = drawn(one, width=11, unicode=True)
    assert band == " ▁▁▁▁▁▄███▄"


def test_a_value_that_never_changes_has_a_line_only() -> None:
    title, axis = drawn(series_of((0, 7)), width=60)
    assert title == "holding 7, unit 5: always 7"
    assert axis.strip().startswith("1970-01-01 00:00:00.000")


def test_titles_have_no_control_characters() -> None:
    one = series_of((0, 1), (2, 3))
    one.name = "\x1b]0;evil\x07"
    assert drawn(one, width=60)[0].startswith("?]0;evil?, unit 5: 1 to 3, 1 change")
