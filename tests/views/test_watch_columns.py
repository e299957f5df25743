"""Live tables: which columns fit, and how cells are cut."""

from __future__ import annotations

import pytest

from mbtool.views.watch_columns import (
    LEAST_REST,
    DrawContext,
    WatchColumn,
    cut_spans,
    fitted,
    left_out,
    row_spans,
    row_text,
    title_spans,
    widest_cells,
)
from mbtool.views.watch_polls import POINT_COLUMNS, POLL_COLUMNS
from mbtool.views.watch_records import RECORD_COLUMNS, SLAVE_COLUMNS, TROUBLE_COLUMNS


def column(name: str, width: int, rank: int = 0, *, usual: bool = True) -> WatchColumn:
    return WatchColumn(
        name=name, title=name, width=width, rank=rank, is_usual=usual,
        cell=lambda row, _: row[name], sort=lambda row: row[name],
    )  # fmt: skip


COLUMNS = (column("unit", 4), column("text", 0), column("ms", 6, 1), column("more", 8, 2),
           column("rare", 5, usual=False))  # fmt: skip


@pytest.mark.parametrize(
    ("width", "names"),
    [
        (80, ["unit", "text", "ms", "more"]),
        (38, ["unit", "text", "ms"]),
        (33, ["unit", "text"]),
        (5, ["unit", "text"]),
    ],
)
def test_columns_of_high_rank_are_left_out_where_there_is_little_room(
    width: int, names: list[str]
) -> None:
    assert [one.column.name for one in fitted(COLUMNS, width)] == names


def test_on_a_very_narrow_screen_the_values_of_polls_keep_room() -> None:
    def names(width: int) -> list[str]:
        shown = {one.column.name: one.width for one in fitted(POLL_COLUMNS, width)}
        assert shown.pop("values") >= min(LEAST_REST, width - len("un ") - 2 - 23)
        return [*shown]

    everything = ["unit", "request", "age", "every", "count", "errors", "ms", "trend"]
    assert names(110) == everything
    assert names(80) == everything[:6]
    assert names(60) == ["unit", "request", "age", "errors"]
    assert names(50) == ["unit", "request"]
    assert names(40) == ["unit", "request"]


def test_on_a_narrow_screen_the_result_of_a_transaction_is_seen() -> None:
    def names(width: int) -> list[str]:
        shown = {one.column.name: one.width for one in fitted(RECORD_COLUMNS, width)}
        if width >= 60:
            assert shown["text"] >= len("03 read holding 0..1 -> no answer")
        return [*shown]

    assert names(80) == ["mark", "number", "time", "ms", "unit", "text"]
    assert names(60) == ["mark", "number", "time", "unit", "text"]
    assert names(40) == ["mark", "time", "unit", "text"]


def test_chosen_columns_stay_in_their_order_however_narrow() -> None:
    assert [one.column.name for one in fitted(COLUMNS, 20, ["rare", "more", "unit"])] == [
        "unit",
        "more",
        "rare",
    ]


def test_columns_that_are_not_seen_are_told_with_the_reason() -> None:
    def told(width: int, chosen: list[str] | None = None, **widest: int) -> dict[str, str]:
        shown = fitted(SLAVE_COLUMNS, width, chosen, widest=widest)
        return left_out(SLAVE_COLUMNS, shown, width, widest)

    assert told(160) == {}
    assert told(160, device=0) == {"device": "empty"}
    assert told(50)["max"] == "no room at this width"
    assert "state" not in told(50)
    assert "state" in told(40, [one.name for one in SLAVE_COLUMNS])


def test_no_choice_that_exists_gives_the_first_column() -> None:
    assert [one.column.name for one in fitted(COLUMNS, 20, ["gone"])] == ["unit"]


@pytest.mark.parametrize(
    "columns", [POLL_COLUMNS, POINT_COLUMNS, RECORD_COLUMNS, SLAVE_COLUMNS, TROUBLE_COLUMNS]
)
@pytest.mark.parametrize("width", [60, 80, 81, 100, 120, 200])
def test_the_columns_of_each_view_fill_the_width(
    columns: tuple[WatchColumn, ...], width: int
) -> None:
    shown = fitted(columns, width)
    assert sum(one.width for one in shown) + len(shown) - 1 == width
    assert len({one.name for one in columns}) == len(columns)


def test_a_row_is_as_wide_as_its_columns_and_has_no_control_characters() -> None:
    shown = fitted(COLUMNS, 33)
    spans = row_spans({"unit": "123456", "text": [("a\x1b", "red")]}, shown, DrawContext())
    text = "".join(part for part, _ in spans)
    assert text == "123… a?" + " " * 26
    assert (spans[2], len(text)) == (("a?", "red"), 33)


def test_the_title_has_an_arrow_at_the_column_of_the_sorting() -> None:
    ((text, _),) = title_spans(fitted(COLUMNS, 33), "unit", descending=True)
    assert text.startswith("univ text")


def test_spans_are_cut_at_a_width() -> None:
    assert cut_spans([("abc", "red"), ("def", "")], 5) == [("abc", "red"), ("d", ""), ("…", "dim")]
    assert cut_spans([("abc", "red")], 5) == [("abc", "red"), ("  ", "")]
    for width, text in ((13, "would be …"), (9, "would be…"), (8, "would …")):
        spans = cut_spans([("would be wrong", "")], width)
        assert "".join(part for part, _ in spans) == text.ljust(width)


def test_all_cells_are_searched() -> None:
    row = {"unit": "1", "text": [("a", ""), ("b", "")], "ms": "2", "more": "3", "rare": "4"}
    assert row_text(row, COLUMNS, DrawContext()) == "1 ab 2 3 4"


def test_a_name_has_the_room_that_values_do_not_need() -> None:
    def widths(width: int, **widest: int) -> dict[str, int]:
        shown = fitted(POINT_COLUMNS, width, widest={"reference": 9, **widest})
        assert sum(one.width for one in shown) + len(shown) - 1 == width
        return {one.column.name: one.width for one in shown}

    shown = widths(80, name=34, value=12)
    assert (shown["name"], shown["value"]) == (34, 15)
    assert "changes" in shown
    assert "before" not in shown
    shown = widths(80, name=37, value=21)  # Both have not enough, without `changes`, too.
    assert (shown["name"], shown["value"]) == (34, 21)
    assert "changes" not in shown
    shown = widths(80, name=0, value=5)
    assert (shown["name"], shown["value"]) == (4, 23)
    assert {"before", "trend"} <= shown.keys()
    shown = widths(120, name=60, value=60)
    assert abs(shown["name"] - shown["value"]) <= 1


def test_a_column_without_any_text_is_left_out() -> None:
    def names(*chosen: str, **widest: int) -> list[str]:
        return [
            one.column.name for one in fitted(SLAVE_COLUMNS, 120, chosen or None, widest=widest)
        ]

    assert "device" in names()
    assert "device" in names(device=9)
    assert "device" not in names(device=0)
    assert names("device", "unit", device=0) == ["unit", "device"]
    assert "state" in names(state=0)


def test_without_rows_nothing_is_known_of_cells() -> None:
    assert widest_cells([], POINT_COLUMNS, DrawContext()) == {}


@pytest.mark.parametrize("columns", [POLL_COLUMNS, POINT_COLUMNS, SLAVE_COLUMNS, TROUBLE_COLUMNS])
def test_a_cell_wider_than_the_most_that_counts_changes_no_width(
    columns: tuple[WatchColumn, ...],
) -> None:
    measured = [one for one in columns if one.is_measured]
    assert measured
    for width in range(40, 130, 10):
        layouts = [
            [(one.column.name, one.width) for one in fitted(columns, width, widest=widest)]
            for widest in ({one.name: one.most + more for one in measured} for more in (0, 50))
        ]
        assert layouts[0] == layouts[1]
