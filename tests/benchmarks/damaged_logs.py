"""Counts what mbtool and the stock reader still read of logs that were cut off or damaged.

    python -m tests.benchmarks.damaged_logs                 # every cut, a flip in each 97th byte
    python -m tests.benchmarks.damaged_logs --step 7 --cut-step 50

Four logs are made: of a serial line, of a tap with named points, of packets, and of a recorder that
was killed. Each is cut off at every byte, and each bit of every 97th byte is changed. Of each
result three readers read what they can: the stock reader (with validation of CRCs, by seeking and
in order), mbtool's LogReader, and `mbtool recover`. Counted are the results of which

- mbtool reads all messages that the stock reader reads,
- mbtool reads every whole message: each one of a chunk whose packed data are not changed,
- something else than the errors that a log may have was raised.

A message that was never in the log counts as an error, too.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mcap.reader import NonSeekingReader, SeekingReader

from mbtool.core import EventKind, InputError, WireEvent
from mbtool.logs import LogReader, LogWriter
from mbtool.logs.chunks import ZSTD_DATA_AT
from mbtool.logs.evidence_blocks import unpack_reads
from mbtool.logs.layout import RECORD_HEAD, Opcode
from mbtool.logs.recovery import Recovery
from tests.logs.samples import EVENT, NAMED, PACKET, SEGMENT, chunk, records_of, transaction

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mbtool.logs import LogItem

STEP = 97


class StockMessage(NamedTuple):
    """A message as the stock reader gives it."""

    topic: str
    log_ns: int
    data: bytes


@dataclass(slots=True)
class Survey:
    """What was counted of one log, for cuts or for flips."""

    tried: int = 0
    behind_stock: list[str] = field(default_factory=list)
    """The changes of which the stock reader reads a message that mbtool does not."""
    not_whole: list[str] = field(default_factory=list)
    """The changes of which mbtool does not read every whole message."""
    wrong: list[str] = field(default_factory=list)
    """The changes of which mbtool raises something else than InputError, or reads a message that
    was never in the log."""
    slowest_s: float = 0.0


def logs(folder: Path) -> dict[str, bytes]:
    """Four logs, as files."""
    makers = {
        "serial": _serial, "tap": _tap, "packets": _packets, "killed": _killed
    }  # fmt: skip
    return {name: make(folder / f"{name}.mcap") for name, make in makers.items()}


def survey(data: bytes, changes: Iterator[tuple[str, bytes, set[int]]], folder: Path) -> Survey:
    """Read each change of a log with all readers.

    A change is its name, the bytes, and the numbers of the chunks that are not whole.
    """
    known = Counter(stock_messages(data))
    items = Counter(map(repr, read_items(data)))
    by_chunk = _messages_by_chunk(data)
    result = Survey()
    for name, changed, broken in changes:
        result.tried += 1
        begun = time.perf_counter()
        try:
            found = Counter(recovered(changed, folder))
            given = Counter(map(repr, read_items(changed)))
        except Exception as error:
            result.wrong.append(f"{name}: {error!r}")
            continue
        finally:
            result.slowest_s = max(result.slowest_s, time.perf_counter() - begun)
        stock = Counter(stock_messages(changed)) & known
        if found - known or given - items:
            result.wrong.append(f"{name}: a message that was never in the log")
        if stock - found or _items_of(stock) > sum(given.values()):
            result.behind_stock.append(name)
        whole = Counter(
            one for number, some in enumerate(by_chunk) if number not in broken for one in some
        )
        if whole - found or _items_of(whole) > sum(given.values()):
            result.not_whole.append(name)
    return result


def cuts(data: bytes, step: int = 1) -> Iterator[tuple[str, bytes, set[int]]]:
    """The log cut off at every `step`th byte. Chunks that are not all there are not whole."""
    ends = [offset + RECORD_HEAD.size + size for offset, size in records_of(data, Opcode.CHUNK)]
    for size in range(0, len(data), step):
        broken = {number for number, end in enumerate(ends) if end > size}
        yield f"cut at {size}", data[:size], broken


def flips(data: bytes, step: int = STEP) -> Iterator[tuple[str, bytes, set[int]]]:
    """The log with each bit of every `step`th byte changed."""
    chunks = records_of(data, Opcode.CHUNK)
    data_at = RECORD_HEAD.size + ZSTD_DATA_AT
    for at in range(0, len(data), step):
        broken = {
            number
            for number, (offset, size) in enumerate(chunks)
            if offset + data_at <= at < offset + RECORD_HEAD.size + size
        }
        for bit in range(8):
            changed = data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]
            yield f"bit {bit} of byte {at}", changed, broken


def stock_messages(data: bytes) -> list[StockMessage]:
    """The messages that the stock reader gives before it fails: the longer of two ways to read."""

    def by(read: Callable[[], Iterator[StockMessage]]) -> list[StockMessage]:
        found = []
        with suppress(Exception):
            for message in read():
                found.append(message)
        return found

    def seeking() -> Iterator[StockMessage]:
        reader = SeekingReader(io.BytesIO(data), validate_crcs=True, record_size_limit=1 << 26)
        if reader.get_summary() is None:
            return  # It would read in order without validating CRCs, and give damaged messages.
        for _, channel, message in reader.iter_messages(log_time_order=False):
            yield StockMessage(channel.topic, message.log_time, message.data)

    def in_order() -> Iterator[StockMessage]:
        reader = NonSeekingReader(io.BytesIO(data), validate_crcs=True, record_size_limit=1 << 26)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            yield StockMessage(channel.topic, message.log_time, message.data)

    return max(by(seeking), by(in_order), key=len)


def read_items(data: bytes) -> list[LogItem]:
    """What LogReader gives, without the GAP events of damage."""
    found: list[LogItem] = []
    with suppress(InputError):
        for item in LogReader(io.BytesIO(data), "x.mcap").items():
            if not (isinstance(item, WireEvent) and item.kind is EventKind.GAP and not item.link):
                found.append(item)
    return found


def recovered(data: bytes, folder: Path) -> list[StockMessage]:
    """What `mbtool recover` gives, read by the stock reader, without the GAP events of damage."""
    good = folder / "good.mcap"
    good.unlink(missing_ok=True)
    try:
        Recovery(io.BytesIO(data), "x.mcap", lambda _: None).run(good)
    except InputError:
        return []
    with good.open("rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        return [
            StockMessage(channel.topic, message.log_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
            if channel.topic != "/events"
        ]


def _messages_by_chunk(data: bytes) -> list[list[StockMessage]]:
    """The messages of each chunk of a whole log."""
    found: list[list[StockMessage]] = []
    ends = [offset for offset, _ in records_of(data, Opcode.CHUNK)][1:]
    before = 0
    for end in [*ends, len(data)]:
        messages = stock_messages(data[:end])
        found.append(messages[before:])
        before = len(messages)
    return found


def _items_of(messages: Counter[StockMessage]) -> int:
    """How many items the messages hold; points and findings are none."""
    return sum(
        count * (len(unpack_reads(message.data)) if message.topic.endswith("/evidence") else 1)
        for message, count in messages.items()
        if message.topic not in ("/points", "/findings")
    )


def _serial(path: Path) -> bytes:
    with LogWriter(path, capture={"host": "bench"}) as log:
        log.add_link("rs485", {"spec": "rtu:/dev/ttyUSB0@19200-8E1"})
        for number in range(60):
            log.write(chunk(number))
            log.write(transaction(number, response_values=[number, number * 7 % 65536]))
            if number % 10 == 9:
                log.tick((number + 1) * 10**9)
    return path.read_bytes()


def _tap(path: Path) -> bytes:
    with LogWriter(path, capture={"host": "bench"}) as log:
        log.add_link("10.0.0.9", {"spec": "tap:127.0.0.1:1502=10.0.0.9:502"})
        log.add_device("10.0.0.9", "idec-ft1a-touch")
        log.add_profile("idec-ft1a-touch", b'{"name": "idec-ft1a-touch"}')
        for number in range(30):
            log.write(SEGMENT)
            log.write(NAMED)
            log.write(transaction(number, response_values=[number, number * 31 % 65536]))
            if number % 10 == 9:
                log.tick((number + 1) * 10**9)
    return path.read_bytes()


def _packets(path: Path) -> bytes:
    with LogWriter(path, capture={"host": "bench"}) as log:
        log.add_link("eth0", {"spec": "net:eth0", "ports": "502"})
        for number in range(75):
            log.write(PACKET)
            if number % 25 == 24:
                log.write(EVENT)
                log.add_link(f"late{number}", {})
                log.tick((number + 1) * 10**9)
            log.write(transaction(number, link="10.0.0.9"))
    return path.read_bytes()


def _killed(path: Path) -> bytes:
    log = LogWriter(path, capture={"host": "bench"})
    for number in range(80):
        log.write(chunk(number))
        log.write(transaction(number, response_values=[number, 5]))
        if number % 10 == 9:
            log.tick((number + 1) * 10**9)
    data = path.read_bytes()
    log.close()
    return data


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--step", type=int, default=STEP, help="bytes from one flip to the next")
    parser.add_argument("--cut-step", type=int, default=1, help="bytes from one cut to the next")
    parser.add_argument("--log", action="append", help="only this one of the logs; repeatable")
    options = parser.parse_args(arguments)
    is_right = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for log, data in logs(folder).items():
            if options.log and log not in options.log:
                continue
            for kind, changes in (
                ("flips", flips(data, options.step)), ("cuts", cuts(data, options.cut_step))
            ):  # fmt: skip
                result = survey(data, changes, folder)
                is_right &= not (result.wrong or result.behind_stock)
                sys.stdout.write(
                    f"{log:8} {len(data):7,} bytes {result.tried:7,} {kind:5} "
                    f"behind the stock reader {len(result.behind_stock):4,}  "
                    f"a whole message missing {len(result.not_whole):4,}  "
                    f"wrong {len(result.wrong):3,}  slowest {result.slowest_s:.2f} s\n"
                )
                for each in [*result.wrong, *result.behind_stock, *result.not_whole][:12]:
                    sys.stdout.write(f"    {each}\n")
                sys.stdout.flush()
    return 0 if is_right else 1


if __name__ == "__main__":
    sys.exit(main())
