from __future__ import annotations

from tests.benchmarks.report import differences


def test_figures_that_differ_are_named() -> None:
    stats = {"links": [{"ok": 3, "polls": [{"asked": 1, "histogram": [1, 2]}]}], "schema": 1}
    page = {"links": [{"ok": 4, "polls": [{"asked": 1}]}], "schema": 1, "more": 2}
    assert differences(page, stats) == [".links[0].ok"]
    assert differences({"links": []}, {"links": [1]}) == [".links"]
    assert differences(stats, stats) == []
