"""mbtool beside pymodbus on one line: it sends nothing unasked, and disturbs nobody in pauses.

How many requests failed is what pymodbus counts itself.
"""

from __future__ import annotations

import json
from contextlib import ExitStack
from threading import Thread
from typing import TYPE_CHECKING

import pytest

import mbtool as api
from tests.end_to_end.programs import mbtool
from tests.end_to_end.test_troubles_of_real_masters import RawSlave, poll

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.api.serial_bench import SerialBench

UNITS = {1: 0.005, 2: 0.01, 5: 0.008}


class Polled:
    """A line with slaves, on which pymodbus polls units 1 and 2 as long as the context is open."""

    def __init__(self, line: SerialBench, slave: RawSlave) -> None:
        self.link = line.link(2)
        self.slave = slave
        self.failed = 0
        self.asked = 0
        self._ends = False
        self._thread = Thread(target=self._poll, args=(line.ports[0],))

    def __enter__(self) -> Polled:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends = True
        self._thread.join()

    def _poll(self, port: str) -> None:
        while not self._ends:
            self.failed += poll(port, [1, 2], 1, timeout=0.5, pause=0.4)
            self.asked += 2


@pytest.fixture
def polled() -> Iterator[Polled]:
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=3))
        slave = stack.enter_context(RawSlave(line.ports[1], UNITS))
        yield stack.enter_context(Polled(line, slave))


@pytest.mark.parametrize(
    "command",
    [
        ("read", "{}", "holding 0..3", "--unit", "5"),
        ("write", "{}", "holding 0=1", "--unit", "5", "--yes"),
        ("poll", "{}", "holding 0..3", "--unit", "5"),
        ("replay", "captures/ft1a-touch-line.mcap", "--as-master", "--to", "{}"),
    ],
    ids=lambda words: words[0],
)
def test_nothing_is_sent_where_another_master_asks(
    polled: Polled, command: tuple[str, ...]
) -> None:
    with mbtool(*(word.format(polled.link) for word in command)) as program:
        assert program.wait() == 3
        assert program.said.text.count("\n") == 1 + program.said.text.count("requests to unit")
    assert "another master asks on this line: unit " in program.said.text
    assert "unit 1 03 holding 1..4 every" in program.said.text
    assert "unit 2 03 holding 2..5 every" in program.said.text
    assert 5 not in polled.slave.asked_units


@pytest.mark.parametrize(("every", "count"), [("50ms", 10), ("1500ms", 3)])
def test_requests_between_the_polls_of_another_master_disturb_none_of_them(
    polled: Polled, every: str, count: int
) -> None:
    words = ("--unit", "5", "--between", "--timeout", "0.1", "--count", str(count), "--all")
    for _ in range(5):  # On a busy machine an answer may be late, and a poll longer than it was.
        failed, asked = polled.failed, polled.asked
        with mbtool(
            "poll", polled.link, "holding 0..3", *words, "--every", every, "--format", "jsonl"
        ) as program:
            program.wait()
            rows = [json.loads(line) for line in program.printed.text.splitlines()]
        outcomes = [row["outcome"] for row in rows]
        if outcomes == ["ok"] * count and polled.failed == failed:
            break
    assert outcomes.count("ok") >= 0.8 * count, program.said.text
    assert polled.asked - asked > count
    assert polled.failed <= failed + 1


def test_a_pause_that_is_too_short_is_told(polled: Polled) -> None:
    words = ("--unit", "5", "--between", "--timeout", "2")
    with mbtool("read", polled.link, "holding 0..3", *words) as program:
        assert program.wait() == 3
    assert "needs a pause of 2.0" in program.said.text
    assert "A shorter --timeout needs less" in program.said.text


def test_both_masters_of_a_line_are_told_apart_in_the_log(polled: Polled, tmp_path: Path) -> None:
    log = tmp_path / "line.mcap"
    words = ("--unit", "5", "--between", "--timeout", "0.1", "--count", "5", "--every", "50ms")
    with mbtool("poll", polled.link, "holding 0..3", *words, "-w", str(log)) as program:
        program.wait()
    name = polled.link.rpartition("/")[2].partition("@")[0]
    units: dict[str, set[int]] = {}
    for one in api.open(log):
        units.setdefault(one.link, set()).add(one.unit)
    assert units == {name: {1, 2}, f"{name}-own": {5}}, program.said.text
    ours = [one for one in api.open(log) if one.link == f"{name}-own"]
    assert 5 <= len(ours) <= 6  # A request that met another one may be there, too.


def test_only_a_serial_line_is_logged(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    with (
        mbtool("slave", "fa3-at1m8x", "--on", "tcp:127.0.0.1:0") as slave,
        mbtool(
            "read", slave.said.find(r"on (\S+); Ctrl-C ends")[1], "holding 0", "-w", str(log)
        ) as program,
    ):
        assert program.wait() == 2
    assert "logs a serial line; on TCP, ask through a tap" in program.said.text
    assert not log.exists()
