from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.core import CONNECTION_OPENED, EventKind, WireEvent
from mbtool.ledger import account as limits
from mbtool.ledger import master_tape
from mbtool.ledger.account import Account
from mbtool.ledger.statistics_report import report
from mbtool.modbus import Outcome, Transport
from mbtool.views.statistics_document import statistics_document
from mbtool.views.statistics_table import statistics_lines
from tests.ledger.masters import START_NS, Master, Task
from tests.ledger.requests import LINE, request, requests_of, unanswered
from tests.troubles.judging import judged

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.troubles.judge import Judgement


def counting(*records: NamedTransaction | WireEvent) -> Account:
    made = Account(lambda _: LINE)
    for one in records:
        made.add(one)
    made.settle()
    return made


def counted(*records: NamedTransaction | WireEvent) -> Judgement:
    return judged(counting(*records))


def lines_of(*records: NamedTransaction | WireEvent, top: int | None = None) -> list[str]:
    return [line.text for line in statistics_lines(counted(*records), width=80, top=top)]


def test_units_beyond_the_limit_are_named_as_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_POLLS", 2)
    monkeypatch.setattr(limits, "MAX_USES", 4)
    asked = [request(at, unit=at % 20, function=3 + at % 2) for at in range(400)]
    lines = lines_of(*asked)
    assert "at least 4 units: 400 requests" in lines[0]
    assert any(line.startswith("there are more than") for line in lines)
    text = statistics_document(counting(*asked), counted(*asked), sources=["x"], where=None)
    (link,) = json.loads(text)["links"]
    assert link["functions"][0]["unit"] is None


@pytest.fixture(scope="module")
def plant() -> Judgement:
    """Two lists with a dead unit and writes, of which every section has something to say."""
    master = Master(
        tasks=[Task(polls="abcdab", period_ms=1000), Task(polls="efgh", period_ms=7000)],
        writes={"W": 3000}, loss=0.02, retries=1, dead=frozenset("g"),
    )  # fmt: skip
    return counted(*requests_of(master.run(120)))


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("height", [24, 40])
def test_all_fits_the_terminal(plant: Judgement, width: int, height: int) -> None:
    lines = statistics_lines(plant, width=width, height=height)
    assert len(lines) < height
    assert max(len(line.text) for line in lines) <= width


def test_a_small_terminal_says_what_has_no_room(plant: Judgement) -> None:
    *_, last = statistics_lines(plant, width=80, height=20)
    assert last.text == (
        "left out: poll cycles, histogram (--top 10); column line (a wider terminal)"
    )


@pytest.mark.parametrize("width", [60, 80, 100])
@pytest.mark.parametrize("height", [100, None])
def test_a_narrow_terminal_says_which_columns_have_no_room(
    plant: Judgement, width: int, height: int | None
) -> None:
    wide, narrow = (
        " ".join(line.text for line in statistics_lines(plant, width=one, height=height))
        for one in (200, width)
    )
    shown, _, told = narrow.partition("left out: column")
    for title in ("p99", "max", "+-ms", "+miss ms"):
        assert (f" {title} " in f"{shown} ") is not (f" {title}" in told)
    assert "left out" not in wide


def test_the_number_that_is_said_to_show_all_shows_all(plant: Judgement) -> None:
    def texts(top: int) -> list[str]:
        return [line.text for line in statistics_lines(plant, width=120, height=24, top=top)]

    assert "  ... 7 more polls; --top 9 shows all" in texts(2)
    assert not any("more" in line and "polls;" in line for line in texts(9))


def test_lists_whose_polls_have_no_room_are_counted(plant: Judgement) -> None:
    told = [line.text for line in statistics_lines(plant, width=120, top=5)]
    assert "  ... the polls of 1 more list; --top 10 shows them" in told
    assert not any("more list" in line.text for line in statistics_lines(plant, width=120, top=10))


def test_cycles_of_the_last_requests_say_of_how_many(monkeypatch: pytest.MonkeyPatch) -> None:
    records = [request(100 * at, at % 2) for at in range(40)]
    assert not any("of the last" in line for line in lines_of(*records))
    monkeypatch.setattr(master_tape, "MAX_ASKED", 30)
    assert "  of the last 30 of 40 requests" in lines_of(*records)
    others = [request(100 * at, at % 2, link="other") for at in range(40)]
    assert "  of the last 30 requests of each master" in lines_of(*records, *others)


def test_the_polls_that_keep_a_line_most_are_whole(plant: Judgement) -> None:
    def kept(width: int | None) -> str:
        lines = (line.text for line in statistics_lines(plant, width=width))
        (text,) = (text for text in lines if "kept most by" in text)
        return text

    whole = kept(None)
    for width in (len(whole) - 1, 50):
        assert len(kept(width)) <= width
        assert whole.startswith(f"{kept(width)}; ")


def test_a_pipe_has_all_sections(plant: Judgement) -> None:
    text = "\n".join(line.text for line in statistics_lines(plant, width=None))
    for title in ("line: busy", "polls: failed, slowest", "poll cycles", "latency of all"):
        assert title in text
    assert "in no cycle: 1 03 " in text
    assert "more than once a cycle: 1 03 " in text
    assert "the master waits 29" in text
    assert "left out" not in text


def test_the_worst_comes_right_after_the_sum() -> None:
    lines = lines_of(
        *(request(at * 100) for at in range(10)), unanswered(2000, unit=5), request(3000),
        request(3100, outcome=Outcome.EXCEPTION, exception=2, exception_name="busy"),
        request(3200, outcome=Outcome.NOT_CAPTURED),
    )  # fmt: skip
    assert lines[0].startswith("rtu line 9600-8E1, 2 units: 14 requests in ")
    assert lines[1].startswith("! unit 5 never answers (1 request): check its power")
    text = " ".join(line.strip() for line in lines)
    assert "! unit 1 refuses 1 of its 13 requests (7.7 %), with 02 illegal data address" in text
    assert "1 not captured whole: the capture's loss, not a device's fault" in lines


def test_a_slow_unit_is_named() -> None:
    def told(times: int) -> list[str]:
        return lines_of(
            *(request(at * 100) for at in range(10)),
            *(request(at * 100 + 10, unit=7, latency_ns=80_000_000) for at in range(times)),
        )

    slow = (
        "! unit 7 is slow: half of its answers take 80.0 ms or more, those of most others 5.0 ms "
        "or less"
    )
    assert slow in " ".join(line.strip() for line in told(5))
    assert not any("slow" in line and line.startswith("!") for line in told(4))


def test_hours_are_told_where_answers_are_missing_in_some_of_them() -> None:
    hour_ms = 3_600_000
    lines = lines_of(request(0), unanswered(hour_ms), request(hour_ms + 10))
    at = lines.index("answers missing, by hour (UTC)")
    assert lines[at + 1] == "  2026-01-01 01:00         1 of 2"


def test_connections_are_told_where_there_is_something_to_tell() -> None:
    source, destination = "10.0.0.1:5001", "10.0.0.9:502"

    def event(kind: EventKind, message: str) -> WireEvent:
        return WireEvent(
            ts_ns=START_NS, link="10.0.0.9", kind=kind, message=message,
            source=source, destination=destination,
        )  # fmt: skip

    asked = request(
        0, link="10.0.0.9", transport=Transport.TCP, source=source, destination=destination
    )
    opened = event(EventKind.OPENED, CONNECTION_OPENED)
    assert not any("10.0.0.1 to" in line for line in lines_of(opened, asked))
    reset = event(
        EventKind.CLOSED, "connection closed: reset, 4 keep-alive probes, the last 3 unanswered"
    )
    lines = lines_of(opened, asked, reset)
    assert lines[1].startswith("! 1 connection of 10.0.0.1 to 10.0.0.9 lost: 1 reset: ")
    (row,) = (line for line in lines if line.startswith("10.0.0.1 to 10.0.0.9"))
    assert row.split()[3:] == ["1", "1", "1", "4", "(-3)"]


def test_top_limits_the_rows_of_each_section(plant: Judgement) -> None:
    lines = [line.text for line in statistics_lines(plant, width=120, height=24, top=2)]
    assert any("more polls; --top " in line for line in lines)
    assert not any(line.startswith("left out") for line in lines)


def test_nothing_heard_is_said() -> None:
    assert lines_of() == ["no transactions so far"]


def test_a_document_is_one_of_plain_ascii_whatever_a_log_says() -> None:
    statistics = Account(lambda _: LINE)
    statistics.add(request(0, reference="\x1b[2J=cmd|'/C calc'!A0 \u202e"))
    statistics.settle()
    text = statistics_document(statistics, judged(statistics), sources=["x"], where=None)
    assert text.isascii()
    assert "\x1b" not in text
    assert json.loads(text)["links"][0]["polls"][0]["reference"].startswith("\x1b[2J")


def test_polls_that_failed_most_come_first_and_the_title_says_so() -> None:
    statistics = Account(lambda _: LINE)
    for at in range(0, 5000, 1000):
        statistics.add(request(at, 1, reference="A", latency_ns=3_000_000))
        statistics.add(request(at + 100, 2, reference="B", latency_ns=40_000_000))
        statistics.add(unanswered(at + 200, 3, reference="C"))
        statistics.add(unanswered(at + 700, 4, reference="D"))
        statistics.add(unanswered(at + 900, 4, reference="D"))
    lines = [line.text for line in statistics_lines(judged(statistics), width=None)]
    first = next(at for at, line in enumerate(lines) if line.startswith("polls: failed, slowest"))
    assert [line.split()[2] for line in lines[first + 1 : first + 5]] == [
        "D", "C", "B", "A",
    ]  # fmt: skip


def test_damaged_answers_are_told_and_cost_no_waiting() -> None:
    """Unit 2 is dead: the master waits 400 ms. Unit 3's answers are damaged: it goes on at once."""
    records: list[NamedTransaction | WireEvent] = []
    for at_ms in range(0, 10_000, 1000):
        damaged_ns = START_NS + (at_ms + 620) * 1_000_000
        records += [
            request(at_ms),
            unanswered(at_ms + 200, unit=2),
            WireEvent(ts_ns=damaged_ns, link="line", kind=EventKind.BAD_CHECK, message="", raw=b""),
            unanswered(at_ms + 610, unit=3),
            request(at_ms + 630),
        ]
    statistics = Account(lambda _: LINE)
    for one in records:
        statistics.add(one)
    statistics.settle()
    (link,) = report(statistics)
    assert link.tally.damaged == 10
    assert link.load is not None
    assert link.load.share_of_time(link.load.spent.missing_ns) == pytest.approx(0.41, abs=0.03)
    lines = [line.text for line in statistics_lines(judged(statistics, [link]), width=None)]
    assert lines[1].startswith("! unit 2 never answers (10 requests): ")
    assert lines[2].startswith("! unit 3 answers all its requests with a wrong CRC: ")
    text = statistics_document(statistics, judged(statistics, [link]), sources=["x"], where=None)
    assert json.loads(text)["links"][0]["wrong_crc"] == 10


def test_answers_that_nobody_asked_for_are_neither_requests_nor_exceptions_of_the_table() -> None:
    alone: dict[str, Any] = {
        "outcome": Outcome.UNSOLICITED,
        "exception": 1,
        "exception_name": "illegal function",
        "request_ns": None,
        "request_raw": None,
        "latency_ns": None,
    }
    refused: dict[str, Any] = {
        "outcome": Outcome.EXCEPTION,
        "exception": 2,
        "exception_name": "illegal address",
    }
    statistics = counting(request(0), request(100, **refused), request(200, **alone))
    told = judged(statistics)
    text = "\n".join(line.text for line in statistics_lines(told, width=None))
    assert ": 2 requests in " in text
    assert "1 answer without a request, not counted above" in text
    assert "! unit 1 refuses 1 of its 2 requests (50 %), with 02 illegal data address" in text
    document = json.loads(statistics_document(statistics, told, sources=["a"], where=None))
    (link,) = document["links"]
    assert (link["transactions"], link["requests"]) == (3, 2)
    assert link["exception"] == sum(one["count"] for one in link["exceptions"]) == 1
    assert (link["unsolicited"], link["unsolicited_exceptions"]) == (1, 1)
