from __future__ import annotations

from mbtool.values.value_series import ValueSeries
from mbtool.values.values import SeriesKey
from mbtool.views.plot_documents import values_lines


def _series(name: str, *values: int, reference: str = "") -> ValueSeries:
    series = ValueSeries(name, reference)
    for at_ns, value in enumerate(values):
        series.add(at_ns, value)
    return series


SERIES = {
    SeriesKey("10.0.0.11", 1, "holding 100"): _series("holding 100", 7, 40, 3, 9),
    SeriesKey("10.0.0.12", 1, "input 0"): _series("input 0", 230, 231),
}


def test_the_list_has_least_greatest_and_last_value_and_no_empty_column() -> None:
    first, row, *_ = (line.text.split() for line in values_lines(SERIES, None, unicode=False))
    assert first == ["value", "link", "unit", "changes", "least", "greatest", "last"]
    assert row == ["holding", "100", "10.0.0.11", "1", "3", "3", "40", "9"]
    with_address = {SeriesKey("bus", 1, "CH1"): _series("CH1", 1, 2, reference="HR400001")}
    assert "address" in values_lines(with_address, None, unicode=False)[0].text


def test_a_narrow_list_has_fewer_columns_and_no_broken_word() -> None:
    wide = values_lines(SERIES, 100, unicode=True)
    narrow = values_lines(SERIES, 60, unicode=True)
    assert wide[0].text.endswith("recent values")
    assert narrow[0].text.endswith("last")
    assert all(len(line.text) <= 60 for line in narrow)
    assert narrow[1].text.startswith("holding 100")
