"""Measures each stage of decoding on one capture: python -m tests.benchmarks.decode [TRANSACTIONS].

The capture is made in memory: one connection on which a master reads the eight values of an
FA3-AT1M8X over and over. Each stage gets what the one before it gave, all of it at once, so none
pays for another. The last two read a log of it that was made without a profile, and name it anew.
Absolute figures are the machine's; what can be compared are the shares.
"""

from __future__ import annotations

import gc
import io
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console

from mbtool.core import Chunk, Direction, Packet
from mbtool.decode.connections import ConnectionDecoder
from mbtool.devices import Assignments, NamedTransaction, Namer, parse_assignment
from mbtool.logs import LogReader, LogWriter, transaction_to_jsonl
from mbtool.modbus import Transaction, encode_pdu, mbap_adu
from mbtool.packets import TcpReassembler, read_capture
from mbtool.views.transaction_table import TransactionTable
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

TRANSACTIONS = 20_000
ADUS_OF_ONE = 2
ROUNDS = 3
"""The quickest counts: what is slower was disturbed."""

_TO_JSONL = ("read", "reassemble", "decode", "name", "jsonl")
"""The stages from a packet capture to jsonl."""

Out = TypeVar("Out")

ASSIGNMENTS = Assignments([parse_assignment("all=fa3-at1m8x")])


@dataclass(frozen=True, slots=True)
class Measurement:
    """One stage's best time over a capture of so many ADUs."""

    stage: str
    adus: int
    seconds: float
    gives: int
    """How many items came out, or lines of text."""

    @property
    def rate(self) -> float:
        return self.adus / self.seconds


def main() -> None:
    transactions = int(sys.argv[1]) if len(sys.argv) > 1 else TRANSACTIONS
    sys.stdout.write(report(measure(transactions)))


def measure(transactions: int, rounds: int = ROUNDS) -> list[Measurement]:
    """Run every stage."""
    capture = synthetic_capture(transactions)
    measured: list[Measurement] = []

    def run(stage: str, work: Callable[[], list[Out]]) -> list[Out]:
        best, given = min((timed(work) for _ in range(rounds)), key=lambda one: one[0])
        measured.append(Measurement(stage, transactions * ADUS_OF_ONE, best, len(given)))
        return given

    packets = run("read", lambda: list(read_capture(io.BytesIO(capture))))
    chunks = run("reassemble", lambda: reassembled(packets))
    decoded = run("decode", lambda: conversed(chunks))
    named = run("name", lambda: in_words(decoded))
    run("jsonl", lambda: [transaction_to_jsonl(one) for one in named])
    run("table", lambda: tabled(named))
    log = logged(packets, decoded)
    read = run("log", lambda: transactions_of(log))
    run("anew", lambda: named_anew(read))
    return measured


def report(measured: Sequence[Measurement]) -> str:
    """A line for each stage: its rate, and its share of the time that decoding to jsonl takes."""
    seconds = {one.stage: one.seconds for one in measured}
    whole = sum(seconds[stage] for stage in _TO_JSONL)
    lines = [f"{'stage':<12}{'ADU/s':>12}{'share':>8}"]
    lines += [f"{one.stage:<12}{one.rate:>12,.0f}{one.seconds / whole:>8.0%}" for one in measured]
    lines.append(f"{'file to jsonl':<12}{measured[0].adus / whole:>11,.0f}{1:>8.0%}")
    before = sum(seconds[stage] for stage in ("read", "reassemble", "decode"))
    of_whole, of_before = seconds["name"] / whole, seconds["name"] / before
    lines += [
        f"naming takes {of_whole:.0%} of all that, {of_before:.0%} of what comes before it",
        f"naming anew takes {seconds['anew'] / seconds['log']:.0%} of what reading a log takes",
    ]
    return "\n".join(lines) + "\n"


def synthetic_capture(transactions: int) -> bytes:
    """A pcap file of one connection: a poll of eight input registers whose values change."""
    talk = Talk()
    packets = talk.handshake()
    request = encode_pdu(0x04, Direction.REQUEST, address=2, quantity=8)
    for number in range(transactions):
        values = tuple((number * channel) & 0x7FFF for channel in range(1, 9))
        response = encode_pdu(0x04, Direction.RESPONSE, values=values)
        transaction_id = number & 0xFFFF
        packets.append(talk.request(mbap_adu(transaction_id, 1, request)))
        packets.append(talk.response(mbap_adu(transaction_id, 1, response)))
    return pcap([*packets, *talk.goodbye()])


def timed(work: Callable[[], Out]) -> tuple[float, Out]:
    gc.freeze()  # What other stages gave is not this one's to visit.
    begin = time.process_time()
    given = work()
    return time.process_time() - begin, given


def reassembled(packets: Sequence[Packet]) -> list[Chunk]:
    reassembler = TcpReassembler(frozenset({502}))
    items: list[Any] = []
    for packet in packets:
        items += reassembler.feed(packet)
    return [item for item in items if isinstance(item, Chunk)]


def conversed(chunks: Sequence[Chunk]) -> list[Transaction]:
    assert chunks[0].connection is not None
    conversation = ConnectionDecoder(chunks[0].connection)
    decoded: list[Any] = []
    for chunk in chunks:
        decoded += conversation.feed(chunk.direction, chunk.data, chunk.ts_ns)
    return [one for one in decoded if isinstance(one, Transaction)]


def in_words(transactions: Sequence[Transaction]) -> list[NamedTransaction]:
    namer = Namer(ASSIGNMENTS)
    return [namer.name(one) for one in transactions]


def logged(packets: Sequence[Packet], transactions: Sequence[Transaction]) -> bytes:
    """A log of both, as `sniff` writes it where no device is named."""
    namer = Namer()
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory, "a.mcap")
        with LogWriter(path, capture={}) as log:
            for packet in packets:
                log.write(packet)
            for one in transactions:
                log.write(namer.name(one))
        return path.read_bytes()


def transactions_of(log: bytes) -> list[NamedTransaction]:
    items = LogReader(io.BytesIO(log), "a.mcap").items()
    return [item for item in items if isinstance(item, NamedTransaction)]


def named_anew(transactions: Sequence[NamedTransaction]) -> list[NamedTransaction]:
    namer = Namer(ASSIGNMENTS)
    return [namer.rename(one) for one in transactions]


def tabled(transactions: Sequence[NamedTransaction]) -> list[str]:
    file = io.StringIO()
    table = TransactionTable(Console(file=file, width=160))
    for number, one in enumerate(transactions, start=1):
        table.add(number, one, ASSIGNMENTS.profile_for(one))
    table.flush()
    return file.getvalue().splitlines()


if __name__ == "__main__":
    main()
