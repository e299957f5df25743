"""The cells of polls, points, transactions, troubles and slaves, and their details."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import clock_time
from mbtool.devices import PointValue
from mbtool.modbus import Outcome, Transport, Verdict, ascii_adu
from mbtool.views.watch_columns import (
    DrawContext,
    FittedColumn,
    WatchColumn,
    cut_spans,
    fitted,
    row_spans,
    row_text,
)
from mbtool.views.watch_detail import record_detail, slave_detail, trouble_detail
from mbtool.views.watch_places import place_columns
from mbtool.views.watch_polls import POINT_COLUMNS, POLL_COLUMNS, poll_values
from mbtool.views.watch_records import (
    RECORD_COLUMNS,
    SLAVE_COLUMNS,
    TROUBLE_COLUMNS,
    fitted_record,
    slave_state,
)
from mbtool.watching.board import (
    Board,
    point_rows,
    poll_rows,
    record_rows,
    slave_rows,
    trouble_rows,
)
from mbtool.watching.value_formats import ValueFormat
from mbtool.watching.watched_rows import kept_record
from tests.ledger.masters import MS, START_NS
from tests.ledger.requests import LINE, request, unanswered
from tests.troubles.judging import judged

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.views.watch_columns import Spans
    from mbtool.watching.watched_rows import Record


def damaged(at_ms: float) -> WireEvent:
    at_ns = START_NS + round(at_ms * MS)
    return WireEvent(ts_ns=at_ns, link="line", kind=EventKind.BAD_CHECK, message="", raw=b"")


NOISE = WireEvent(
    ts_ns=START_NS, link="line", kind=EventKind.SKIPPED, message="noise", raw=b"\xfe\xfd"
)


def board_of(*records: Record) -> Board:
    board = Board(lambda _: LINE)
    for order, record in enumerate(records, 1):
        board.add(kept_record(order, order, record))
    board.judgement = judged(board.account)
    return board


def read(at_ms: float, *values: int, **fields: Any) -> Record:
    return request(at_ms, **{"response_values": list(values), "quantity": len(values), **fields})


def time_of(record: Record) -> int:
    return record.ts_ns if isinstance(record, WireEvent) else record.start_ns


def text_of(spans: Spans) -> str:
    return "".join(text for text, _ in spans)


def lines_of(lines: Sequence[Spans]) -> str:
    return "\n".join(map(text_of, lines))


def cell(columns: tuple[WatchColumn, ...], name: str, row: Any, context: DrawContext) -> str:
    (column,) = (one for one in columns if one.name == name)
    made = column.cell(row, context)
    return made if isinstance(made, str) else text_of(made)


def test_changed_values_of_a_poll_are_lit_and_fade() -> None:
    (row,) = poll_rows(board_of(read(0, 1, 2), read(100, 1, 3)))
    for after_ms, style in ((200, "bold reverse"), (3000, "bold yellow"), (9000, "")):
        context = DrawContext(now_ns=START_NS + after_ms * MS)
        assert poll_values(row, context)[2] == ("3", style)
        assert poll_values(row, context)[0] == ("1", "")


def test_a_poll_in_the_format_of_its_row() -> None:
    (row,) = poll_rows(board_of(read(0, 0x4148, 0)))
    context = DrawContext(formats={row.key: ValueFormat.FLOAT_ABCD})
    assert text_of(poll_values(row, context)) == "12.5 "


def test_bits_are_shown_in_groups() -> None:
    bits = [1, 0] * 6
    (row,) = poll_rows(board_of(read(0, *bits, function=1)))
    assert text_of(poll_values(row, DrawContext())) == "10101010 1010"


def test_a_poll_with_an_error_shows_it_before_the_last_values() -> None:
    (row,) = poll_rows(board_of(read(0, 7), unanswered(100, quantity=1)))
    assert text_of(poll_values(row, DrawContext())) == "no answer last 7 "


def test_named_points_that_changed_come_first() -> None:
    def points(second: str) -> list[PointValue]:
        return [
            PointValue(name="CH1 value", reference="D1", value=1, text="1 V"),
            PointValue(name="CH2 value", reference="D2", value=float(second), text=f"{second} V"),
        ]

    (row,) = poll_rows(
        board_of(read(0, 1, 2, points=points("2")), read(9, 1, 3, points=points("3")))
    )
    spans = poll_values(row, DrawContext(now_ns=START_NS + 100 * MS))
    assert spans[0] == ("CH2 value 3 V", "bold reverse")
    assert text_of(spans) == "CH2 value 3 V, CH1 value: 1 V"


def test_an_age_is_lit_when_a_poll_is_overdue() -> None:
    board = board_of(*(read(at, 1, transport=Transport.TCP) for at in range(0, 500, 100)))
    board.advance(None)
    (row,) = poll_rows(board)
    (age,) = (one for one in POLL_COLUMNS if one.name == "age")
    late = DrawContext(now_ns=START_NS + 1000 * MS)
    assert age.cell(row, late) == [("0.6s", "bold yellow")]
    assert age.cell(row, DrawContext(now_ns=START_NS + 500 * MS)) == [("0.1s", "")]
    late.is_over = True
    assert age.cell(row, late) == [("0.6s", "")]


def test_a_poll_in_bursts_has_no_period_and_is_never_overdue() -> None:
    times = [burst * 60_000 + at for burst in range(5) for at in range(0, 1000, 100)]
    board = board_of(*(read(at, 1, transport=Transport.TCP) for at in times))
    board.advance(None)
    (row,) = poll_rows(board)
    context = DrawContext(now_ns=START_NS + 300_000 * MS)
    assert cell(POLL_COLUMNS, "every", row, context) == "varies"
    (age,) = (one for one in POLL_COLUMNS if one.name == "age")
    assert age.cell(row, context) == [(" 59s", "")]


def test_every_cell_of_every_view_can_be_made_and_sorted() -> None:
    board = board_of(
        read(0, 1, 2),
        read(9, 3, 2, findings=["MB-101"]),
        NOISE,
        unanswered(20, unit=2),
        request(30, unit=3, outcome=Outcome.EXCEPTION, exception=2, exception_name="x"),
        request(40, function=0x2B, sub_function=0x0E, address=None, quantity=None),
    )
    context = DrawContext(now_ns=START_NS + 1000 * MS)
    for columns, rows in (
        (POLL_COLUMNS, poll_rows(board)),
        (POINT_COLUMNS, point_rows(board)),
        (RECORD_COLUMNS, record_rows(board)),
        (SLAVE_COLUMNS, slave_rows(board)),
        (TROUBLE_COLUMNS, trouble_rows(board)),
    ):
        assert rows
        for column in columns:
            assert len(sorted(rows, key=column.sort)) == len(rows)
        for row in rows:
            assert row_text(row, columns, context)


def test_a_point_in_a_format_and_with_its_value_before() -> None:
    first, _ = point_rows(board_of(read(0, 1, 2), read(9, 65535, 2)))
    context = DrawContext(formats={first.key: ValueFormat.SIGNED})
    assert cell(POINT_COLUMNS, "value", first, context) == "-1"
    assert cell(POINT_COLUMNS, "before", first, context) == "1"
    context.formats[first.key] = ValueFormat.FLOAT_CDAB
    assert cell(POINT_COLUMNS, "value", first, context) == "2.755051e-40"  # 0002FFFFH


def test_a_transaction_has_its_findings_and_its_mark() -> None:
    board = board_of(read(0, 1, reference="D1", findings=["MB-101"]))
    (row,) = record_rows(board)
    context = DrawContext(marked={1})
    assert cell(RECORD_COLUMNS, "text", row, context) == "03 read D1 -> 1 ! MB-101"
    assert cell(RECORD_COLUMNS, "mark", row, context) == "*"
    assert cell(RECORD_COLUMNS, "sure", row, context) == "100 %"


def test_only_a_retry_is_called_so() -> None:
    def asked(at_ms: int, retries: int) -> Record:
        return unanswered(at_ms, retries=retries, transport=Transport.TCP, reference="D1")

    polls, again = [asked(1000 * at, at) for at in range(9)], asked(8100, 9)
    board = board_of(*polls, again)
    board.advance(None)
    rows = record_rows(board)
    texts = [cell(RECORD_COLUMNS, "text", row, DrawContext()) for row in rows]
    assert texts == ["03 read D1 -> no answer"] * 9 + ["03 read D1 (retry) -> no answer"]
    for row, told in ((rows[1], "the equal request"), (rows[8], "the 8 equal requests")):
        lines = lines_of(record_detail(row.kept, None, 80))
        assert f"{told} before it got no answer" in lines
        assert "retry" not in lines


def test_an_exception_code_has_one_name_in_all_rows() -> None:
    """That of the standard, in few words; the words of the slave's manual are in the detail."""
    standard, manual, unknown = (
        request(at, unit=at, outcome=Outcome.EXCEPTION, exception=code, exception_name=name)
        for at, (code, name) in enumerate(
            [(2, "illegal data address"), (2, "device address error"), (0x11, "out of range")], 1
        )
    )
    board = board_of(standard, manual, unknown)
    told = ["02 illegal address", "02 illegal address", "11 out of range"]
    assert [text_of(poll_values(row, DrawContext())) for row in poll_rows(board)] == told
    rows = record_rows(board)
    texts = [cell(RECORD_COLUMNS, "text", row, DrawContext()) for row in rows]
    assert [text.partition(" -> ")[2] for text in texts] == told
    assert "02 device address error" in lines_of(record_detail(rows[1].kept, None, 80))


def test_the_code_of_a_finding_is_kept_where_the_text_is_cut() -> None:
    one = request(
        0, reference="HR404091..404100", outcome=Outcome.EXCEPTION, exception=2,
        exception_name="illegal data address", findings=["FT1A-A3"],
    )  # fmt: skip
    (row,) = record_rows(board_of(one))
    told = {
        width: text_of(cut_spans(fitted_record(row, DrawContext(), width), width)).rstrip()
        for width in (60, 49, 36)
    }
    assert told[60] == "03 read HR404091..404100 -> 02 illegal address ! FT1A-A3"
    assert told[49] == "03 read HR404091..404100 -> 02 illegal… ! FT1A-A3"
    assert told[36] == "03 read HR404091..404100 -> 02 …"


def test_under_a_filter_a_slave_is_judged_by_all_records() -> None:
    whole = board_of()
    failures = Board(whole=whole)
    for at in range(30):
        is_missing = at % 3 == 1
        one = unanswered(at) if is_missing else read(at, 1)
        whole.add(kept_record(at, at, one))
        if is_missing:
            failures.add(kept_record(at, at, one))
    whole.judgement = judged(whole.account)
    (row,) = slave_rows(failures)
    assert text_of(slave_state(row, DrawContext())) == "33 % unanswered"
    assert cell(SLAVE_COLUMNS, "asked", row, DrawContext()) == "10"
    text = lines_of(slave_detail(row, 100))
    assert "without the filter: asked 30, answered 20, missing 10" in text
    assert "last answer" in text
    assert "no answer since" not in text


def test_the_state_of_a_slave_is_in_words() -> None:
    def state(*records: Record) -> str:
        return text_of(slave_state(slave_rows(board_of(*records))[0], DrawContext()))

    fails = request(5, outcome=Outcome.EXCEPTION, exception=2)
    assert state(read(0, 1)) == "answers"
    assert state(unanswered(0)) == "never answers"
    assert state(read(0, 1), unanswered(6)) == "no answer since 00:00:00"
    assert state(unanswered(0), read(5, 1)) == "50 % unanswered"
    assert state(read(0, 1), fails) == "50 % refused"
    assert state(read(0, 1), damaged(7), unanswered(5)) == "50 % wrong CRC"
    assert state(damaged(7), unanswered(5)) == "100 % wrong CRC"


def test_a_poll_whose_last_answer_was_damaged_says_so() -> None:
    (row,) = poll_rows(board_of(read(0, 7), damaged(12), unanswered(10, quantity=1)))
    assert text_of(poll_values(row, DrawContext())) == "wrong CRC last 7 "


def test_a_share_of_failures_that_came_late_or_ended_is_of_the_requests_since() -> None:
    def state(*records: Record) -> str:
        return text_of(slave_state(slave_rows(board_of(*records))[0], DrawContext()))

    def times(first: int, last: int, step: int = 1) -> range:
        return range(1000 * first, 1000 * last, 1000 * step)

    well = [read(at, 1) for at in times(0, 45)]
    fails = [unanswered(at) for at in times(45, 60, 3)]
    others = [read(at, 1) for at in times(45, 60) if at % 3000]
    sick = sorted([*fails, *others], key=time_of)
    later = [read(at, 1) for at in times(60, 120)]
    since = clock_time(START_NS + 45_000 * MS)[:8]
    until = clock_time(START_NS + 57_000 * MS)[:8]
    assert state(*well, *sick) == f"33 % unanswered since {since}"
    assert state(*sick) == "33 % unanswered"
    assert state(*well, *sick, *later) == f"38 % unanswered from {since} to {until}"
    assert state(*sick, *later) == f"38 % unanswered until {until}"


def test_the_unit_of_an_event_is_a_sign_if_there_is_none() -> None:
    opened = WireEvent(ts_ns=START_NS, link="line", kind=EventKind.OPENED, message="")
    rows = trouble_rows(board_of(opened, damaged(5)))
    assert [cell(TROUBLE_COLUMNS, "unit", row, DrawContext()) for row in rows] == ["-", "?"]


def test_a_request_with_a_damaged_answer_says_so_and_comes_before_its_event() -> None:
    rows = record_rows(board_of(damaged(12), unanswered(10, reference="D1")))
    texts = [cell(RECORD_COLUMNS, "text", row, DrawContext()) for row in rows]
    assert texts == ["03 read D1 -> wrong CRC", "bad-check"]


@pytest.mark.parametrize("outcome", [Outcome.UNSOLICITED, Outcome.NOT_CAPTURED])
def test_a_slave_that_was_not_asked_refuses_nothing(outcome: Outcome) -> None:
    one = request(0, outcome=outcome, request_ns=None, request_raw=None)
    (row,) = slave_rows(board_of(one))
    assert text_of(slave_state(row, DrawContext())) == ""


def test_links_and_masters_are_shown_where_there_are_several() -> None:
    links = ["10.0.0.2", "10.0.0.103"]
    assert place_columns(links[:1], ["10.0.0.1"], 80) == {}
    assert place_columns(links, [], 80) == {"link": (4, "10.0.0")}
    assert place_columns(links, [], 120) == {"link": (10, "")}
    assert place_columns(["a"], ["10.0.0.1", "fe80::1"], 80) == {"master": (8, "")}


def test_a_place_takes_its_width_before_other_columns_and_is_shown_short() -> None:
    board = board_of(read(0, 1, link="10.0.0.2"), read(0, 1, link="10.0.0.3"))
    places = place_columns(["10.0.0.2", "10.0.0.3"], [], 80)
    columns = fitted(POLL_COLUMNS, 80, None, places)
    assert columns[0] == FittedColumn(columns[0].column, 4, "10.0.0")
    lines = [text_of(row_spans(row, columns, DrawContext())) for row in poll_rows(board)]
    assert [line[:4] for line in lines] == [".2  ", ".3  "]
    assert {len(line) for line in lines} == {80}
    chosen = fitted(POLL_COLUMNS, 80, ["unit", "values"], places)
    assert [one.column.name for one in chosen] == ["unit", "values"]


def test_the_detail_names_fields_and_says_why_and_how_sure() -> None:
    record = read(0, 1, confidence=0.75, verdicts=[Verdict.AMBIGUOUS], findings=["MB-101"],
                  points=[PointValue(name="CH1", reference="D1", value=1, text="1 V")])  # fmt: skip
    text = lines_of(record_detail(kept_record(1, 1, record), None, 80))
    assert "request  01 03 00 00 00 0a c5 cd" in text
    assert "unit 1 function 03H address 0 quantity 10 CRC" in text
    assert "direction by form: only one direction can have this form; sure to 75 %" in text
    assert "ambiguous: another reading is nearly as likely" in text
    assert "MB-101 " in text
    assert "D1 CH1: 1 V" in text
    assert "answered after 5.0 ms" in text


def test_the_detail_of_an_ascii_frame_has_its_characters() -> None:
    record = read(
        0,
        1,
        transport=Transport.ASCII,
        request_raw=ascii_adu(1, b"\x03\0\0\0\1"),
        response_raw=None,
    )
    text = lines_of(record_detail(kept_record(1, 1, record), None, 80))
    assert ": 01 03 0000 0001 FB CRLF" in text
    assert "address 0 quantity 1 LRC" in text
    assert "response none" in text


def test_the_detail_of_an_event_has_its_bytes() -> None:
    text = lines_of(record_detail(kept_record(1, None, NOISE), None, 80))
    assert "skipped" in text
    assert "fe fd" in text


def test_a_damaged_response_is_in_the_detail_of_its_request_and_of_its_slave() -> None:
    raw = bytes.fromhex("01 03 02 00 07 1234")
    board = board_of(
        WireEvent(
            ts_ns=START_NS + 12 * MS, link="line", kind=EventKind.BAD_CHECK, raw=raw,
            message="a frame with CRC 3412H, where 86F9H would be right",
        ),
        unanswered(10, reference="D1"), unanswered(30, reference="D1"),
    )  # fmt: skip
    damaged, _, missing = record_rows(board)
    assert list(board.damaged) == [damaged.kept.order]
    text = lines_of(record_detail(damaged.kept, None, 80, board.damaged[damaged.kept.order]))
    assert "unit 1, no-answer (wrong CRC)\n03 read D1 -> wrong CRC\n" in text
    assert "response 01 03 02 00 07 12 34\n         a frame with CRC 3412H, where 86F9H" in text
    assert "response none" not in text
    assert "response none" in lines_of(record_detail(missing.kept, None, 80))
    (slave,) = slave_rows(board)
    told = lines_of(slave_detail(slave, 100))
    assert "missing 2 (of these 1 with a wrong CRC or LRC), retries 0" in told


def test_the_detail_of_findings_or_events_says_how_often_and_when() -> None:
    (row,) = trouble_rows(board_of(*(read(at, 1, findings=["MB-101"]) for at in (0, 5))))
    text = lines_of(trouble_detail(row, None, 100))
    assert (
        "MB-101 of unit 1, line: 2 times, first 2026-01-01 00:00:00.000, last 00:00:00.005" in text
    )
    assert "unit 1 function 03H" in text
    for line in trouble_detail(row, None, 40)[:3]:
        assert len(text_of(line).rstrip()) <= 40
    (row,) = trouble_rows(board_of(NOISE))
    assert trouble_detail(row, None, 80) == record_detail(row.kept, None, 80)


def test_no_line_of_a_detail_is_wider_than_the_screen() -> None:
    record = read(0, *range(100), response_raw=bytes(range(200)), reference="x" * 30)
    for line in record_detail(kept_record(1, 1, record), None, 78)[1:]:
        assert len(text_of(line).rstrip()) <= 78


def test_the_detail_of_a_slave_has_its_counts() -> None:
    (row,) = slave_rows(board_of(read(0, 1), unanswered(6)))
    text = lines_of(slave_detail(row, 100))
    assert "asked 2, answered 1, missing 1, retries 0" in text
    assert "no answer since 00:00:00.006 UTC" in text
    assert "finding" not in text


def test_an_exception_is_an_answer_and_findings_say_what_they_are_of() -> None:
    refused = request(0, outcome=Outcome.EXCEPTION, exception=2, findings=["MB-101"])
    (row,) = slave_rows(board_of(refused, request(9, outcome=Outcome.MALFORMED), read(20, 1)))
    text = lines_of(slave_detail(row, 100))
    assert "asked 3, answered 3 (of these refused 1, malformed 1), missing 0, retries 0" in text
    assert "findings in single transactions 1; mbtool check FILE finds more" in text
