"""What `stats`, `report` and `watch` say of the same capture: the same units are in trouble."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from mbtool.core import EventKind, SerialFormat, WireEvent
from mbtool.ledger.history import UnitRow
from mbtool.ledger.statistics_report import report
from mbtool.modbus import Outcome, Transport
from mbtool.troubles.broken_rules import Summaries
from mbtool.views import statistics_verdict, trouble_words
from mbtool.views.report import verdict
from mbtool.views.report.troubles import Rank
from mbtool.views.watch_troubles import trouble_line
from mbtool.watching.board import Board
from mbtool.watching.board_judgement import judge
from mbtool.watching.watched_rows import kept_record
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.captures import public_folder
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import request, unanswered

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.watching.watched_rows import Record


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
_WORDS = {
    "missing": ("never answer", "missing", "without an answer", "right CRC", "wrong CRC"),
    "refused": ("refuse", "exception"),
    "malformed": ("malformed",),
    "slow": ("slow:",),
    "slower": (" slower since ",),
    "late": (" late, ",),
}
_UNIT = re.compile(r"unit (\d+)(?: at ([^\s,;]+))?")


class Told(NamedTuple):
    """The units that each command names, by kind of trouble."""

    stats: set[tuple[str, UnitRow]]
    grave_of_report: set[tuple[str, UnitRow]]
    all_of_report: set[tuple[str, UnitRow]]
    watch: set[tuple[str, UnitRow]]
    lines: list[str]
    styles: list[str]
    sentence: str
    watch_line: str


def told_of(records: Iterable[Record], monkeypatch: pytest.MonkeyPatch) -> Told:
    for limit in ("_MOST_UNITS", "_MOST_ODDITIES", "JOINED"):
        monkeypatch.setattr(statistics_verdict, limit, 100_000)
    for module in (verdict, trouble_words):
        monkeypatch.setattr(module, "JOINED", 100_000)
    board = board_of(records)
    links = report(board.statistics)
    styled = statistics_verdict.verdict(links)[1:]
    lines = [line.text for line in styled]
    told = verdict.report_verdict(links, Summaries())
    judgement = judge(board)
    grave, every = set[tuple[str, UnitRow]](), set[tuple[str, UnitRow]]()
    for trouble in told.troubles:
        some = {(kind, unit) for kind in kinds_of(trouble.text) for unit in trouble.units}
        every |= some
        if trouble.rank in (Rank.DEAD, Rank.FAILING, Rank.SLOW):
            grave |= some
    watch = set()
    for row in judgement.slaves:
        unit = UnitRow(row.link, row.unit)
        is_missing = row.missing_share is not None and row.missing_share.is_grave
        watch |= {("missing", unit)} if row.never_answers or is_missing else set()
        is_refusing = row.refused_share is not None and row.refused_share.is_grave
        watch |= {("refused", unit)} if is_refusing else set()
        watch |= {("slow", unit)} if row.usual_ns is not None else set()
        watch |= {("slower", unit)} if row.slower is not None else set()
    return Told(
        named_in(lines, links[0].name if len(links) == 1 else ""),
        grave,
        every,
        watch,
        lines,
        [line.style for line in styled],
        told.sentence,
        trouble_line(judgement, 10_000).text,
    )


def board_of(records: Iterable[Record]) -> Board:
    board = Board(lambda _: SerialFormat())
    for order, record in enumerate(records, 1):
        board.add(kept_record(order, order, record))
    board.advance(None)
    return board


def kinds_of(text: str) -> set[str]:
    return {kind for kind, words in _WORDS.items() if any(word in text for word in words)}


def named_in(lines: Iterable[str], only_link: str) -> set[tuple[str, UnitRow]]:
    return {
        (kind, UnitRow(only_link or at, int(unit)))
        for line in lines
        for kind in kinds_of(line.split("; ")[0])
        for unit, at in _UNIT.findall(line)
    }


def compare(told: Told) -> None:
    judged = ("missing", "refused", "slow", "slower")
    # Slow units are a small thing if they are many: the report tells them, but not as grave.
    grave = told.grave_of_report | {one for one in told.all_of_report if one[0] == "slow"}
    assert told.watch == {one for one in grave if one[0] in judged}
    assert told.stats == told.all_of_report


@pytest.mark.parametrize("path", OWN_CAPTURES, ids=lambda path: path.name)
def test_the_same_units_are_in_trouble(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(told_of(Reading([str(path)], ReadingOptions()).records(), monkeypatch))


@pytest.mark.public_captures
@pytest.mark.parametrize("name", PUBLIC_CAPTURES)
def test_the_same_units_are_in_trouble_in_captures_of_others(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = public_folder() / name
    if not path.exists():
        pytest.skip("no captures of others")
    compare(told_of(Reading([str(path)], ReadingOptions()).records(), monkeypatch))


def test_the_same_units_of_a_line_with_all_troubles(monkeypatch: pytest.MonkeyPatch) -> None:
    told = told_of(SICK_LINE, monkeypatch)
    compare(told)
    assert {(kind, unit.unit) for kind, unit in told.stats} == {
        ("missing", 3), ("missing", 4), ("refused", 5), ("slow", 6), ("malformed", 7),
    }  # fmt: skip
    assert told.watch_line == (
        "unit 3 never answers; unit 5: 50 % refused; unit 4: 25 % wrong CRC; "
        "unit 7: 17 % malformed; unit 6 slow, 90.0 ms (others 5.0)"
    )
    assert told.sentence.startswith("Unit 3 never answers (60 requests); unit 5 refuses 50 % of ")


def test_a_unit_that_is_slow_most_of_the_time_is_told_with_its_beginning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    well = [request(1000 * at, unit=2, latency_ns=6 * MS) for at in range(100)]
    slow = [request(1000 * at, latency_ns=(6 if at < 40 else 80) * MS) for at in range(100)]
    told = told_of([*well, *slow], monkeypatch)
    compare(told)
    assert "unit 1 answers slower since 00:00:" in told.lines[0]


def test_a_unit_that_became_slower_is_told_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    well = [request(1000 * at + 500, unit=2, latency_ns=9 * MS) for at in range(100)]
    slower = [request(1000 * at, latency_ns=(6 if at < 60 else 26) * MS) for at in range(100)]
    told = told_of([*well, *slower], monkeypatch)
    compare(told)
    since = "slower since 00:00:59"  # Exact to a bin: the first slow answer comes at 00:01:00.
    text = f"unit 1 answers {since}: in 25.5 ms on average, before in 6.0 ms"
    assert (told.lines, told.styles) == ([f"! {text}"], ["yellow"])
    assert told.sentence == f"U{text[1:]}; everything else is well."
    assert told.watch_line == f"unit 1 {since}, 25.5 ms (before 6.0)"
    judgement = judge(board_of([*well, *slower]))
    assert trouble_line(judgement, 40).text == told.watch_line
    compare(told_of([*well, *slower[:60]], monkeypatch))


def test_a_scan_is_told_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = [
        request(20 * at + unit, at, unit=unit, outcome=Outcome.EXCEPTION, exception=2)
        for at in range(10)
        for unit in range(1, 7)
    ]
    told = told_of(scan, monkeypatch)
    text = "all 6 units refuse all their requests (60): 60 different ones, as in a scan"
    assert told.lines == ["! 60 exceptions: 60 x 02 illegal data address", f"! {text}"]
    assert told.watch_line == text
    assert told.sentence.endswith(": 60 different ones, as in a scan.")


def test_what_is_odd_in_the_polling_is_told_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    times = [250 * at + (7000 if at > 60 else 0) for at in range(100)]
    polls = [request(at, latency_ns=990 * MS if at == 10_000 else 2 * MS) for at in times]
    told = told_of(polls, monkeypatch)
    pause = "line paused a poll for 7.25 s (usually every 250 ms)"
    late = "unit 1 gives 1 answer late, after 990 ms (usually 2.0 ms)"
    assert told.lines[-2:] == [f"! {pause}", f"! {late}"]
    assert told.sentence == f"Nothing grave, but worth a look: {pause}; {late}."
    assert told.watch_line == f"{pause}; {late}"


def test_the_line_of_watch_shortens_what_is_odd() -> None:
    times = [250 * at + (7000 if at > 60 else 0) for at in range(100)]
    board = board_of([request(at, latency_ns=990 * MS if at == 10_000 else MS) for at in times])
    pause = "line paused a poll for 7.25 s"
    text, is_grave = trouble_line(judge(board), 78)
    assert text == f"{pause}; unit 1 gives 1 answer late, after 990 ms"
    assert not is_grave
    assert trouble_line(judge(board), 50).text == f"{pause}; 1 more: key 6"
    assert trouble_line(judge(board), 20).text == f"{pause}; 1 more: key 6"


def test_the_line_of_watch_leaves_out_the_link_of_a_pause_if_there_is_no_room() -> None:
    link, master = "192.168.43.149", "192.168.43.148"
    board = board_of(
        [
            request(
                250 * at + (7000 if at > 60 else 0), link=link, source=f"{master}:50000",
                latency_ns=990 * MS if at == 40 else MS, transport=Transport.TCP,
            )
            for at in range(100)
        ]
    )  # fmt: skip
    text = f"{master} paused a poll for 7.25 s; 1 more: key 6"
    assert trouble_line(judge(board), 78).text == text


def test_few_failures_are_a_small_thing_to_all(monkeypatch: pytest.MonkeyPatch) -> None:
    polls = [request(100 * at) if at % 500 else unanswered(100 * at) for at in range(1, 1100)]
    told = told_of(polls, monkeypatch)
    compare(told)
    assert told.stats == {("missing", UnitRow("line", 1))}
    assert not told.grave_of_report
    assert told.watch_line == ""
    assert told.styles[:1] == ["yellow"]


def test_the_line_of_watch_leaves_out_who_scans_if_there_is_no_room() -> None:
    scan = [
        request(
            at, at, link=f"10.0.0.{2 + at % 6}", source="10.0.0.1:50000", outcome=Outcome.EXCEPTION,
            exception=2, transport=Transport.TCP,
        )
        for at in range(60)
    ]  # fmt: skip
    judgement = judge(board_of(scan))
    text = "all 6 units refuse all their requests (60): 60 different ones, as in a scan"
    assert trouble_line(judgement, 120).text == f"{text} by 10.0.0.1"
    assert trouble_line(judgement, 78).text == text


def test_polls_that_are_always_refused_are_not_told_since_when(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    well = [request(1000 * at, unit=1) for at in range(60)]
    refused = [request(30_000 + 1000 * at, 90, **REFUSED) for at in range(30)]
    told = told_of([*well, *refused], monkeypatch)
    assert told.lines == ["! 30 exceptions: 30 of unit 1; 30 x 02 illegal data address"]
    assert told.sentence.startswith("Unit 1 always refuses 03 ")
    assert told.watch_line == "unit 1 always refuses 1 of 2 polls"


def test_a_unit_that_is_silent_in_the_end_is_told_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    records = [request(1000 * at) for at in range(1000)]
    records += [unanswered(1_000_000 + 1000 * at) for at in range(5)]
    told = told_of(records, monkeypatch)
    compare(told)
    since = "since 00:16:40"
    assert told.lines[0].startswith(f"! 5 answers missing: 5 of unit 1 {since}; ")
    assert told.styles == ["red"]
    assert told.sentence.startswith(f"Unit 1 leaves all its requests without an answer {since}")
    assert told.watch_line == f"unit 1 no answer {since}"


def test_damaged_frames_of_no_unit_are_told_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    records: list[Record] = []
    for at in range(100):
        records += [request(1000 * at), *([bad_check(1000 * at + 300)] if at % 10 == 0 else [])]
    told = told_of(records, monkeypatch)
    text = "line has 10 frames with a wrong CRC that no unit can be blamed for"
    assert (told.lines, told.styles) == ([f"! {text}"], ["red"])
    assert told.sentence.startswith(f"L{text[1:]}")
    assert told.watch_line == text
    told = told_of(records[:40], monkeypatch)
    assert told.watch_line.startswith("line has 4 frames")
    few = told_of([*records[11:22], *records[120:], *records[130:]], monkeypatch)
    assert few.styles == ["yellow"]
    assert few.watch_line == ""


def test_what_a_filter_left_out_is_not_taken_for_a_trouble() -> None:
    records: list[Record] = [
        *map(bad_check, range(0, 5000, 100)),
        *(request(1000 * at) for at in range(5)),
    ]
    records += [request(10_000 + 100 * at) for at in range(100)]
    for left_out, told in ((0, 2), (1, 0)):
        board = board_of(records)
        board.statistics.left_out = left_out
        assert len(statistics_verdict.verdict(report(board.statistics))[1:]) == told
