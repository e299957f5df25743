"""What `watch` costs beside decoding: python -m tests.benchmarks.watch [OPTIONS].

    --rate 1000      transactions a second
    --seconds 5      of traffic
    --view 1         the view that is shown

A master polls twenty lists of ten registers over Modbus/TCP, one value of each changing. The bytes
come at the rate and are decoded: alone, then shown by the full screen on a pseudo terminal of 80x24
whose other end is read, then alone again (the mean of both counts, as other programs slow the
machine down for a while). All times are processor times of the whole process, without the start of
the screen. Absolute figures are the machine's; the ratio is what counts.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import pty
import struct
import subprocess
import sys
import tempfile
import termios
import time
from fcntl import ioctl
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, NamedTuple

from mbtool.cli.main import NEW_OBJECTS
from mbtool.cli.watching.app import WatchApp
from mbtool.core import Chunk, Connection, Direction, Endpoint
from mbtool.core.evidence import Stamp
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.modbus import mbap_adu
from mbtool.watching.watched import Watched
from mbtool.workflows.stats import ORDERED_AFTER_NS
from mbtool.workflows.watch import WatchFeed

if TYPE_CHECKING:
    from collections.abc import Sequence

POLLS, REGISTERS = 20, 10
START_NS = 1_800_000_000_000_000_000
_SLICE_S = 0.01
_SETTLED_S = 1.0
_SETTLE_SLICES = 20
_CONNECTION = Connection(Endpoint("10.0.0.1", 50000), Endpoint("10.0.0.2", 502))


class WatchCost(NamedTuple):
    """Processor times in s."""

    decoding_s: float
    watching_s: float
    shown: int
    """The number of transactions that the model had at the end."""
    drawings: int

    @property
    def ratio(self) -> float:
        return self.watching_s / self.decoding_s


def traffic(count: int, rate: int) -> list[Chunk]:
    """The requests and responses of `count` transactions, at a rate per second."""
    chunks = []
    for number in range(count):
        at_ns = START_NS + number * 1_000_000_000 // rate
        address = number % POLLS * 100
        request = struct.pack(">BHH", 3, address, REGISTERS)
        values = [number // POLLS % 65536, *range(1, REGISTERS)]
        response = struct.pack(f">BB{REGISTERS}H", 3, 2 * REGISTERS, *values)
        for direction, pdu, late_ns in (
            (Direction.REQUEST, request, 0),
            (Direction.RESPONSE, response, 300_000),
        ):
            chunks.append(
                Chunk(
                    ts_ns=at_ns + late_ns,
                    link="10.0.0.2",
                    data=mbap_adu(number % 65536, 1, pdu),
                    direction=direction,
                    stamp=Stamp.AT_ONCE,
                    connection=_CONNECTION,
                )
            )
    return chunks


class PacedFeed(WatchFeed):
    """Decodes traffic at its pace, and notes the processor time that everything took."""

    def __init__(self, chunks: Sequence[Chunk], rate: int, *, is_shown: bool = True) -> None:
        super().__init__(Watched())
        self._chunks, self._rate, self._is_shown = chunks, rate, is_shown
        self.took_s = 0.0

    def now_ns(self) -> int:
        return self.watched.whole.last_ns

    def wait(self) -> None:
        self._thread.join()

    def _run(self) -> None:
        time.sleep(_SETTLED_S)  # The screen is up.
        decoder = Decoder(Namer())
        began, at = time.process_time(), time.monotonic()
        per_slice = 2 * max(round(self._rate * _SLICE_S), 1)
        for begin in range(0, len(self._chunks), per_slice):
            for chunk in self._chunks[begin : begin + per_slice]:
                for record in decoder.feed(chunk):
                    if self._is_shown:
                        with self.lock:
                            self.watched.add(record)
            if self._is_shown and begin % (_SETTLE_SLICES * per_slice) == 0:
                self._settle(self._chunks[begin].ts_ns - ORDERED_AFTER_NS)
            at += _SLICE_S
            time.sleep(max(at - time.monotonic(), 0))
        self.took_s = time.process_time() - began


def run_screen(rate: int, seconds: float, view: int, out: str) -> None:
    """Measure in this process, whose standard streams are a terminal."""
    gc.set_threshold(NEW_OBJECTS, *gc.get_threshold()[1:])  # As the program does.
    chunks = traffic(round(rate * seconds), rate)
    before_s = _decoding_s(chunks, rate)
    feed = PacedFeed(chunks, rate)
    app = WatchApp(feed, "10.0.0.2", is_asked_to_end=lambda: feed.is_over)
    app.view_at = view - 1
    app.run()
    feed.stop()
    if feed.error is not None:
        raise feed.error
    decoding_s = (before_s + _decoding_s(chunks, rate)) / 2
    cost = WatchCost(decoding_s, feed.took_s, feed.watched.whole.account.transactions, app.drawings)
    Path(out).write_text(json.dumps(cost))


def _decoding_s(chunks: Sequence[Chunk], rate: int) -> float:
    alone = PacedFeed(chunks, rate, is_shown=False)
    alone.start()
    alone.wait()
    return alone.took_s


def measure(rate: int, seconds: float, view: int = 1) -> WatchCost:
    """Run the screen in a process of its own, on a terminal of 80x24."""
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "cost.json")
        command = [sys.executable, "-m", "tests.benchmarks.watch", "--out", out]
        command += ["--rate", str(rate), "--seconds", str(seconds), "--view", str(view)]
        environment = {**os.environ, "TERM": "xterm-256color", "XDG_CONFIG_HOME": folder}
        process = subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment
        )
        os.close(theirs)
        Thread(target=_read_all, args=(ours,), daemon=True).start()
        process.wait()
        return WatchCost(*json.loads(Path(out).read_text()))


def _read_all(descriptor: int) -> None:
    try:
        while os.read(descriptor, 65536):
            pass
    except OSError:  # The other end is closed.
        os.close(descriptor)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rate", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--view", type=int, default=1)
    parser.add_argument("--out", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.out is not None:
        run_screen(given.rate, given.seconds, given.view, given.out)
        return
    cost = measure(given.rate, given.seconds, given.view)
    sys.stdout.write(
        f"{cost.shown} transactions shown in {cost.drawings} drawings; "
        f"decoding {cost.decoding_s:.2f} s, "
        f"watching {cost.watching_s:.2f} s: {cost.ratio:.2f} times\n"
    )


if __name__ == "__main__":
    main()
