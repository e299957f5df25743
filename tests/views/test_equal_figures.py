"""Check, stats, report, inventory and watch give the same figures of captures made by others."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.ledger.statistics_report import report, unit_tallies
from mbtool.modbus import Outcome
from mbtool.watching.board import slave_rows
from mbtool.watching.watched import Watched
from mbtool.workflows.check import CheckRun
from mbtool.workflows.report import ReportRun
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.captures import public_folder
from tests.views.report.pages import Page

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.ledger.request_tally import RequestTally

OPTIONS = ReadingOptions()
LARGEST = 500_000
CAPTURES = sorted(
    path
    for path in public_folder().rglob("*")
    if path.suffix in (".pcap", ".pcapng", ".mcap", ".gz")
    and path.stat().st_size <= LARGEST
    and "cutfile" not in path.name
)
NAMES = {
    "late": Outcome.LATE,
    "no_answer": Outcome.NO_ANSWER,
    "exception": Outcome.EXCEPTION,
    "malformed": Outcome.MALFORMED,
    "unsolicited": Outcome.UNSOLICITED,
    "not_captured": Outcome.NOT_CAPTURED,
    "broadcast": Outcome.BROADCAST,
    "ok": Outcome.OK,
}

Tallies = dict[tuple[str, int], "RequestTally"]


def account(path: Path) -> tuple[Tallies, dict[str, int]]:
    """The tally of each unit, and the failed requests as `check --json` has them."""
    run = CheckRun([str(path)], OPTIONS)
    for _ in run.findings():
        pass
    return unit_tallies(report(run.ledger)), run.failed_requests()


def page_of(path: Path) -> dict[str, Any]:
    run = ReportRun([str(path)], OPTIONS)
    run.read()
    return Page(run.page()).document


def total(tallies: Tallies, outcome: Outcome) -> int:
    return sum(one.count(outcome) for one in tallies.values())


@pytest.mark.public_captures
@pytest.mark.parametrize("path", CAPTURES, ids=lambda path: path.name)
def test_each_figure_is_the_same_in_all_commands(path: Path) -> None:
    tallies, failed = account(path)
    assert {name: total(tallies, NAMES[name]) for name in failed if name in NAMES} == {
        name: number for name, number in failed.items() if name in NAMES
    }
    document = page_of(path)
    links = document["stats"]["links"]
    for name, outcome in NAMES.items():
        assert sum(link[name] for link in links) == total(tallies, outcome), name
    requests = sum(one.requests for one in tallies.values())
    assert sum(link["requests"] for link in links) == requests
    slaves = document["inventory"]["slaves"]
    transactions = sum(one.transactions for one in tallies.values())
    assert sum(one["transactions"] for one in slaves) == transactions
    assert sum(one["no_answer"] for one in slaves) == total(tallies, Outcome.NO_ANSWER)
    compare_watch(path, tallies, links)


def compare_watch(path: Path, tallies: Tallies, links: list[dict[str, Any]]) -> None:
    reading = Reading([str(path)], OPTIONS)
    watched = Watched(reading.format_of)
    for record in reading.records():
        watched.add(record)
    watched.advance(None)
    repetitions: Counter[tuple[str, int]] = Counter()
    for link in links:
        for one in link["functions"]:
            repetitions[link["link"], one["unit"]] += one["repetitions"]
    rows = {(row.link, row.unit): row for row in slave_rows(watched.whole)}
    assert set(rows) == set(tallies)
    for key, tally in tallies.items():
        row = rows[key]
        assert (row.asked, row.missing, row.exceptions, row.malformed, row.retries) == (
            tally.requests,
            tally.not_in_time,
            tally.count(Outcome.EXCEPTION),
            tally.count(Outcome.MALFORMED),
            repetitions[key],
        ), key
