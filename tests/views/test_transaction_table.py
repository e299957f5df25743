"""The table as text: on a terminal of 80 columns, and into a pipe."""

from __future__ import annotations

import io
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from mbtool.core import EventKind, WireEvent
from mbtool.core.moments import host_of
from mbtool.devices import PointValue
from mbtool.modbus import Outcome, Transport
from mbtool.views.place_columns import FEW_ROWS
from mbtool.views.table_options import TableColumn, TableOptions, TimeStyle
from mbtool.views.transaction_table import SAMPLE, TransactionTable
from tests.logs.samples import transaction, transactions

START_NS = 1_700_000_000_000_000_000
DAY_NS = 86_400_000_000_000
REFUSED: dict[str, Any] = {
    "outcome": Outcome.EXCEPTION,
    "exception": 2,
    "exception_name": "illegal data address",
    "response_values": None,
}


class Screen:
    """A table and what it has printed."""

    def __init__(
        self,
        *,
        terminal: bool = True,
        width: int = 80,
        color: bool = False,
        sample: int = SAMPLE,
        **options: Any,
    ) -> None:
        self._file = io.StringIO()
        console = Console(
            file=self._file,
            width=width,
            force_terminal=terminal,
            color_system="standard" if color else None,
            legacy_windows=False,
        )
        self.table = TransactionTable(console, TableOptions(**options), sample=sample)
        self._number = 0

    def add(self, ts_ns: int = START_NS, **fields: Any) -> None:
        self._number += 1
        one = transaction(
            **{"request_ns": ts_ns, "latency_ns": 2_700_000, "reference": "HR400001", **fields}
        )
        self.table.add(self._number, one)

    def event(self, **fields: Any) -> None:
        about: dict[str, Any] = {"ts_ns": START_NS, "link": "rs485", "kind": EventKind.GAP}
        self.table.add(self._number, WireEvent(**{**about, "message": "60 bytes", **fields}))

    @property
    def text(self) -> str:
        self.table.flush()
        return self._file.getvalue()

    @property
    def lines(self) -> list[str]:
        return self.text.splitlines()

    @property
    def rows(self) -> list[str]:
        """The lines that begin with a number."""
        return [line for line in self.lines if line[:5].strip().isdigit()]


def test_an_ordinary_row_is_one_line_of_80_columns() -> None:
    screen = Screen()
    screen.add(device="idec-ft1a-touch", reference="HR400001..400004", response_values=[9999] * 3)
    screen.add(START_NS + 60_000_000, reference="HR404096..404097", **REFUSED)
    assert screen.lines == [
        "rtu rs485, unit 1 idec-ft1a-touch, 2023-11-14 UTC",
        "    # time             ms  request -> response",
        "    1 22:13:20.000    2.7  03 read HR400001..400004 -> 9999, 9999, 9999",
        "rtu rs485, unit 1, 2023-11-14 UTC",
        "    2 22:13:20.060    2.7  03 read HR404096..404097 -> 02 illegal data address",
    ]


@given(st.lists(transactions, min_size=1, max_size=5), st.integers(40, 200))
def test_no_line_below_a_row_is_wider_than_the_terminal(rows: list[Any], width: int) -> None:
    screen = Screen(width=width, full=True)
    for number, one in enumerate(rows, 1):
        screen.table.add(number, one)
    told = screen.lines
    assert all(len(line) <= width or not line.startswith(" " * 12) for line in told)


def test_a_long_text_goes_on_below_and_says_how_much_is_left() -> None:
    screen = Screen()
    screen.add(response_values=list(range(1000, 1125)))
    lines = screen.lines[2:]
    assert (
        lines[0] == "    1 22:13:20.000    2.7  03 read HR400001 -> 1000, 1001, 1002, 1003, 1004,"
    )
    assert lines[1].startswith(" " * 12 + "1005, 1006, ")
    assert len(lines) == 5
    assert lines[-1] == " " * 12 + "... 8 more lines; --full shows them"
    assert max(map(len, lines)) <= 80


@given(values=st.lists(st.integers(0, 65535), min_size=1, max_size=125), width=st.integers(40, 200))
def test_all_values_are_shown_with_full(values: list[int], width: int) -> None:
    short, whole = Screen(width=width, full=True), Screen(terminal=False)
    for screen in (short, whole):
        screen.add(response_values=values)
    (expected,) = whole.rows
    shown = " ".join(line.strip() for line in short.lines[2:])
    assert shown.partition(" -> ")[2] == expected.partition(" -> ")[2]


def test_findings_stand_below_their_row() -> None:
    screen = Screen()
    screen.add(findings=["FT1A-A3", "MB-102"])
    assert [line.strip() for line in screen.lines[3:]] == [
        "FT1A-A3 not an address that one can read",
        "MB-102 a request does not have the form of its function",
    ]


@pytest.mark.parametrize("options", [{"terminal": False}, {"wide": True}])
def test_in_a_pipe_and_with_wide_a_row_is_one_line_whose_text_is_last(
    options: dict[str, Any],
) -> None:
    screen = Screen(**options)
    screen.add(response_values=list(range(125)), findings=["FT1A-A3"])
    screen.add(link="10.0.0.1")
    screen.event()
    assert len(screen.lines) == 5
    assert screen.lines[0] == "2023-11-14 UTC"
    assert screen.lines[2].endswith("124  ! FT1A-A3 not an address that one can read")
    at = screen.lines[1].index("request -> response")
    assert [line[at - 2 : at + 4] for line in screen.lines[2:]] == ["  03 r", "  03 r", "  gap:"]


def test_a_heading_comes_again_when_something_in_it_changes() -> None:
    screen = Screen()
    for ts_ns, unit in ((START_NS, 1), (START_NS, 1), (START_NS, 2), (START_NS + DAY_NS, 2)):
        screen.add(ts_ns, unit=unit)
    assert [line for line in screen.lines if line.startswith("rtu")] == [
        "rtu rs485, unit 1, 2023-11-14 UTC",
        "rtu rs485, unit 2, 2023-11-14 UTC",
        "rtu rs485, unit 2, 2023-11-15 UTC",
    ]


def test_units_that_are_polled_in_turn_stand_in_their_rows() -> None:
    screen = Screen()
    for unit in (1, 2, 3, 1, 2, 3):
        screen.add(unit=unit)
    assert screen.lines[:2] == [
        "rtu rs485, 2023-11-14 UTC",
        "    # time             ms unit  request -> response",
    ]
    assert [row[25:30].strip() for row in screen.rows] == ["1", "2", "3", "1", "2", "3"]


def test_of_several_slaves_and_masters_each_row_has_its_own() -> None:
    screen = Screen(width=120)
    for number in range(8):
        screen.add(
            transport=Transport.TCP,
            link=f"10.0.0.{number % 2 + 1}",
            source=f"10.0.0.{number % 3 + 7}:49152",
            destination=f"10.0.0.{number % 2 + 1}:502",
        )
    heading, titles, row, *_ = screen.lines
    assert heading == "unit 1, 2023-11-14 UTC"
    assert titles.split() == ["#", "time", "ms", "link", "master", "request", "->", "response"]
    assert row.split()[3:5] == ["10.0.0.1", "10.0.0.7"]


def test_a_narrow_terminal_shows_the_addresses_of_one_network_by_their_last_numbers() -> None:
    screen = Screen()
    for number in range(6):
        host = f"192.168.100.{100 + number % 3}"
        screen.add(transport=Transport.TCP, link=host, source="10.0.0.7:49152", **REFUSED)
    screen.table.pause()
    screen.add(transport=Transport.TCP, link="192.168.3.100", source="10.0.0.7:49152")
    heading, titles, *_ = screen.lines
    assert heading == "link 192.168.100.*, master 10.0.0.7, unit 1, 2023-11-14 UTC"
    assert titles == "    # time             ms link  request -> response"
    first = "    1 22:13:20.000    2.7 .100  03 read HR400001 -> 02 illegal data address"
    assert screen.rows[0] == first
    assert screen.rows[-1].split()[3] == "192.168.3.100"


def test_a_live_table_shortens_addresses_once_they_change_often() -> None:
    screen = Screen()
    for number in range(5):
        link = f"10.0.0.{number % 2 + 5}"
        screen.add(transport=Transport.TCP, link=link, source="10.0.0.7:49152")
        screen.table.pause()
    assert screen.rows[-1].split()[3] == ".5"


def test_columns_are_as_wide_as_the_addresses_in_the_first_rows() -> None:
    screen = Screen(terminal=False)
    for number in range(3):
        screen.add(link=f"[fd00::1234:5678:9abc:def{number}]:1502")
    titles, *rows = screen.lines[1:]
    at = titles.index("request")
    assert all(row[at - 2 : at + 2] == "  03" for row in rows)


def test_a_live_table_moves_a_place_into_the_rows_once_it_changes_often() -> None:
    screen = Screen()
    for unit in (1, 2, 1, 2, 1, 2):
        screen.add(unit=unit)
        screen.table.pause()
    assert screen.lines[0] == "rtu rs485, unit 1, 2023-11-14 UTC"
    assert screen.lines[-4].split()[3] == "1"
    assert len([line for line in screen.lines if line.startswith("rtu")]) == 3


def test_a_place_that_changes_seldom_stays_in_the_heading() -> None:
    screen = Screen()
    for number in range(4 * FEW_ROWS):
        screen.add(unit=1 + number // FEW_ROWS)
    assert len([line for line in screen.lines if line.startswith("rtu")]) == 4


def test_an_event_needs_no_heading_of_its_own() -> None:
    screen = Screen()
    screen.add()
    screen.event()
    screen.add()
    assert len(screen.lines) == 5
    assert screen.lines[3] == "      22:13:20.000         gap: 60 bytes"


def test_what_changed_comes_before_what_did_not() -> None:
    screen = Screen(terminal=False)
    for values in ((1, 2), (1, 3), (1, 3)):
        points = [
            PointValue(name=f"CH{at} level", reference=f"D{at}", value=value, text=str(value))
            for at, value in enumerate(values)
        ]
        screen.add(points=points)
    assert [row.partition(" -> ")[2] for row in screen.rows] == [
        "level: CH0 1, CH1 2",
        "level: CH1 3, CH0 1",
        "level: CH0 1, CH1 3",
    ]


def measured(*values: int, text: str = "{}") -> list[PointValue]:
    return [
        PointValue(
            name=f"CH{at} digital operation value",
            reference=f"RWr{at}",
            value=value,
            text=text.format(value),
        )
        for at, value in enumerate(values, 1)
    ]


@pytest.mark.parametrize(
    ("again", "shown"),
    [
        ((9, 9, 9, 9, 9, 9), "as before"),
        ((9, 9, 8, 9, 9, 9), "-> CH3 8; 5 others as before"),
        ((9, 9, 8, 9, 7, 9), "-> CH3 8, CH5 7; 4 others as before"),
    ],
)
def test_a_text_that_is_too_long_only_counts_what_is_as_before(
    again: tuple[int, ...], shown: str
) -> None:
    first = "digital operation value: CH1 9, CH2 9, CH3 9, CH4 9, CH5 9, CH6 9"
    for full in (False, True):
        screen = Screen(full=full)
        for values in ((9, 9, 9, 9, 9, 9), again):
            screen.add(points=measured(*values))
        text = " ".join(line.strip() for line in screen.lines[2:])
        told = text.partition("    2 ")[0].partition(" -> ")[2]
        assert told.startswith(first)
        assert text.endswith(shown) is not full


def test_points_of_several_kinds_keep_their_names() -> None:
    screen = Screen()
    for sent in (1, 2):
        screen.add(
            points=[
                PointValue(name="Energy received", reference="D1", value=1, text="1.00 kWh"),
                PointValue(name="Energy sent", reference="D2", value=sent, text=f"{sent}.00 kWh"),
            ]
        )
    assert screen.lines[-1].endswith("-> Energy sent: 2.00 kWh; 1 other as before")


def test_a_text_that_fits_its_line_tells_every_point() -> None:
    screen = Screen(width=100)
    for _ in range(2):
        screen.add(points=measured(1, 2))
    assert screen.rows[1].endswith("digital operation value: CH1 1, CH2 2")


def test_bits_that_are_as_before_are_told_beside_one_that_changed() -> None:
    screen = Screen(width=60)
    for values in ((0, 0, 1), (0, 0, 1), (1, 0, 1)):
        points = [
            PointValue(
                name=f"CH{at} conversion completion flag",
                reference=f"X{at}",
                value=value,
                text="on" if value else "off",
            )
            for at, value in enumerate(values, 1)
        ]
        screen.add(points=points)
    text = " ".join(line.strip() for line in screen.lines[2:])
    assert text.count("flag: CH3 on") == 1
    assert "as before" in text
    assert text.endswith("flag: CH1 CH3 on")


def test_an_exception_has_fewer_words_where_they_do_not_fit() -> None:
    gateway = {**REFUSED, "exception": 11, "exception_name": "gateway target failed to respond"}
    for width, name in ((100, "gateway target failed to respond"), (78, "gateway: no answer")):
        screen = Screen(width=width)
        screen.add(reference="HR400001..400010", **gateway)
        assert screen.rows[0].endswith(f"-> 0B {name}")
    screen = Screen(width=70)
    screen.add(reference="HR400001..400010", **{**gateway, "exception_name": "no such card here"})
    assert screen.lines[-1].strip() == "-> 0B no such card here"


def test_a_result_that_does_not_fit_stands_below_its_request() -> None:
    screen = Screen(width=60)
    screen.add(reference="HR400001..400010", response_values=list(range(10)))
    assert [line.strip() for line in screen.lines[3:]] == ["-> 0, 1, 2, 3, 4, 5, 6, 7, 8, 9"]


def test_a_count_of_equal_values_is_not_torn() -> None:
    screen = Screen(width=61)
    screen.add(response_values=[10, 11, 12, 13, 14, *[65535] * 65, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10])
    assert any("65535 x65," in line for line in screen.lines)


def test_a_text_without_room_beside_its_columns_stands_below_them() -> None:
    screen = Screen(width=60, columns=(TableColumn.TIME, TableColumn.MASTER, TableColumn.SLAVE))
    screen.add(source="192.168.100.100:49152", destination="192.168.100.102:50200")
    assert screen.lines[2] == "22:13:20.000 192.168.100.100 192.168.100.102:50200"
    assert screen.lines[3] == " " * 12 + "03 read HR400001 -> 4660, 22136"


def test_a_row_names_its_packets_and_its_file() -> None:
    screen = Screen(terminal=False, columns=(TableColumn.PACKET, TableColumn.FILE))
    screen.add(request_packet=7, response_packet=12, file="plant.pcap")
    screen.add(request_packet=7, response_packet=7)
    screen.add(request_packet=13)
    screen.add(request_offset=13)
    screen.event()
    cells = [line.partition("  03 ")[0].split() for line in screen.lines[1:]]
    assert cells[1:5] == [["7/12", "plant.pcap"], ["7"], ["13/-"], []]


def test_values_are_shown_in_hexadecimal_where_asked() -> None:
    screen = Screen(in_hex=True)
    screen.add(points=[PointValue(name="Level", reference="D1", value=1, text="1 m")])
    assert screen.rows[0].endswith("-> 1234H, 5678H")


@pytest.mark.parametrize(
    ("style", "told"),
    [
        (TimeStyle.UTC, ["22:13:20.000", "22:13:21.500", "22:13:21.750"]),
        (TimeStyle.RELATIVE, ["+0.000000", "+1.500000", "+1.750000"]),
        (TimeStyle.DELTA, ["+0.000000", "+1.500000", "+0.250000"]),
    ],
)
def test_times_are_shown_as_asked(style: TimeStyle, told: list[str]) -> None:
    screen = Screen(time=style)
    for after_ns in (0, 1_500_000_000, 1_750_000_000):
        screen.add(START_NS + after_ns)
    assert [row.split()[1] for row in screen.rows] == told


def test_local_time_is_that_of_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    monkeypatch.setenv("TZ", "UTC-05:30")  # By POSIX, east of Greenwich is negative.
    time.tzset()
    screen = Screen(time=TimeStyle.LOCAL)
    screen.add()
    text = screen.text
    monkeypatch.undo()
    time.tzset()
    assert "2023-11-15 local time" in text
    assert "03:43:20.000" in text


def test_chosen_columns_stand_in_their_order_before_the_text() -> None:
    screen = Screen(
        wide=True,
        columns=(TableColumn.OUTCOME, TableColumn.ID, TableColumn.DEVICE, TableColumn.SLAVE),
    )
    screen.add(
        transaction_id=7, device="fa3-at1m8x", destination="10.0.0.1:502", outcome=Outcome.OK
    )
    screen.event()
    _, titles, row, event = screen.lines
    assert titles.split()[:4] == ["outcome", "id", "device", "slave"]
    assert row.split()[:5] == ["ok", "7", "fa3-at1m8x", "10.0.0.1:502", "03"]
    assert event.split() == ["gap", "gap:", "60", "bytes"]


def test_control_characters_and_markup_are_text() -> None:
    for terminal in (True, False):
        screen = Screen(terminal=terminal, color=True)
        screen.add(link="[red]x", reference=f"\x1b[2Ja\nb\x9bc\u202ed{'x' * 80}\x07")
        assert "[red]x" in screen.text
        assert "?[2Ja?b?c?d" in screen.text
        assert "\x1b[2J" not in screen.text
        assert "\x07" not in screen.text


@pytest.mark.parametrize(
    ("fields", "code"),
    [({}, None), ({"outcome": Outcome.NO_ANSWER, "response_values": None}, "\x1b[31m")],
)
def test_trouble_is_red(fields: dict[str, Any], code: str | None) -> None:
    screen = Screen(color=True)
    screen.add(**fields)
    row = screen.lines[2]
    assert row.startswith(f"{code}    1") if code is not None else row.startswith("    1")
    assert row.endswith("\x1b[0m") is (code is not None)


def test_an_event_is_yellow_unless_a_connection_opens_or_closes() -> None:
    screen = Screen(color=True)
    screen.event()
    screen.event(kind=EventKind.OPENED)
    assert screen.lines[2].startswith("\x1b[33m      22:13:20.000")
    assert screen.lines[3].startswith("      22:13:20.000")


def test_a_row_is_shown_when_there_is_a_pause() -> None:
    screen = Screen()
    screen.add()
    before = screen._file.getvalue()
    screen.table.pause()
    assert (before, len(screen.lines)) == ("", 3)


def test_rows_are_shown_when_the_sample_is_complete() -> None:
    screen = Screen(terminal=False, sample=3)
    for _ in range(3):
        screen.add()
    assert len(screen._file.getvalue().splitlines()) == 5


def test_nothing_is_shown_of_nothing() -> None:
    assert Screen().text == ""


@pytest.mark.parametrize(
    ("address", "host"),
    [("10.0.0.1:502", "10.0.0.1"), ("[fe80::1]:502", "fe80::1"), (None, ""), ("odd", "odd")],
)
def test_an_address_has_a_host(address: str | None, host: str) -> None:
    assert host_of(address) == host


@given(st.lists(transactions, max_size=20), st.booleans())
def test_each_transaction_has_a_row(rows: list[Any], terminal: bool) -> None:
    screen = Screen(terminal=terminal, sample=5)
    for number, one in enumerate(rows, 1):
        screen.table.add(number, one)
    assert [int(row[:5]) for row in screen.rows] == list(range(1, len(rows) + 1))
