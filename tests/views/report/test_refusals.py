"""What a report says of refused requests if not all polls could be kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest

from mbtool.ledger import statistics
from mbtool.ledger.history import UnitRow
from mbtool.ledger.request_tally import RequestTally
from mbtool.modbus import Outcome
from mbtool.views.report.refusals import joined_refusals
from mbtool.views.report.troubles import Rank, VerdictTrouble
from tests.ledger.test_history import asked
from tests.views.report.test_verdict import judged

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction


def read(
    at: float, unit: int, address: int, outcome: Outcome = Outcome.EXCEPTION
) -> NamedTransaction:
    code = 2 if outcome is Outcome.EXCEPTION else None
    return msgspec.structs.replace(
        asked(at, unit, outcome=outcome), address=address, quantity=2,
        reference=f"holding {address}", exception=code,
        exception_name=None if code is None else "illegal data address",
    )  # fmt: skip


@pytest.fixture
def _few_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "MAX_POLLS", 100)


@pytest.mark.usefixtures("_few_polls")
def test_refusals_of_polls_that_are_no_longer_known_are_counted() -> None:
    refused = [read(unit + at / 20, unit, at) for unit in range(1, 5) for at in range(10)]
    others = [
        read(9 * unit + at / 20, unit, at, Outcome.OK) for unit in range(5, 9) for at in range(60)
    ]
    assert judged([*refused, *others]).sentence == (
        "4 of 8 units refuse all their requests (40), with 02 illegal data address; "
        "everything else is well."
    )


@pytest.mark.usefixtures("_few_polls")
def test_a_scan_of_more_polls_than_are_kept_counts_all_its_requests() -> None:
    scan = [read(9 * unit + at / 20, unit, at) for unit in range(1, 7) for at in range(60)]
    assert judged(scan).sentence == (
        "All 6 units refuse all their requests (360), with 02 illegal data address."
    )


@pytest.mark.usefixtures("_few_polls")
def test_the_polls_that_a_unit_refuses_are_named_only_if_all_are_known() -> None:
    refused = [read(at / 20, 1, at) for at in range(95)]
    good = [read(9 + at / 20, 1, 900 + at, Outcome.OK) for at in range(5)]
    assert "always" not in judged(good + refused).sentence
    assert "refuses 95 of its 100 different requests" in judged(good + refused).sentence
    more = [read(20 + at / 20, 1, 500 + at, Outcome.OK) for at in range(5)]
    assert judged([*refused, *good, *more]).sentence == (
        "Unit 1 refuses all its requests until 22:13:24, with 02 illegal data address."
    )


def test_refusals_without_codes_are_told() -> None:
    records = [asked(at, unit, Outcome.EXCEPTION) for unit in range(5) for at in range(4)]
    assert judged(records).sentence == (
        "All 5 units refuse all their requests (20), with unknown codes."
    )


def test_joining_refusals_compares_no_trouble_with_each_other_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compared = 0

    def count(one: VerdictTrouble, other: object) -> bool:
        nonlocal compared
        compared += 1
        return one is other

    rows = [UnitRow(f"10.0.{unit}.1", 1) for unit in range(200)]
    troubles = [
        VerdictTrouble(rank=Rank.FAILING, text="", units=frozenset((row,)), is_refusal=True)
        for row in rows
    ]
    minor = [VerdictTrouble(rank=Rank.MINOR, text="") for _ in rows]
    monkeypatch.setattr(VerdictTrouble, "__eq__", count)
    tally = RequestTally()
    tally.add(read(0, 1, 0))
    tallies = dict.fromkeys(rows, tally)
    assert len(joined_refusals([*troubles, *minor], tallies, {})) == 201
    assert compared <= len(rows)
