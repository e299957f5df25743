"""What check, stats, inventory, report and watch say of the same capture: the same troubles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import mbtool
from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.ledger.account import Account
from mbtool.modbus import Outcome
from mbtool.troubles.judge import Judge, Judgement
from mbtool.views.statistics_table import statistics_lines
from mbtool.views.trouble_lines import (
    MOST,
    trouble_documents,
    trouble_lines,
    trouble_text,
    watch_text,
)
from mbtool.watching.watched import Watched
from mbtool.workflows.check import CheckRun
from mbtool.workflows.inventory import InventoryOptions, InventoryRun
from mbtool.workflows.report import ReportRun
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.captures import public_folder
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import request, unanswered
from tests.views.report.pages import Page

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.watching.watched_rows import Record

OPTIONS = ReadingOptions()
OWN = Path(__file__).resolve().parents[2] / "captures"
OWN_CAPTURES = sorted(path for kind in ("*.mcap", "*.pcap", "*.pcapng") for path in OWN.rglob(kind))
PUBLIC_CAPTURES = [
    "ITI__ICS-Security-Tools/mb2.pcap",
    "ITI__ICS-Security-Tools/Modbus__modbus_test.pcap",
    "digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap",
    "nopnoplabs__nopnoplabs.github.io/hist_50fa3d41__pcap__modbus.pcap",
    "antoine-lemay__Modbus_dataset/CnC_uploading_exe_modbus_6RTU_with_operate.pcap",
    "kb221svs__modbus-anomaly-detection/modbus.pcap",
    "camp0__aiengine/pcapfiles__modbus_five_flows.pcap",
    "zeek__zeek/modbusSmall.pcap",
]


def bad_check(at_ms: float) -> WireEvent:
    return WireEvent(
        ts_ns=START_NS + round(at_ms * MS), link="line", kind=EventKind.BAD_CHECK, message="",
        raw=bytes(9),
    )  # fmt: skip


REFUSED: dict[str, Any] = {"outcome": Outcome.EXCEPTION, "exception": 2}
SICK_LINE: list[Record] = [
    record
    for at in range(60)
    for record in (
        request(1000 * at, unit=1),
        request(1000 * at + 100, unit=2),
        unanswered(1000 * at + 200, unit=3),
        *(
            [bad_check(1000 * at + 310), unanswered(1000 * at + 300, unit=4)]
            if at % 4 == 0
            else [request(1000 * at + 300, unit=4)]
        ),
        request(1000 * at + 400, unit=5, **(REFUSED if at % 2 else {})),
        request(1000 * at + 500, unit=6, latency_ns=90 * MS),
        request(1000 * at + 700, unit=7, outcome=Outcome.OK if at % 6 else Outcome.MALFORMED),
    )
]


def compare(path: Path) -> None:
    """Let each command read a capture, and compare what they say is wrong."""
    check = CheckRun([str(path)], OPTIONS)
    for _ in check.findings():
        pass
    told = check.judgement()
    assert all(one.evidence for trouble in told.troubles for one in trouble.all)
    lines = [line.text for line in statistics_lines(told, width=None)]
    for line in trouble_lines(told):
        assert line.text in lines or not told.links
    assert mbtool.open(path, incomplete=True).troubles() == told.troubles
    inventory = InventoryRun([str(path)], InventoryOptions(reading=OPTIONS))
    inventory.take()
    assert trouble_documents(inventory.judgement()) == trouble_documents(told)
    report = ReportRun([str(path)], OPTIONS)
    report.read()
    verdict = Page(report.page()).document["verdict"]
    assert verdict["level"] == told.level
    assert [one["text"] for one in verdict["troubles"]] == [
        line.text.removeprefix("! ") for line in trouble_lines(told, 1000) if told.troubles
    ]
    if not told.troubles:
        assert verdict["sentence"] == told.summary


def compare_watch(path: Path) -> None:
    """Watch has no end of a capture, so it lacks what the rules find there."""
    reading = Reading([str(path)], OPTIONS)
    check, watched = CheckRun([str(path)], OPTIONS), Watched(reading.format_of)
    for _ in check.findings():
        pass
    for record in reading.records():
        watched.add(record)
    watched.advance(None)
    counted = [one for one in check.judgement().troubles if one.code.startswith("UNIT")]
    told = [one for one in watched.judge().troubles if one.code.startswith("UNIT")]
    assert [one.sentence for one in told] == [one.sentence for one in counted]


@pytest.mark.parametrize("path", OWN_CAPTURES, ids=lambda path: path.name)
def test_the_commands_tell_the_same_troubles(path: Path) -> None:
    compare(path)
    compare_watch(path)


@pytest.mark.public_captures
@pytest.mark.parametrize("name", PUBLIC_CAPTURES)
def test_the_commands_tell_the_same_troubles_of_captures_of_others(name: str) -> None:
    path = public_folder() / name
    if not path.exists():
        pytest.skip("no captures of others")
    compare(path)


def judged(records: Iterable[Record]) -> Judgement:
    judge = Judge(Account(lambda _: SerialFormat()))
    for record in records:
        judge.count(record)
    judge.ledger.settle()
    return judge.judgement()


def test_a_line_with_all_troubles_tells_each_once() -> None:
    told = judged(SICK_LINE)
    assert [(one.code, one.unit) for one in told.troubles] == [
        ("UNIT-SILENT", 3), ("UNIT-MALFORMED", 7), ("LINE-LOST-BYTES", 4), ("UNIT-REFUSES", 5),
        ("UNIT-SLOW", 6),
    ]  # fmt: skip
    assert told.level == "bad"
    document = trouble_documents(told)
    assert [one["of"] for one in json.loads(json.dumps(document))["troubles"]] == [
        60, 60, 420, 60, 60,
    ]  # fmt: skip


def test_what_is_odd_in_the_polling_is_told() -> None:
    times = [250 * at + (7000 if at > 60 else 0) for at in range(100)]
    polls = [request(at, latency_ns=990 * MS if at == 10_000 else 2 * MS) for at in times]
    pause = "line paused a poll for 7.25 s (usually every 250 ms)"
    late = "unit 1 gives 1 answer late, after 990 ms (usually 2.0 ms)"
    assert [one.cause for one in judged(polls).troubles] == [late, pause]


def test_a_poll_that_always_takes_long_is_not_late() -> None:
    quick = [request(200 * at, latency_ns=3 * MS) for at in range(100)]
    long = [request(200 * at + 100, 500, latency_ns=197 * MS) for at in range(0, 100, 5)]
    assert not judged([*quick, *long]).troubles


def test_the_line_of_watch_tells_what_to_do_and_names_the_others_if_there_is_room() -> None:
    told = judged(SICK_LINE)
    worst = told.troubles[0]
    lines, style = watch_text(told, 78)
    assert len(lines) <= 3
    assert max(map(len, lines)) <= 78
    assert " ".join(lines) == (f"{trouble_text(worst)}; also: unit 7 17 % malformed; 3 more: key 6")
    assert style == "bold red"
    lines, _ = watch_text(told, 60)
    assert " ".join(lines).startswith(f"unit 3 never answers: {worst.remedy}; ")
    lines, _ = watch_text(told, 40)
    assert " ".join(lines).startswith(f"{worst.cause}; also: unit 7 ")
    lines, _ = watch_text(told, 200)
    assert " ".join(lines).startswith(f"{trouble_text(worst)}; also: unit 7 17 % malformed, ")
    assert "key 6" not in " ".join(lines)
    assert watch_text(judged([]), 80) == ([], "")


def test_a_text_names_the_worst_and_counts_the_others() -> None:
    told = judged(SICK_LINE)
    assert len(trouble_lines(told, MOST)) == 5
    lines = trouble_lines(told, 2)
    assert [line.style for line in lines] == ["red", "red", "yellow"]
    assert lines[-1].text == "! and 3 more troubles: mbtool report shows all"


def test_what_a_filter_left_out_is_not_taken_for_a_trouble() -> None:
    records: list[Record] = [
        *map(bad_check, range(0, 5000, 100)),
        *(request(1000 * at) for at in range(5)),
    ]
    records += [request(10_000 + 100 * at) for at in range(100)]
    for is_wanted, told in ((True, ["LINE-NOISE", "POLL-PAUSED"]), (False, [])):
        judge = Judge(Account(lambda _: SerialFormat()))
        for at, record in enumerate(records):
            judge.count(record, is_wanted=is_wanted or at != len(records) - 1)
        judge.ledger.settle()
        assert [one.code for one in judge.judgement().troubles] == told
