"""Measures how fast logs are read, beside the stock reader of the `mcap` package.

    python -m tests.benchmarks.read_log                 # 500,000 transactions with their evidence
    python -m tests.benchmarks.read_log --transactions 50000 --rounds 5

A log of polling over TCP is made: two chunks of evidence and a transaction for each poll. In each
round each reader reads it once, in turn. Printed is the least processor time of each, with ratios
to the stock reader. The stock reader gives JSON bytes, mbtool the decoded objects.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from mcap.reader import make_reader

from mbtool.core import Chunk, Connection, Direction, Endpoint, Stamp
from mbtool.devices import NamedTransaction
from mbtool.logs import LogReader, LogWriter
from mbtool.modbus import Transport
from tests.logs.samples import START_NS, transaction

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.logs import LogItem

_MASTER, _SLAVE = Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 502)
_CONNECTION = Connection(_MASTER, _SLAVE)
_TOPIC = "/10.0.0.9/transactions"


def write_polling(path: Path, count: int) -> None:
    """A log of `count` reads of ten registers with values by chance, a millisecond apart."""
    with LogWriter(path, capture={}) as log:
        for item in polling(count):
            log.write(item)


def polling(count: int) -> Iterator[LogItem]:
    chance = random.Random(1)
    for number in range(count):
        values = [chance.randrange(65536) for _ in range(10)]
        number_bytes = (number & 0xFFFF).to_bytes(2, "big")
        request = number_bytes + bytes.fromhex("0000 0006 01 03 006b 000a")
        data = b"".join(value.to_bytes(2, "big") for value in values)
        response = number_bytes + bytes.fromhex("0000 0017 01 03 14") + data
        ts_ns = START_NS + number * 1_000_000
        yield _chunk(ts_ns, request, Direction.REQUEST)
        yield _chunk(ts_ns + 500_000, response, Direction.RESPONSE)
        yield transaction(
            number,
            link="10.0.0.9",
            transport=Transport.TCP,
            source=str(_MASTER),
            destination=str(_SLAVE),
            transaction_id=number & 0xFFFF,
            address=107,
            quantity=10,
            response_values=values,
            request_raw=request,
            response_raw=response,
        )


def _chunk(ts_ns: int, data: bytes, direction: Direction) -> Chunk:
    return Chunk(
        ts_ns=ts_ns,
        link="10.0.0.9",
        data=data,
        direction=direction,
        stamp=Stamp.AT_ONCE,
        connection=_CONNECTION,
    )


def readers(path: Path) -> dict[str, Callable[[], int]]:
    """The ways to read a log; each returns how many messages or items it has read."""
    decode = msgspec.json.Decoder(NamedTransaction).decode

    def stock(*, topics: str | None = None, decoded: bool = False) -> int:
        with path.open("rb") as stream:
            count = 0
            for _, _, message in make_reader(stream).iter_messages(topics=topics):
                count += 1
                if decoded:
                    decode(message.data)
            return count

    def batches() -> int:
        with LogReader.open(path) as log:
            return sum(map(len, log.transaction_batches()))

    def transactions() -> int:
        with LogReader.open(path) as log:
            return sum(1 for _ in log.transactions())

    def evidence() -> int:
        with LogReader.open(path) as log:
            return sum(1 for _ in log.evidence())

    def items() -> int:
        with LogReader.open(path) as log:
            return sum(1 for _ in log.items())

    return {
        "stock reader, all messages": stock,
        "stock reader, transactions": lambda: stock(topics=_TOPIC),
        "stock reader, transactions, and msgspec": lambda: stock(topics=_TOPIC, decoded=True),
        "mbtool, transactions in lists": batches,
        "mbtool, transactions": transactions,
        "mbtool, evidence": evidence,
        "mbtool, all items": items,
    }


def measured(path: Path, rounds: int) -> dict[str, tuple[int, float]]:
    """For each reader how many items it reads, and its least processor time (s)."""
    best: dict[str, tuple[int, float]] = {}
    for _ in range(rounds):
        for name, read in readers(path).items():
            begun = time.process_time()
            count = read()
            spent = time.process_time() - begun
            best[name] = min(best.get(name, (count, spent)), (count, spent))
    return best


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--transactions", type=int, default=500_000)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "polling.mcap"
        begun = time.process_time()
        write_polling(path, options.transactions)
        spent = time.process_time() - begun
        sys.stdout.write(
            f"{path.stat().st_size:,} bytes, written in {spent:.2f} s of processor time\n"
        )
        best = measured(path, options.rounds)
    whole, chosen, decoded, *_ = (seconds for _, seconds in best.values())
    sys.stdout.write(
        "times as fast as the stock reader: all messages, transactions, with msgspec\n"
    )
    for name, (count, seconds) in best.items():
        ratios = "  ".join(f"{one / seconds:5.2f}" for one in (whole, chosen, decoded))
        sys.stdout.write(f"{name:42} {count:9,} in {seconds:6.2f} s   {ratios}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
