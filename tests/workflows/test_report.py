"""What the page of a report says, held against the other commands and against made captures."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.cli.main import run
from mbtool.core import InputError
from mbtool.views.report import contents
from mbtool.workflows.report import ReportRun
from mbtool.workflows.shared.reading import ReadingOptions
from tests.golden.test_captures import CAPTURES, FOLDER
from tests.views.report.pages import Page, demand_self_contained
from tests.workflows.evidence import capture_file
from tests.workflows.sick_line import asked_twice, sick_line

if TYPE_CHECKING:
    from pathlib import Path

PCAP_HEADER = 24
"""The length of the header of a pcap file, in bytes."""


def report_of(*paths: Path, against: Path | None = None, everything: bool = False) -> Page:
    made = ReportRun([str(path) for path in paths], ReadingOptions(), everything=everything)
    made.read()
    return Page(made.page(None if against is None else str(against)))


@pytest.fixture(scope="module")
def sick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sick_line(tmp_path_factory.mktemp("sick") / "sick.mcap")


@pytest.fixture(scope="module")
def sick_page(sick: Path) -> Page:
    return report_of(sick)


def test_the_verdict_names_the_dead_the_damaged_and_the_slow_unit(sick_page: Page) -> None:
    told = sick_page.document["verdict"]
    assert told["level"] == "bad"
    assert told["sentence"].startswith("Unit 3 never answers (60 requests): check its power, ")
    assert [(one["code"], one["search"]) for one in told["troubles"]] == [
        ("UNIT-SILENT", "rs485 unit:3 no-answer"), ("LINE-NOISE", "rs485 unit:4"),
        ("UNIT-SLOW", "rs485 unit:2"),
    ]  # fmt: skip


def test_the_chart_of_all_units_counts_also_those_without_a_chart_of_their_own(
    sick: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contents, "MAX_UNITS", 1)
    document = report_of(sick).document
    bins, (link,) = document["bins"], document["stats"]["links"]
    assert [one["unit"] for one in bins["units"]] == [3], "asked as often as others, fails most"
    assert (bins["counted"], bins["units_left_out"]) == (4, 3)
    assert sum(bins["all"]["no_answer"]) == link["no_answer"] > sum(bins["units"][0]["no_answer"])


def test_a_healthy_capture_is_well(tmp_path: Path) -> None:
    path = tmp_path / "well.pcap"
    path.write_bytes(capture_file(20))
    told = report_of(path).document["verdict"]
    assert (told["level"], told["troubles"]) == ("well", [])
    assert told["sentence"].startswith("Everything is well: the unit answers 20 requests")
    path.write_bytes(capture_file(5))
    told = report_of(path).document["verdict"]
    assert (told["level"], told["troubles"]) == ("doubt", [])
    assert told["sentence"].startswith("Too short to judge")


@pytest.mark.parametrize("path", CAPTURES, ids=lambda path: path.name)
def test_the_figures_are_those_of_stats(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = report_of(path).document["stats"]
    run(["stats", str(path), "--json"])
    expected = json.loads(capsys.readouterr().out)
    for key in ("is_whole", "remarks", "level", "troubles"):
        del expected[key]
    for link in expected["links"]:
        for poll in link["polls"]:
            (poll["latency"] or {}).pop("histogram", None)
    assert in_any_order(told) == in_any_order(expected)


def in_any_order(document: dict[str, Any]) -> dict[str, Any]:
    """Sort links and functions: the page has the sick ones first."""
    for link in document["links"]:
        link["functions"].sort(key=lambda one: (one["unit"] or -1, one["function"]))
    return document | {"links": sorted(document["links"], key=lambda link: str(link["link"]))}


def test_links_and_units_have_one_order_in_all_sections() -> None:
    told = report_of(CAPTURES[0].parent / "plant.pcap").document
    order = [("10.0.0.12", 2), ("10.0.0.12", 1), ("10.0.0.11", 1)]
    assert [(one["link"], one["unit"]) for one in told["bins"]["units"]] == order
    of_tables = [
        (link["link"], one["unit"]) for link in told["stats"]["links"] for one in link["functions"]
    ]
    assert list(dict.fromkeys(of_tables)) == order
    bars = [(one["link"], one["unit"]) for one in told["bars"] if one["unit"] is not None]
    assert list(dict.fromkeys(bars)) == order
    assert [(one["where"], one["unit"]) for one in told["inventory"]["slaves"]] == order
    assert [one["link"] for one in told["bins"]["links"]] == ["10.0.0.12", "10.0.0.11"]


def test_the_charts_count_what_the_tables_count(sick_page: Page) -> None:
    told = sick_page.document
    for unit in told["bins"]["units"]:
        of_unit = [
            one for one in told["stats"]["links"][0]["functions"] if one["unit"] == unit["unit"]
        ]
        for key, figure in (
            ("requests", "transactions"),
            ("no_answer", "no_answer"),
            ("exceptions", "exception"),
            ("retries", "repetitions"),
        ):
            assert sum(unit[key]) == sum(one[figure] for one in of_unit), key
            assert len(unit[key]) == told["bins"]["count"]


def test_the_findings_are_those_of_check(
    sick: Path, sick_page: Page, capsys: pytest.CaptureFixture[str]
) -> None:
    run(["check", str(sick), "--format", "json"])
    expected = json.loads(capsys.readouterr().out)["findings"]
    told = sick_page.document["findings"]
    assert told["broken"] == sum(one["count"] for one in expected)
    assert {one["code"] for one in told["rows"]} == {one["code"] for one in expected}


def test_findings_stand_at_the_transactions_that_they_are_about(sick_page: Page) -> None:
    told = sick_page.document["transactions"]
    units: dict[str, set[int]] = {}
    for row in told["rows"]:
        units.setdefault(told["texts"][row[-1]], set()).add(row[3])
    expected = {"": {1, 2, 4}, "MB-401": {3}, "RTU-201 MB-401": {4}}
    assert units == expected
    assert told["with_trouble"] == told["kept_with_trouble"] == 70


def test_a_request_whose_answer_was_damaged_says_so_and_has_the_code(sick_page: Page) -> None:
    told = sick_page.document["transactions"]
    texts = told["texts"]
    damaged = [row for row in told["rows"] if texts[row[5]] == "wrong CRC"]
    (found,) = [one for one in sick_page.document["findings"]["rows"] if one["code"] == "RTU-201"]
    assert len(damaged) == found["count"] > 1
    assert {row[3] for row in damaged} == {4}
    assert all("RTU-201" in texts[row[8]].split() for row in damaged)
    assert {texts[row[6]] for row in damaged} == {"no-answer"}


def test_rows_are_marked_as_retries_where_the_statistics_count_them(tmp_path: Path) -> None:
    document = report_of(asked_twice(tmp_path / "twice.mcap")).document
    told = document["transactions"]
    marked = [row for row in told["rows"] if row[9:] == [1]]
    assert {row[3] for row in marked} == {3}
    (link,) = document["stats"]["links"]
    assert len(marked) == link["repetitions"] == 30
    assert not any("asked" in text for text in told["texts"])


def test_values_changed_and_unchanged_are_told_apart(sick_page: Page) -> None:
    told = sick_page.document["values"]
    assert [(one["unit"], one["name"], one["changes"]) for one in told["series"]] == [
        (1, "holding 1", 59), (2, "holding 1", 59), (4, "holding 1", 49),
    ]  # fmt: skip
    times, values = zip(*told["series"][0]["samples"], strict=True)
    assert values == tuple(range(60))
    assert {after - before for before, after in pairwise(times)} == {1000}
    assert [row[1:3] + row[4:] for row in told["constant"]] == [
        [unit, "holding 0", "258"] for unit in (1, 2, 4)
    ]


def test_notes_are_counted_apart_from_broken_rules() -> None:
    told = report_of(FOLDER / "findings/MB-404.pcap", FOLDER / "findings/MB-103.pcap").document[
        "findings"
    ]
    assert (told["broken"], told["notes"]) == (1, 1)
    assert {one["code"] for one in told["rows"]} == {"MB-404", "MB-103"}


def test_the_page_says_how_the_capture_was_made(sick_page: Page) -> None:
    (file,) = sick_page.document["capture"]["files"]
    assert ["command", "mbtool sniff"] in file["capture"]
    assert file["links"] == [["rs485", [["spec", "rtu:/dev/rs485@19200-8E1"]]]]


def test_the_comparison_is_that_of_diff(sick: Path, tmp_path: Path) -> None:
    other = sick_line(tmp_path / "other.mcap", cycles=20)
    told = report_of(sick, against=other).document["against"]
    assert (told["transactions"], told["other_transactions"]) == (240, 80)
    assert told["count"] == len(told["rows"]) > 0
    assert {row[1] for row in told["rows"]} <= {"outcome", "value", "latency"}


def test_a_cut_file_is_told_as_far_as_it_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcap"
    path.write_bytes(capture_file(5)[:-5])
    made = ReportRun([str(path)], ReadingOptions())
    made.read()
    told = Page(made.page()).document
    assert isinstance(made.error, InputError)
    assert str(made.error) in told["capture"]["remarks"]
    assert told["stats"]["transactions"] == 5


def test_a_capture_without_transactions_says_why(tmp_path: Path) -> None:
    path = tmp_path / "empty.pcap"
    path.write_bytes(capture_file(1)[:PCAP_HEADER])
    remarks = report_of(path).document["capture"]["remarks"]
    assert remarks == [f"{path}: empty; there is neither a packet nor a transaction in it"]


def test_texts_of_the_wire_and_of_the_user_become_no_markup(tmp_path: Path) -> None:
    path = sick_line(tmp_path / "<img src=x onerror=hacked()>.mcap", 6, name="</script><b>")
    page = report_of(path)
    demand_self_contained(page)
    assert "b" not in [tag for tag, _ in page.tags]
    told: dict[str, Any] = page.document
    assert told["stats"]["links"][0]["link"] == "</script><b>"
    assert told["stats"]["sources"] == [str(path)]


def test_the_bars_of_latency_have_all_answers(sick_page: Page) -> None:
    told = sick_page.document
    (link,) = told["stats"]["links"]
    latencies = {(None, None): link["latency"]}
    latencies |= {(one["unit"], one["function"]): one["latency"] for one in link["functions"]}
    assert [(one["unit"], one["function"]) for one in told["bars"]] == [*latencies]
    for one in told["bars"]:
        latency = latencies[one["unit"], one["function"]]
        number = sum(step[2] for step in one["steps"]) + one["beyond"]
        assert number == (0 if latency is None else latency["count"])


def test_only_troubles_that_no_rule_tells_are_marked_so(sick_page: Page) -> None:
    troubles = sick_page.document["verdict"]["troubles"]
    assert [(one["who"], one["is_rule"]) for one in troubles] == [
        ("unit 3", False), ("unit 4", False), ("unit 2", False),
    ]  # fmt: skip
