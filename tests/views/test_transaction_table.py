"""The table as text, at a width of 100, on a terminal and into a pipe."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from mbtool.core import EventKind, WireEvent
from mbtool.modbus import Outcome
from mbtool.views.cells import TransactionRow, day, event_row, transaction_row
from mbtool.views.transaction_table import SAMPLE, TransactionTable
from tests.logs.samples import transaction

START_NS = 1_700_000_000_000_000_000
DAY_NS = 86_400_000_000_000

LONG = ", ".join(str(number) for number in range(1000, 1020))


class Screen:
    """A table and what it has printed."""

    def __init__(
        self, *, terminal: bool, width: int = 100, color: bool = False, sample: int = SAMPLE
    ) -> None:
        self._file = io.StringIO()
        console = Console(
            file=self._file,
            width=width,
            force_terminal=terminal,
            color_system="standard" if color else None,
            legacy_windows=False,
        )
        self.table = TransactionTable(console, sample=sample)
        self._number = 0

    def add(self, ts_ns: int = START_NS, **fields: Any) -> None:
        self._number += 1
        one = transaction(**{"request_ns": ts_ns, "reference": "HR400001..400002", **fields})
        self.table.add(transaction_row(self._number, one), day(ts_ns))

    @property
    def text(self) -> str:
        return self._file.getvalue()

    @property
    def lines(self) -> list[str]:
        return self.text.splitlines()


def test_a_terminal_is_filled_and_long_cells_stand_in_full_below() -> None:
    screen = Screen(terminal=True)
    screen.add()
    screen.add(
        START_NS + 60_000_000,
        function=16,
        function_name="write multiple registers",
        request_values=list(range(1000, 1016)),
        outcome=Outcome.EXCEPTION,
        exception=2,
        exception_name="illegal data address",
        response_values=None,
        latency_ns=12_345_678,
    )
    screen.table.flush()
    assert screen.lines == [
        " #  time          link   unit  function            what                    result"
        "           latency",
        "    2023-11-14 UTC",
        " 1  22:13:20.000  rs485  1     03 read holding     HR400001..400002        4660, 22136"
        "      0.4 ms",
        " 2  22:13:20.060  rs485  1     10 write registers  HR400001..400002 := 1…  exception 02 i…"
        "  12.3 ms",
        "    HR400001..400002 := 1000, 1001, 1002, 1003, 1004, 1005, 1006, 1007, 1008, 1009, 1010,"
        " 1011,",
        "    1012, 1013, 1014, 1015",
        "    exception 02 illegal data address",
    ]
    assert max(map(len, screen.lines)) <= 100


def test_a_pipe_has_one_line_for_each_and_all_of_it() -> None:
    screen = Screen(terminal=False)
    screen.add(response_values=list(range(1000, 1016)))
    screen.add()
    screen.table.flush()
    values = ", ".join(str(number) for number in range(1000, 1016))
    assert screen.lines == [
        " #  time          link   unit  function            what              "
        "result                                                        latency",
        "    2023-11-14 UTC",
        f" 1  22:13:20.000  rs485  1     03 read holding     HR400001..400002  {values}  0.4 ms",
        " 2  22:13:20.000  rs485  1     03 read holding     HR400001..400002  "
        "4660, 22136                                                   0.4 ms",
    ]


def test_a_day_is_named_when_it_changes() -> None:
    screen = Screen(terminal=False)
    for ts_ns in (START_NS, START_NS + 1, START_NS + DAY_NS):
        screen.add(ts_ns)
    screen.table.flush()
    assert [line.strip() for line in screen.lines if line.endswith("UTC")] == [
        "2023-11-14 UTC",
        "2023-11-15 UTC",
    ]
    assert screen.lines[4] == "    2023-11-15 UTC"


def test_control_characters_and_markup_are_text() -> None:
    screen = Screen(terminal=True, color=True)
    screen.add(link="[red]x", reference="\x1b[2Ja\nb\x9bc\u202ed")
    screen.table.flush()
    row = screen.lines[2]
    assert "[red]x" in row
    assert "?[2Ja?b?c?d" in row
    assert "\x1b[2J" not in screen.text


def test_nothing_below_a_line_can_command_a_terminal() -> None:
    screen = Screen(terminal=True)
    screen.add(reference=f"\x1b[2J{'x' * 80}\x07")
    screen.table.flush()
    assert "\x1b" not in screen.text
    assert "\x07" not in screen.text


@pytest.mark.parametrize(
    ("fields", "code"),
    [({}, None), ({"outcome": Outcome.NO_ANSWER, "response_values": None}, "\x1b[31m")],
)
def test_trouble_is_red(fields: dict[str, Any], code: str | None) -> None:
    screen = Screen(terminal=True, color=True)
    screen.add(**fields)
    screen.table.flush()
    row = screen.lines[2]
    assert row.startswith(f"{code} 1") if code is not None else row.startswith(" 1")
    assert row.endswith("\x1b[0m") is (code is not None)


def test_an_event_is_yellow_and_has_no_number() -> None:
    screen = Screen(terminal=True, color=True)
    event = WireEvent(
        ts_ns=START_NS, link="rs485", kind=EventKind.GAP, message="60 bytes", missing=60
    )
    screen.table.add(event_row(event), day(START_NS))
    screen.table.flush()
    assert screen.lines[2].startswith("\x1b[33m    22:13:20.000  rs485        gap")


def test_a_row_is_shown_when_there_is_a_pause() -> None:
    screen = Screen(terminal=True)
    screen.add()
    assert screen.text == ""
    screen.table.pause()
    assert len(screen.lines) == 3
    screen.add()
    assert len(screen.lines) == 4


def test_rows_are_shown_when_the_sample_is_complete() -> None:
    screen = Screen(terminal=False, sample=3)
    for _ in range(3):
        screen.add()
    assert len(screen.lines) == 5


def test_nothing_is_shown_of_nothing() -> None:
    screen = Screen(terminal=True)
    screen.table.flush()
    assert screen.text == ""


def _live(screen: Screen) -> None:
    """A read, then what is longer in every way, as a sniffer shows them: each at once."""
    screen.add()
    screen.table.pause()
    screen.add(
        START_NS + 60_000_000,
        function=16,
        function_name="write multiple registers",
        reference="HR400001..400004",
        request_values=[4660, 22136, 1, 2],
        outcome=Outcome.EXCEPTION,
        exception=2,
        exception_name="illegal data address",
        response_values=None,
        latency_ns=1_234_567_890,
    )
    screen.table.pause()
    screen.add(response_values=list(range(1000, 1005)))
    screen.table.flush()


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("width", [80, 100, 120])
def test_the_columns_of_a_live_table_stand_still(width: int, terminal: bool) -> None:
    screen = Screen(terminal=terminal, width=width)
    _live(screen)
    heading, _, *lines = screen.lines
    result, latency = heading.index("result"), heading.index("latency")
    rows = [line for line in lines if line[:4].strip()]
    assert [row[latency:] for row in rows] == ["0.4 ms", "1234.6 ms", "0.4 ms"]
    assert [row[result - 2 : result + 4] for row in rows] == ["  4660", "  exce", "  1000"]
    assert not terminal or max(map(len, screen.lines)) <= width


def test_a_live_table_into_a_pipe_grows_for_what_is_longer_and_then_stands_still() -> None:
    screen = Screen(terminal=False)
    screen.add()
    screen.table.pause()
    for reference in ("R" * 50, "HR400001"):
        screen.add(reference=reference)
    first, *rest = (line.index("4660") for line in screen.lines[2:])
    assert rest == [first + 10, first + 10]


def test_columns_grow_for_what_comes_after_the_sample() -> None:
    screen = Screen(terminal=True)
    screen.add()
    screen.table.flush()
    for _ in range(99):
        screen.add(link="127.0.0.1:44835", latency_ns=9_999_900_000)
    last = next(line for line in screen.lines if line.startswith("100"))
    assert last.startswith("100  22:13:20.000  127.0.0.1:44835  1     03 read holding     HR4")
    assert last.endswith("  9999.9 ms")
    assert max(map(len, screen.lines)) <= 100


@pytest.mark.parametrize("width", [80, 100, 132, 200])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    screen = Screen(terminal=True, width=width)
    for link in ("rs485", "192.168.100.200"):
        screen.add(link=link, reference=LONG, response_values=list(range(1000, 1020)))
    screen.table.flush()
    assert max(map(len, screen.lines)) <= width


def test_a_terminal_too_narrow_still_has_every_column() -> None:
    screen = Screen(terminal=True, width=20)
    screen.add(link="192.168.100.200")
    screen.table.flush()
    assert screen.lines[0].split() == [
        "#", "time", "link", "unit", "funct…", "what", "result", "latency",
    ]  # fmt: skip
    assert screen.lines[2].split()[:5] == ["1", "22:13:20.000", "192.168.100.200", "1", "03"]


def test_any_row_can_be_printed() -> None:
    cells = ("1", "", "", "", "", "", "", "")
    for terminal in (True, False):
        screen = Screen(terminal=terminal)
        screen.table.add(TransactionRow(*cells, trouble=False), "")
        screen.table.flush()
        assert screen.lines[-1] == " 1"
