"""Measures how large the log of a polled serial line is, in times of its wire bytes.

    python -m tests.benchmarks.log_size               # at some rates, a minute
    python -m tests.benchmarks.log_size --days 7      # 10 polls a second for a week; some hours

A line is polled at 19200 baud: a read of ten registers, one of whose values changes in three of ten
polls. The line is read frame by frame, by 8 bytes as many drivers deliver, or byte by byte, with
the times that a serial source gives. It is logged as `sniff` logs it: evidence only, and evidence
with what was decoded. The clock is simulated.

With --days the line is read byte by byte, and the log of evidence is decoded. Beside the sizes, the
memory of the program is told after a tenth of the decoding and at its end.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Chunk, SerialLink, parse_link
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, Namer
from mbtool.logs import LogWriter
from mbtool.modbus.adu import crc
from mbtool.sources.serial_capture import STEP_NS
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.logs.samples import START_NS

if TYPE_CHECKING:
    from collections.abc import Iterator

CHARACTER_NS = 573_000
TICK_NS = 100_000_000
SPEC = "rtu:rs485@19200-8E1"
RATES = (0.2, 1, 5, 10, 20)
READ_BY = {"frame": 64, "8 bytes": 8, "byte": 1}


class LogSize(NamedTuple):
    """A log that was made, and what its line carried."""

    size: int
    wire: int
    polls: int

    @property
    def ratio(self) -> float:
        """The bytes of the log for each byte on the wire."""
        return self.size / self.wire


def polling(rate: float, polls: int, size: int) -> Iterator[Chunk]:
    """The reads of a line, `size` bytes each; `rate` is in polls a second."""
    chance = random.Random(2)
    request = bytes.fromhex("01 03 0000 000a")
    request += crc(request).to_bytes(2, "little")
    values = [chance.randrange(65536) for _ in range(10)]
    for number in range(polls):
        begin_ns = START_NS + int(number * 1e9 / rate)
        if chance.random() < 0.3:
            values[chance.randrange(10)] = chance.randrange(65536)
        response = b"\x01\x03\x14" + b"".join(value.to_bytes(2, "big") for value in values)
        response += crc(response).to_bytes(2, "little")
        answered_ns = begin_ns + len(request) * CHARACTER_NS + 5_000_000
        for data, start_ns in ((request, begin_ns), (response, answered_ns)):
            for at in range(0, len(data), size):
                piece = data[at : at + size]
                ts_ns = start_ns + (at + len(piece)) * CHARACTER_NS + int(chance.random() * 80_000)
                yield Chunk(ts_ns=ts_ns // STEP_NS * STEP_NS, link="rs485", data=piece)


def write_line(path: Path, rate: float, polls: int, size: int, *, decoded: bool) -> LogSize:
    """Log a line as `sniff` does, with or without what is decoded."""
    link = parse_link(SPEC)
    assert isinstance(link, SerialLink)
    decoder = Decoder(Namer(Assignments()), lines={"rs485": link})
    wire, tick_ns = 0, START_NS
    with LogWriter(path, capture={} if decoded else {"evidence_only": "true"}) as log:
        log.add_link("rs485", {"spec": SPEC})
        for read in polling(rate, polls, size):
            while read.ts_ns >= tick_ns:
                log.tick(tick_ns)
                tick_ns += TICK_NS
            wire += len(read.data)
            log.write(read)
            for record in decoder.feed(read) if decoded else ():
                log.write(record)
        for record in decoder.close():
            log.write(record)
    return LogSize(path.stat().st_size, wire, polls)


def resident_kb() -> int:
    """The memory of this process in KiB, as Linux tells it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))


def decoding_memory(path: Path, polls: int) -> tuple[int, int, int]:
    """Decode a log; return the transactions, and the memory after a tenth and at the end (KiB)."""
    count = early = late = 0
    for _ in Reading([str(path)], ReadingOptions(raw=True)).records():
        count += 1
        if count == polls // 10:
            early = resident_kb()
        if count % 5000 == 0:
            late = max(late, resident_kb())
    return count, early, late


def rates() -> None:
    """Write a table of the sizes at some rates, in the form of the page about the log."""
    heads = (
        "| polls/s | wire bytes/s |" + "".join(f" by {name} |" for name in READ_BY) + " whole |\n"
    )
    sys.stdout.write(heads + "|---" * (3 + len(READ_BY)) + "|\n")
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "x.mcap"
        for rate in RATES:
            polls = max(int(120 * rate), 200)
            found = []
            for size in READ_BY.values():
                found.append(write_line(path, rate, polls, size, decoded=False))
                path.unlink()
            whole = write_line(path, rate, polls, READ_BY["8 bytes"], decoded=True)
            path.unlink()
            cells = "".join(f" {one.ratio:.1f} |" for one in [*found, whole])
            sys.stdout.write(f"| {rate} | {whole.wire / polls * rate:.0f} |{cells}\n")
            sys.stdout.flush()


def days(count: float, folder: Path) -> bool:
    """Log a line for so many days and decode it; True if the log of evidence is small enough."""
    polls = int(count * 86_400 * 10)
    path = folder / "evidence.mcap"
    only = write_line(path, 10, polls, 1, decoded=False)
    sys.stdout.write(
        f"{polls:,} polls, {only.wire:,} bytes on the wire; "
        f"evidence only: {only.size:,} bytes, {only.ratio:.2f} times\n"
    )
    sys.stdout.flush()
    transactions, early, late = decoding_memory(path, polls)
    sys.stdout.write(
        f"decoded: {transactions:,} transactions; memory after a tenth {early:,} KiB, "
        f"at most {late:,} KiB\n"
    )
    sys.stdout.flush()
    whole = write_line(folder / "whole.mcap", 10, polls, 1, decoded=True)
    sys.stdout.write(f"whole log: {whole.size:,} bytes, {whole.ratio:.2f} times\n")
    return only.ratio <= 3 and transactions == polls


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--days", type=float, help="log so many days, and decode them")
    options = parser.parse_args(arguments)
    if options.days is None:
        rates()
        return 0
    with tempfile.TemporaryDirectory() as name:
        return 0 if days(options.days, Path(name)) else 1


if __name__ == "__main__":
    sys.exit(main())
