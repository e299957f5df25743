"""Measures how large the log of a polled serial line is, in times of its wire bytes.

    python -m tests.benchmarks.log_size

A line is polled at 19200 baud: a read of ten registers, one of whose values changes in three of ten
polls. It is written as a whole log, as a log of evidence only, and as evidence in blocks, which is
a proposal (docs/decisions/0010-evidence-in-blocks.md): one message of bytes and of the times
between reads, in 10 us, each half second or each 10 s. The line is read frame by frame, or byte by
byte, as some adapters deliver.
"""

from __future__ import annotations

import random
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.records import Header

from mbtool.core import Chunk
from mbtool.logs import LogWriter
from mbtool.logs.complete_file import CompleteFile
from mbtool.logs.container import Container
from mbtool.logs.creating import create_file
from mbtool.logs.layout import MAGIC, packed
from tests.logs.samples import START_NS, transaction

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices import NamedTransaction

CHARACTER_NS = 573_000
UNIT_NS = 10_000
TICK_NS = 100_000_000
REQUEST = bytes.fromhex("01 03 0000 000a c5cd")


def polling(
    rate: int, polls: int, *, by_byte: bool
) -> Iterator[tuple[list[Chunk], NamedTransaction]]:
    """The reads of each poll, and its transaction; `rate` is in polls a second."""
    chance = random.Random(2)
    values = [chance.randrange(65536) for _ in range(10)]
    for number in range(polls):
        begin_ns = START_NS + number * 1_000_000_000 // rate
        if chance.random() < 0.3:
            values[chance.randrange(10)] = chance.randrange(65536)
        response = b"\x01\x03\x14" + b"".join(value.to_bytes(2, "big") for value in values)
        response += chance.randbytes(2)
        reads = []
        for data, start_ns in ((REQUEST, begin_ns), (response, begin_ns + 10_000_000)):
            size = 1 if by_byte else len(data)
            for end in range(size, len(data) + 1, size):
                late_ns = chance.randrange(80_000)
                ts_ns = start_ns + end * CHARACTER_NS + late_ns
                reads.append(Chunk(ts_ns=ts_ns, link="rs485", data=data[end - size : end]))
        yield (
            reads,
            transaction(
                number,
                request_ns=begin_ns,
                response_ns=reads[-1].ts_ns,
                quantity=10,
                response_values=list(values),
                request_raw=REQUEST,
                response_raw=response,
            ),
        )


def log_size(path: Path, rate: int, polls: int, *, by_byte: bool, decoded: bool) -> float:
    """The size of a log in times of the wire bytes."""
    wire, tick_ns = 0, START_NS
    with LogWriter(path, capture={}) as log:
        for reads, named in polling(rate, polls, by_byte=by_byte):
            for read in reads:
                while read.ts_ns >= tick_ns:
                    log.tick(tick_ns)
                    tick_ns += TICK_NS
                wire += len(read.data)
                log.write(read)
            if decoded:
                log.write(named)
    return path.stat().st_size / wire


def block_size(path: Path, rate: int, polls: int, *, by_byte: bool, every_ns: int) -> float:
    """The size of evidence in blocks, in times of the wire bytes."""
    head = MAGIC + packed(Header("mbtool", "mbtool"))
    file = CompleteFile(create_file(path), str(path), head)
    container = Container(file)
    topic = container.add_topic("/rs485/evidence", "mbtool.Evidence", b"{}")
    reads = [read for some, _ in polling(rate, polls, by_byte=by_byte) for read in some]
    at = 0
    while at < len(reads):
        end_ns = reads[at].ts_ns + every_ns
        end = next((n for n in range(at, len(reads)) if reads[n].ts_ns >= end_ns), len(reads))
        begin_ns = reads[at].ts_ns
        container.add_message(topic, begin_ns, begin_ns, block(reads[at:end]))
        container.flush(sync=False)
        at = end
    container.finish()
    file.close()
    return path.stat().st_size / sum(len(read.data) for read in reads)


def block(reads: list[Chunk]) -> bytes:
    """The bytes of some reads, behind the times between them and their lengths."""
    times, last_ns = bytearray(), reads[0].ts_ns
    for read in reads:
        units = (read.ts_ns - last_ns) // UNIT_NS
        last_ns += units * UNIT_NS
        times += _varint(units) + _varint(len(read.data))
    return _varint(len(times)) + bytes(times) + b"".join(read.data for read in reads)


def _varint(number: int) -> bytes:
    found = bytearray()
    while number > 127:
        found.append(number & 127 | 128)
        number >>= 7
    return bytes([*found, number])


def sizes(rate: int, polls: int, *, by_byte: bool) -> list[float]:
    """The sizes in times of the wire bytes: whole, evidence only, blocks of 0.5 s and of 10 s."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return [
            log_size(folder / "a.mcap", rate, polls, by_byte=by_byte, decoded=True),
            log_size(folder / "b.mcap", rate, polls, by_byte=by_byte, decoded=False),
            block_size(folder / "c.mcap", rate, polls, by_byte=by_byte, every_ns=500_000_000),
            block_size(folder / "d.mcap", rate, polls, by_byte=by_byte, every_ns=10_000_000_000),
        ]


def main() -> int:
    sys.stdout.write("polls/s  read by    whole log  evidence only  blocks 0.5 s  blocks 10 s\n")
    for rate, polls in ((1, 600), (10, 3000), (40, 4000)):
        for by_byte in (False, True):
            found = "".join(f"{size:13.1f}" for size in sizes(rate, polls, by_byte=by_byte))
            sys.stdout.write(f"{rate:7}  {'byte' if by_byte else 'frame':5}{found}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
