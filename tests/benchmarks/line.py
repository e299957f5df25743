"""Measures the RS-485 decoder on made traffic: python -m tests.benchmarks.line [--help].

Traffic whose truth is known (bus_traffic.py) is damaged, delivered as adapters deliver it
(adapters.py), decoded, and counted against the truth (figures.py). A row of the table is one
adapter and one damage, for this decoder and for the peers that are installed (line_peers.py), all
on the same bytes.

With --plants it measures lines as they are found in practice (plants/): units that do not respond,
adapters that echo, two masters, noise of any value. Their truth says also what nobody can know.

The traffic comes from several lines, each with its own seed, units and poll list, so that none
decides the figures alone. Rates are the machine's; all else depends on the arguments only.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict, deque
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING, Protocol

from rich.console import Console
from rich.table import Table

from mbtool.core import SerialFormat, WireEvent
from mbtool.decode.connections import Bus
from mbtool.modbus import Adu, Transaction
from mbtool.serial_line import RtuSplitter
from tests.benchmarks.adapters import Column, Damage, Read, Wire, damaged, delivered
from tests.benchmarks.bus_traffic import LINE, bus_traffic
from tests.benchmarks.figures import SURE, Figures, Heard, figures
from tests.benchmarks.line_peers import installed
from tests.benchmarks.plants import report as plants_report
from tests.benchmarks.plants.peers import plant_decoders

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

TRANSACTIONS = 5_000
LINES = 10
"""How many lines the transactions come from."""
CUTS = 50
"""How many captures have a cut start, since each has only one."""


class Decoder(Protocol):
    """Reads in, what a decoder makes of them out."""

    def __call__(self, wire: Wire, reads: Sequence[Read], column: Column, /) -> Heard: ...


@dataclass(frozen=True, slots=True)
class Cell:
    """A row of the table."""

    decoder: str
    column: Column
    damage: Damage
    figures: Figures


def measure(
    column: Column,
    damage: Damage,
    seed: int = 1,
    transactions: int = TRANSACTIONS,
    *,
    line: SerialFormat = LINE,
    decoder: Decoder | None = None,
) -> Figures:
    """The figures of one cell."""
    counted = Figures()
    decode = decoder or hear
    lines = min(CUTS if damage is Damage.CUT else LINES, max(transactions // 20, 1))
    for number in range(lines):
        traffic = bus_traffic(seed * 1000 + number, -(-transactions // lines), line)
        wire = damaged(traffic, damage, Random(f"{damage} {seed} {number}"))
        one = figures(traffic, wire, decode(wire, delivered(wire, column), column))
        one.misses = [f"line {number}, byte {miss}" for miss in one.misses]
        counted.add(one)
    return counted


def hear(wire: Wire, reads: Sequence[Read], column: Column) -> Heard:
    """Decode with this project's decoder: frames alone for the time, then with transactions."""
    heard = Heard()
    timed = column is not Column.NO_TIMES

    splitter = RtuSplitter(wire.line, timed=timed)
    begin = time.process_time()
    for data, ts_ns in reads:
        splitter.feed(data, ts_ns)
    splitter.close()
    heard.seconds = time.process_time() - begin

    bus = rtu_bus(wire.line, timed=timed)
    decoded: list[Adu | Transaction | WireEvent] = []
    begin = time.process_time()
    for data, ts_ns in reads:
        decoded += bus.feed(data, ts_ns)
    decoded += bus.close()
    heard.transaction_seconds = time.process_time() - begin

    # No byte is lost, so that all before it say where a frame begins.
    offset = 0
    places: Places = defaultdict(deque)
    told: list[Transaction] = []
    for one in decoded:
        if isinstance(one, Transaction):
            told.append(one)
            continue
        if isinstance(one, Adu):
            sure = one.confidence >= SURE
            heard.frames.append((offset, one.raw, one.direction if sure else None))
            places[one.raw, one.end_ns].append(offset)
        offset += len(one.raw)
    assert offset == len(wire.data), f"{offset} bytes came out of {len(wire.data)}"
    heard.transactions = [
        (
            _taken(places, one.request_raw, one.request_ns),
            _taken(places, one.response_raw, one.response_ns),
            one.outcome,
        )
        for one in told
    ]
    return heard


Places = dict[tuple[bytes, int], deque[int]]
"""Where the frames of so many bytes, completed at a time, begin."""


def _taken(places: Places, raw: bytes | None, end_ns: int | None) -> int | None:
    """The place of one frame of a transaction; each place is given once."""
    if raw is None or end_ns is None:
        return None
    return places[raw, end_ns].popleft()


def rtu_bus(line: SerialFormat, *, timed: bool) -> Bus:
    return Bus("line", line, timed=timed)


def cells(
    columns: Sequence[Column],
    damages: Sequence[Damage],
    decoders: dict[str, Decoder],
    seed: int,
    transactions: int,
    line: SerialFormat,
) -> Iterator[Cell]:
    for damage in damages:
        for column in columns:
            for name, decoder in decoders.items():
                yield Cell(
                    name,
                    column,
                    damage,
                    measure(column, damage, seed, transactions, line=line, decoder=decoder),
                )


HEADINGS = (
    "decoder", "adapter", "damage", "found", "false/10k", "in doubt", "direction", "ambiguous",
    "wrong", "transactions", "out of step", "MB/s", "MB/s all",
)  # fmt: skip


def row(cell: Cell) -> tuple[str, ...]:
    """One line of the table, in words."""
    one = cell.figures
    knows_transactions = one.transactions is not None
    return (
        cell.decoder,
        cell.column,
        cell.damage,
        _percent(one.found_share),
        f"{one.false_per_10000:.1f}",
        f"{one.in_doubt_per_10000:.1f}",
        _percent(one.right_share),
        _percent(one.ambiguous_share),
        _percent(one.wrong_share),
        _percent(one.transactions_share),
        f"{one.out_of_step_p99}/{one.out_of_step_most}"
        if knows_transactions and one.out_of_step
        else "-",
        _megabytes(one.rate),
        _megabytes(one.transaction_rate),
    )


def _percent(share: float | None) -> str:
    """Rounded down, so that 100 % means all."""
    return "-" if share is None else f"{int(share * 10_000 + 1e-6) / 100:.2f} %"


def _megabytes(rate: float | None) -> str:
    return "-" if rate is None else f"{rate / 1e6:.3f}"


def main(arguments: Sequence[str] | None = None) -> None:
    options = _options()
    asked = options.parse_args(arguments)
    if asked.plants:
        decoders_of_plants = plant_decoders(peers=asked.peers)
        if not list(plants_report.chosen(asked.cell)):
            options.error(f"--cell {asked.cell}: no plant or no adapter has such a name")
        plants_report.main(asked, decoders_of_plants)
        return
    columns, damages = list(Column), list(Damage)
    if asked.cell:
        column, _, damage = asked.cell.partition("/")
        columns = [one for one in columns if not column or column in one]
        damages = [one for one in damages if not damage or damage in one]
        if not columns or not damages:
            options.error(f"--cell {asked.cell}: no adapter or no damage has such a name")
    decoders: dict[str, Decoder] = {"mbtool": hear}
    missing: list[str] = []
    if asked.peers:
        peers, missing = installed()
        decoders |= peers
    done = cells(
        columns, damages, decoders, asked.seed, asked.transactions, SerialFormat.parse(asked.line)
    )
    if asked.json:
        for cell in done:
            counted = {"decoder": cell.decoder, "adapter": cell.column, "damage": cell.damage}
            sys.stdout.write(json.dumps(counted | cell.figures.as_json()) + "\n")
        return
    table = Table(box=None, pad_edge=False)
    for place, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if place < 3 else "right", no_wrap=True)
    for cell in done:
        table.add_row(*row(cell))
        if asked.misses:
            sys.stdout.write("".join(f"{miss}\n" for miss in cell.figures.misses[: asked.misses]))
    console = Console(width=180)
    console.print(table)
    for name in missing:
        console.print(f"{name}: not installed")


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.line")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--transactions", type=int, default=TRANSACTIONS, metavar="N")
    parser.add_argument("--line", default=str(LINE), help="baud and format, as 19200-8E1")
    parser.add_argument(
        "--cell",
        metavar="ADAPTER/DAMAGE",
        help="only those whose names contain these: 'FTDI/none', '/bit', '1 ms/'",
    )
    parser.add_argument(
        "--peers",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="the same for tshark, pymodbus and modbus-sniffer, where installed",
    )
    parser.add_argument(
        "--misses",
        type=int,
        default=0,
        metavar="N",
        help="say of the first N of each cell what is missing, false or wrong",
    )
    parser.add_argument("--json", action="store_true", help="a line of JSON for each cell")
    plants_report.add_options(parser)
    return parser


if __name__ == "__main__":
    main()
