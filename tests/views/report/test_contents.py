"""What the document of the report page has, and what it does not compute."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.ledger.account import Account
from mbtool.ledger.distribution import Bucket, Distribution
from mbtool.ledger.statistics_report import report
from mbtool.views.report import contents
from tests.ledger.test_account_over_time import asked

if TYPE_CHECKING:
    import pytest


def test_no_more_histograms_are_computed_than_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    statistics = Account()
    for link in ("a", "b", "c"):
        for unit in range(3):
            statistics.add(msgspec.structs.replace(asked(0, unit), link=link))
    made: list[Distribution] = []

    def count(one: Distribution) -> tuple[list[Bucket], int]:
        made.append(one)
        return [], 0

    monkeypatch.setattr(Distribution, "bars", count)
    monkeypatch.setattr(contents, "MAX_BARS", 6)
    bars = contents._bars(report(statistics), {})
    assert [(one["link"], one["unit"]) for one in bars] == [
        ("a", None), ("a", 0), ("a", 1), ("a", 2), ("b", None), ("b", 0),
    ]  # fmt: skip
    assert len(made) == 6
