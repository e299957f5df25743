"""How well a slower slave is found: python -m tests.benchmarks.slower_slave [OPTIONS].

    --runs 20         of replay --as-master, against each slave
    --polls 30        of each of three requests in the recording
    --tolerance 20    in percent
    --idle            without keeping every core busy

A recording is made up: two reads and a write over Modbus/TCP, answered after 20, 30 and 40 ms, give
or take a tenth. `mbtool replay --as-slave`, a process of its own on loopback, answers with these
latencies, and then with 1.5 times these (--speed 2/3). Against each, `mbtool replay --as-master`
runs so many times. A run finds a request if it says that its latencies are longer than allowed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.cli import exit_codes
from mbtool.modbus import mbap_adu
from tests.cli.program import Program, endpoint_in
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Iterator

REQUESTS = tuple(map(bytes.fromhex, ("03 0000 0002", "03 0010 0001", "06 0020 0007")))
RESPONSES = tuple(map(bytes.fromhex, ("03 04 0001 0002", "03 02 0003", "06 0020 0007")))
LATENCIES_MS = (20, 30, 40)
SPREAD = 0.1
SPEEDS = (Fraction(1), Fraction(2, 3))
_MS = 1_000_000
_BUSY = "while True:\n pass"


@dataclass(frozen=True, slots=True)
class Outcome:
    """The runs against one slave."""

    speed: Fraction
    runs: int
    found: list[int]
    """Of each run, how many requests were found."""
    others: int
    """Differences of other kinds, over all runs."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition(":")[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--polls", type=int, default=30)
    parser.add_argument("--tolerance", type=float, default=20)
    parser.add_argument("--idle", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        path = Path(folder) / "made-up.pcap"
        path.write_bytes(recording(options.polls))
        for _ in range(0 if options.idle else os.cpu_count() or 1):
            stack.enter_context(_busy())
        for speed in SPEEDS:
            print(told(measure(path, speed, options.runs, options.tolerance)))  # noqa: T201 - output


def recording(polls: int) -> bytes:
    """A capture in which each request is asked so many times."""
    chance = random.Random(1)
    talk = Talk()
    packets = talk.handshake()
    for number in range(polls * len(REQUESTS)):
        index = number % len(REQUESTS)
        latency_ms = LATENCIES_MS[index] * chance.uniform(1 - SPREAD, 1 + SPREAD)
        talk.ts_ns = number * 50 * _MS
        packets.append(talk.request(mbap_adu(number & 0xFFFF, 1, REQUESTS[index])))
        talk.ts_ns += round((latency_ms - 1) * _MS)  # `Talk` adds 1 ms to each packet.
        packets.append(talk.response(mbap_adu(number & 0xFFFF, 1, RESPONSES[index])))
    return pcap(packets)


def measure(path: Path, speed: Fraction, runs: int, tolerance: float) -> Outcome:
    """Play a recording as the slave at a speed, and ask it so many times as the master."""
    arguments = ("--as-slave", "--on", "tcp:127.0.0.1:0", "--loop", "--speed", speed)
    with Program("replay", path, *arguments) as slave:
        endpoint = endpoint_in(slave.await_said("Ctrl-C ends"))
        reports = [_run(path, f"tcp:{endpoint}", tolerance) for _ in range(runs)]
    kinds = [[one["kind"] for one in report["differences"]] for report in reports]
    return Outcome(
        speed,
        runs,
        [each.count("latency") for each in kinds],
        sum(len(each) - each.count("latency") for each in kinds),
    )


def _run(path: Path, link: str, tolerance: float) -> dict[str, list[dict[str, str]]]:
    report = path.with_suffix(".json")
    ended = subprocess.run(
        [
            *(sys.executable, "-m", "mbtool", "replay", str(path), "--as-master", "--to", link),
            *("--speed", "max", "--latency-tolerance", str(tolerance), "--report", str(report)),
        ],
        check=False,  # It exits with 1 if it finds something.
        capture_output=True,
        text=True,
    )
    if ended.returncode not in (exit_codes.DONE, exit_codes.NO):
        raise SystemExit(ended.stderr)
    document: dict[str, list[dict[str, str]]] = json.loads(report.read_text())
    report.unlink()
    return document


@contextmanager
def _busy() -> Iterator[None]:
    child = subprocess.Popen([sys.executable, "-c", _BUSY])
    try:
        yield
    finally:
        child.kill()
        child.wait()


def told(outcome: Outcome) -> str:
    hit = sum(bool(count) for count in outcome.found)
    slower = float(1 / outcome.speed)
    return (
        f"slave {slower:g} times as slow: {hit} of {outcome.runs} runs find it, "
        f"{sum(outcome.found)} of {outcome.runs * len(REQUESTS)} requests; "
        f"{outcome.others} other differences"
    )


if __name__ == "__main__":
    main()
