"""How true the sniffer's times are: python -m tests.benchmarks.serial_times [OPTIONS].

    --baud 115200     of the line, 8N1
    --seconds 20      for each row
    --busy            only with every core kept busy, not also on an idle machine

A writer process sends frames of 8 to 64 bytes, and notes when it began each. The sniffer's source
hears them. Its time of a frame's start is that of the frame's first byte, as evidence has it: the
read's time, less a character time for each byte behind it, less one for the byte itself.

On `terminal` the writer paces the characters itself, one write for each, so that nothing stands
between it and the sniffer's port. On `line` it writes frames to a virtual line, which paces them;
then the line's process, too, is late where cores are busy, and the sniffer is charged for it.

The writer runs at real-time priority where it may: its notes are the truth. Absolute figures are
the machine's.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import time
import tty
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Chunk, SerialFormat, SerialLink
from mbtool.sources.child import run_promptly
from mbtool.sources.inbox import Inbox
from mbtool.sources.serial_capture import SerialSource
from mbtool.sources.virtual_line import VirtualLine

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

SEED = 115200
GAP_S = 0.004
WAYS = ("terminal", "line")
_BUSY = "while True:\n pass"
_WAIT_S = 120.0


@dataclass(frozen=True, slots=True)
class Row:
    """One run."""

    way: str
    busy: bool
    frames: int
    sent: int
    lost: int
    """Bytes that were sent and not heard, or not as they were sent."""
    errors_ns: list[int]
    """Of the frames' start times, their absolute values in ascending order."""

    def error_us(self, share: float) -> float:
        place = min(int(share * len(self.errors_ns)), len(self.errors_ns) - 1)
        return self.errors_ns[place] / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition(":")[0])
    parser.add_argument("--baud", type=int, default=115200)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("--write", nargs=2, metavar=("WAY", "DESCRIPTOR"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    line = SerialFormat(options.baud, 8, "N", 1)
    if options.write:
        way, descriptor = options.write
        write(way, int(descriptor), line, options.seconds)
        return
    rows = [
        measure(way, line, options.seconds, busy=busy)
        for way in WAYS
        for busy in ([True] if options.busy else [False, True])
    ]
    sys.stdout.write(report(rows))


def report(rows: Sequence[Row]) -> str:
    """A line for each run."""
    lines = [
        f"{'way':<10}{'cores':<6}{'frames':>8}{'bytes':>9}{'lost':>6}{'p50':>11}{'p99':>11}{'max':>11}"
    ]
    for row in rows:
        errors = "".join(f"{row.error_us(share):>8,.0f} us" for share in (0.5, 0.99, 1))
        cores = "busy" if row.busy else "idle"
        lines.append(f"{row.way:<10}{cores:<6}{row.frames:>8,}{row.sent:>9,}{row.lost:>6,}{errors}")
    return "\n".join(lines) + "\n"


def measure(way: str, line: SerialFormat, seconds: float, *, busy: bool) -> Row:
    """Let a writer send, the sniffer's source hear, and compare."""
    with ExitStack() as stack:
        if way == "line":
            ports = stack.enter_context(VirtualLine(format=line)).ports
            descriptor = os.open(ports[0], os.O_RDWR | os.O_NOCTTY)
            port = ports[1]
        else:
            descriptor, far = os.openpty()
            tty.setraw(far)
            stack.callback(os.close, far)
            port = os.ttyname(far)
        stack.callback(os.close, descriptor)
        inbox = Inbox()
        with SerialSource(SerialLink(port, line), inbox):
            if busy:
                stack.enter_context(busy_cores())
            notes = _sent(way, descriptor, line, seconds)
            heard = _heard(inbox, sum(len(frame) for _, frame in notes))
        return compare(way, notes, heard, line, busy=busy)


def compare(
    way: str,
    notes: Sequence[tuple[int, bytes]],
    heard: Sequence[Chunk],
    line: SerialFormat,
    *,
    busy: bool,
) -> Row:
    """Put the writer's notes beside what was heard."""
    times = [
        chunk.ts_ns - (len(chunk.data) - at) * line.character_ns
        for chunk in heard
        for at in range(len(chunk.data))
    ]
    data = b"".join(chunk.data for chunk in heard)
    sent = b"".join(frame for _, frame in notes)
    differing = (at for at, pair in enumerate(zip(sent, data, strict=False)) if pair[0] != pair[1])
    right = next(differing, min(len(sent), len(data)))
    errors: list[int] = []
    at = 0
    for began_ns, frame in notes:
        if at < right:
            errors.append(abs(times[at] - began_ns))
        at += len(frame)
    return Row(way, busy, len(notes), len(sent), len(sent) - right, sorted(errors) or [0])


def _sent(way: str, descriptor: int, line: SerialFormat, seconds: float) -> list[tuple[int, bytes]]:
    command = [
        sys.executable,
        "-m",
        "tests.benchmarks.serial_times",
        "--write",
        way,
        str(descriptor),
    ]
    command += ["--baud", str(line.baud), "--seconds", str(seconds)]
    answer = subprocess.run(
        command, stdout=subprocess.PIPE, check=True, pass_fds=[descriptor]
    ).stdout
    return [(began_ns, bytes.fromhex(frame)) for began_ns, frame in json.loads(answer)]


def _heard(inbox: Inbox, count: int) -> list[Chunk]:
    """What has come until there is as much as was sent, or nothing more comes."""
    chunks: list[Chunk] = []
    deadline = time.monotonic() + _WAIT_S
    while count > 0 and time.monotonic() < deadline:
        item = inbox.get(1.0)
        if isinstance(item, Chunk):
            chunks.append(item)
            count -= len(item.data)
    return chunks


@contextmanager
def busy_cores() -> Iterator[None]:
    """Keep every core busy, each with an ordinary process."""
    burners = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


def write(way: str, descriptor: int, line: SerialFormat, seconds: float) -> None:
    """The writer's process: send frames, then print when each began and what it was."""
    run_promptly()
    chance = random.Random(SEED)
    notes: list[tuple[int, str]] = []
    end_ns = time.monotonic_ns() + int(seconds * 1e9)
    while time.monotonic_ns() < end_ns:
        frame = chance.randbytes(chance.randint(8, 64))
        notes.append((send(way, descriptor, frame, line.character_ns), frame.hex()))
        rest_s = len(frame) * line.character_ns / 1e9 if way == "line" else 0
        time.sleep(rest_s + GAP_S * chance.uniform(1, 3))
    json.dump(notes, sys.stdout)


def send(way: str, descriptor: int, frame: bytes, character_ns: int) -> int:
    """Send a frame; when its first bit began."""
    began_ns = time.time_ns()
    if way == "line":
        os.write(descriptor, frame)
        return began_ns
    # A character is there when its stop bit has passed, so the first one began a character ago.
    first_ns = time.monotonic_ns()
    for number in range(len(frame)):
        # Asleep in between: a writer that spins would keep the sniffer off its core.
        time.sleep(max(first_ns + number * character_ns - time.monotonic_ns(), 0) / 1e9)
        os.write(descriptor, frame[number : number + 1])
    return began_ns - character_ns


if __name__ == "__main__":
    main()
