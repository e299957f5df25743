"""Measures `--between` beside another master: python -m tests.end_to_end.between [--help].

In each run pymodbus asks a slave of libmodbus again and again on a virtual line, and mbtool asks
the same slave in the pauses. On a second line pymodbus and libmodbus do the same without mbtool:
it shows what fails because the machine is busy. pymodbus counts itself how many of its requests
failed. For each of them this program says how long before its end mbtool last sent a request. Exit
code 1 if more requests of pymodbus failed beside mbtool than without it, or if an answer of ours is
not right.
"""

# The masters and the slaves are processes of their own. A request whose bytes collide with others
# is never answered, so the time-out of pymodbus decides nothing about collisions. It is long, as
# are its pauses, because a process may get no processor for half a second: a slave's late answer
# to mbtool would then meet the next request of pymodbus.

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

import mbtool as api
from tests.end_to_end.peers import libmodbus_server
from tests.end_to_end.programs import MBTOOL, Program
from tests.end_to_end.slaves_of_others import BAUD

if TYPE_CHECKING:
    from collections.abc import Iterator

FIRST, LAST = 10, 13
"""The registers that mbtool reads; those of the slave have 100 times their address."""
RIGHT = [100 * at for at in range(FIRST, LAST + 1)]
_THIS = (sys.executable, "-m", "tests.end_to_end.between")
TIMEOUT_S = 2.0
"""The time-out of pymodbus."""


class Failure(NamedTuple):
    """A request of pymodbus that failed; times in ns (UTC)."""

    begin_ns: int
    end_ns: int
    why: str


class Master(NamedTuple):
    """What pymodbus says of its own requests."""

    asked: int
    failures: list[Failure]


class Run(NamedTuple):
    beside: Master
    """The master on the line on which mbtool asks, too."""
    alone: Master
    """The one on the other line."""
    ours: list[dict[str, Any]]

    @property
    def right(self) -> int:
        return sum(one.get("response_values") == RIGHT for one in self.ours)

    @property
    def wrong(self) -> int:
        """How many answers of ours are not those of the slave."""
        return sum(1 for one in self.ours if one["outcome"] != "no-answer") - self.right

    def since_ours(self, failure: Failure) -> float | None:
        """The time in s from the last request of ours to the end of a failed one of pymodbus."""
        before = [at for one in self.ours if (at := one["request_ns"]) <= failure.end_ns]
        return (failure.end_ns - before[-1]) / 1e9 if before else None


def poll_for_ever(port: str, pause_s: float) -> None:
    """Ask as pymodbus until standard input ends; print a row of JSON at each failure, and a sum."""
    client = ModbusSerialClient(port, baudrate=BAUD, timeout=TIMEOUT_S, retries=0)
    assert client.connect()
    asked = 0
    failures: list[Failure] = []
    with ThreadPoolExecutor(1) as pool:
        end = pool.submit(sys.stdin.read)
        while not end.done():
            for address, count in ((0, 4), (20, 2)):
                begin_ns = time.time_ns()
                asked += 1
                why = ""
                try:
                    answer = client.read_holding_registers(address, count=count, device_id=1)
                    values = [100 * at for at in range(address, address + count)]
                    if answer.isError() or answer.registers != values:
                        why = str(answer)
                except ModbusException as error:
                    why = str(error)
                if why:
                    failures.append(Failure(begin_ns, time.time_ns(), why))
            time.sleep(pause_s)
    sys.stdout.write(json.dumps([asked, failures]))


@contextmanager
def polled_line(folder: Path, pause_s: float) -> Iterator[tuple[str, list[Master]]]:
    """A free port on a line that pymodbus polls, and at the end what pymodbus says."""
    told: list[Master] = []
    with ExitStack() as stack:
        line = stack.enter_context(api.line(f"rtu@{BAUD}-8N1", ends=3))
        stack.enter_context(libmodbus_server(folder, line.ports[1]))
        master = subprocess.Popen(
            [*_THIS, "--poll", line.ports[0], "--pause", str(pause_s)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        try:
            yield line.link(2), told
        finally:
            asked, failures = json.loads(master.communicate("")[0])
            told.append(Master(asked, [Failure(*one) for one in failures]))


def run(folder: Path, requests: int, timeout_s: float, pause_s: float) -> Run:
    folder.mkdir()
    words = ["--between", "--listen", "30s", "--timeout", str(timeout_s), "--count", str(requests)]
    words += ["--every", "10ms", "--all", "--json"]
    with polled_line(folder, pause_s) as (link, beside), polled_line(folder, pause_s) as (_, alone):  # noqa: SIM117
        with Program(MBTOOL, "poll", link, f"holding {FIRST}..{LAST}", *words) as ours:
            code = ours.wait(24 * 3600)
            rows = [json.loads(row) for row in ours.printed.text.splitlines()]
    if code == 3:
        _say(ours.said.text)
    return Run(beside[0], alone[0], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--requests", type=int, default=1000, help="of mbtool in each run")
    parser.add_argument("--timeout", type=float, default=0.5, help="of mbtool, in seconds")
    parser.add_argument("--pause", type=float, default=1.0, help="of pymodbus, in seconds")
    parser.add_argument("--at-once", type=int, default=1, help="runs at the same time")
    parser.add_argument("--poll", metavar="PORT", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.poll:
        poll_for_ever(given.poll, given.pause)
        return
    runs = []
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(given.at_once) as pool:
        folders = [Path(name) / str(number) for number in range(given.runs)]
        for one in pool.map(
            lambda folder: run(folder, given.requests, given.timeout, given.pause), folders
        ):
            runs.append(one)
            _tell(len(runs), one)
    wrong = sum(one.wrong for one in runs)
    beside = sum(len(one.beside.failures) for one in runs)
    alone = sum(len(one.alone.failures) for one in runs)
    _say(
        f"{len(runs)} runs: {sum(one.right for one in runs):,} of "
        f"{sum(len(one.ours) for one in runs):,} requests of ours right, {wrong} wrong; of "
        f"{sum(one.beside.asked for one in runs):,} of pymodbus {beside} failed; of "
        f"{sum(one.alone.asked for one in runs):,} on the line without mbtool {alone} failed"
    )
    sys.exit(bool(wrong) or beside > alone)


def _tell(number: int, one: Run) -> None:
    _say(
        f"{number}: {one.right} of {len(one.ours)} of ours right, {one.wrong} wrong; "
        f"{len(one.beside.failures)} of {one.beside.asked} of pymodbus failed, without mbtool "
        f"{len(one.alone.failures)} of {one.alone.asked}"
    )
    for row in one.ours:
        if row["outcome"] != "no-answer" and row.get("response_values") != RIGHT:
            _say(f"   wrong answer to ours: {row.get('response_raw')}")
    for failure in one.beside.failures:
        since_s = one.since_ours(failure)
        ours = "none of ours before" if since_s is None else f"ours {since_s:.2f} s before its end"
        took_s = (failure.end_ns - failure.begin_ns) / 1e9
        _say(f"   failed after {took_s:.2f} s, {ours}: {failure.why[:200]}")


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
