"""How true a player's times are: python -m tests.benchmarks.replay [OPTIONS].

    --rate 1000       requests a second in the recording that is played
    --seconds 10      of it, for each row
    --busy            with every core kept busy, too

A recording is made up: reads of ten registers over Modbus/TCP, evenly spaced. It is played

    as-master   to `mbtool replay --as-slave --latency none`, a process of its own, on loopback
    as-bus      as frames to a pseudo-terminal that a process of its own reads: no line carries a
                thousand frames a second with their silences, so the line is said to be 4000000 baud

What counts is how much later than its recorded time a request, or a frame, leaves the player.
`asked` is what the recording wants, `sent` what left. Absolute figures are the machine's.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import tty
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat, SerialLink, Silence, TcpLink
from mbtool.modbus import mbap_adu
from mbtool.sources.child import run_promptly
from mbtool.workflows.replay_bus import BusOptions, BusRun
from mbtool.workflows.replay_master import MasterOptions, MasterRun
from mbtool.workflows.shared.reading import ReadingOptions
from tests.cli.program import Program, endpoint_in
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

READ = bytes.fromhex("03 0000 000A")
VALUES = bytes.fromhex("03 14") + bytes(range(20))
WAYS = ("as-master", "as-bus")
_LINE = SerialFormat(4_000_000, 8, "N", 1).with_silences(Silence.parse("1us"), Silence.parse("1us"))
_BUSY = "while True:\n pass"


@dataclass(frozen=True, slots=True)
class Row:
    """One run."""

    way: str
    busy: bool
    asked: int
    sent: int
    late_p99_us: float


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition(":")[0])
    parser.add_argument("--rate", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--busy", action="store_true")
    options = parser.parse_args()
    run_promptly()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made-up.pcap"
        requests = round(options.rate * options.seconds)
        path.write_bytes(recording(requests, options.rate))
        rows = [
            measure(way, path, requests, busy=busy)
            for busy in ((False, True) if options.busy else (False,))
            for way in WAYS
        ]
    print(report(rows))  # noqa: T201 - this is its output


def recording(requests: int, rate: int) -> bytes:
    """So many requests, evenly spaced, each answered at once."""
    every_ns = 1_000_000_000 // rate
    talk = Talk()
    packets = talk.handshake()
    for number in range(requests):
        for build, pdu, after_ns in (
            (talk.request, READ, 0),
            (talk.response, VALUES, every_ns // 10),
        ):
            talk.ts_ns = number * every_ns + after_ns  # And each packet comes a little later.
            packets.append(build(mbap_adu(number & 0xFFFF, 1, pdu)))
    return pcap(packets)


def measure(way: str, path: Path, requests: int, *, busy: bool) -> Row:
    with ExitStack() as stack:
        if busy:
            for _ in range(os.cpu_count() or 1):
                stack.enter_context(_process([sys.executable, "-c", _BUSY]))
        if way == "as-master":
            return _as_master(path, requests, busy=busy)
        return _as_bus(path, 2 * requests, busy=busy)


def _as_master(path: Path, asked: int, *, busy: bool) -> Row:
    arguments = ("--as-slave", "--on", "tcp:127.0.0.1:0", "--latency", "none")
    with Program("replay", path, *arguments) as program:
        endpoint = endpoint_in(program.await_said("Ctrl-C ends"))
        run = MasterRun(str(path), MasterOptions(reading=ReadingOptions()))
        played = run.play(TcpLink(endpoint))
    return Row("as-master", busy, asked, played.requests, (played.lateness_p99_ns or 0) / 1e3)


def _as_bus(path: Path, asked: int, *, busy: bool) -> Row:
    near, far = os.openpty()
    tty.setraw(far)
    try:
        link = SerialLink(os.ttyname(far), _LINE)
        with _process(["cat"], stdin=near):
            played = BusRun(str(path), BusOptions(), link).play()
    finally:
        os.close(near)
        os.close(far)
    return Row("as-bus", busy, asked, played.pieces, (played.lateness_p99_ns or 0) / 1e3)


@contextmanager
def _process(command: Sequence[str], stdin: int = subprocess.DEVNULL) -> Iterator[None]:
    child = subprocess.Popen(command, stdin=stdin, stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        child.kill()
        child.wait()


def report(rows: Sequence[Row]) -> str:
    lines = [f"{'way':<10} {'machine':<8} {'asked':>7} {'sent':>7} {'late p99 us':>12}"]
    lines += [
        f"{row.way:<10} {'busy' if row.busy else 'idle':<8} {row.asked:>7} {row.sent:>7} "
        f"{row.late_p99_us:>12.0f}"
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
