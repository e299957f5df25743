"""Decodes a capture both ways: packet by packet, and with plain stretches read as arrays.

`python -m tests.columns.both_ways --captures 1000` compares the two on so many generated captures,
cut in blocks of several sizes: simulated plants and many short connections in turn, every third
one in IPv6. Tables, lines and objects are compared, half of them with a profile and with a filter.
"""

from __future__ import annotations

import argparse
import io
import random
from dataclasses import replace
from ipaddress import ip_address
from typing import TYPE_CHECKING, NamedTuple
from unittest.mock import patch

import pyarrow as pa

from mbtool.columns import packet_block, plain_lines
from mbtool.columns.block_table import BlockTables
from mbtool.columns.column_decoder import ColumnDecoder
from mbtool.columns.packet_block import read_blocks
from mbtool.columns.plain_lines import BlockLines
from mbtool.columns.plain_records import plain_records
from mbtool.columns.plain_transactions import PlainObjects
from mbtool.columns.portions import portions
from mbtool.columns.row_table import row_table
from mbtool.core import InputError, WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.devices.assignment import Assignments, parse_assignment
from mbtool.logs import csv_line, transaction_to_jsonl
from mbtool.packets import read_capture
from mbtool.query.where import parse_where
from tests.adversary.network import ALL_LOSSES, MASTERS, simulate
from tests.columns.disturbed_captures import disturbed
from tests.packets.building import ipv6, pcap

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import BinaryIO

    from mbtool.columns.column_decoder import DecodedBlock
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction

PORTS = (502,)
NAME = "a.pcap"
PROFILES = (None, "fa3-at1m8x", None, "wago-750", None, "idec-ft1a-touch")
WHERE = ("function == 3", 'outcome == "exception" or latency_ms > 5', "1 in values", "unit < 17")


class Outcome(NamedTuple):
    """What one way made of a capture."""

    table: pa.Table
    events: list[WireEvent]
    error: str | None
    plain: int = 0
    """How many transactions were read as arrays."""


def namer_of(profile: str | None) -> Namer:
    """A namer that takes all slaves for devices of this profile; None for no profile."""
    return Namer(Assignments([] if profile is None else [parse_assignment(f"all={profile}")]))


def packet_by_packet(capture: bytes, profile: str | None = None) -> Outcome:
    records, error = records_of(capture, namer_of(profile))
    rows = [one for one in records if not isinstance(one, WireEvent)]
    events = [one for one in records if isinstance(one, WireEvent)]
    return Outcome(without_dictionaries(row_table(rows)), events, error)


def records_of(capture: bytes, namer: Namer | None = None) -> tuple[list[Record], str | None]:
    """What the decoder makes of the packets one by one, and the error that ends the capture."""
    decoder = Decoder(namer or Namer(), ports=PORTS, across=True)
    records: list[Record] = []
    error = None
    try:
        for packet in read_capture(io.BytesIO(capture), NAME):
            records += decoder.feed(packet)
    except InputError as one:
        error = str(one)
    return records + decoder.close(), error


def as_arrays(
    capture: bytes,
    block_packets: int = packet_block.BLOCK_PACKETS,
    profile: str | None = None,
) -> Outcome:
    blocks, error, plain = blocks_of(capture, block_packets, namer_of(profile))
    tables = BlockTables(namer_of(profile))
    made, events = [], []
    for decoded in blocks:
        made.append(without_dictionaries(tables.batch(decoded).table))
        for _, record in decoded.sorted_records(with_passed=True):
            if isinstance(record, WireEvent):
                events.append(record)
    return Outcome(pa.concat_tables(made).combine_chunks(), events, error, plain)


def blocks_of(
    capture: bytes,
    block_packets: int = packet_block.BLOCK_PACKETS,
    namer: Namer | None = None,
) -> tuple[list[DecodedBlock], str | None, int]:
    """The results of all portions, the error that ends the capture, and how many rows are plain."""
    decoder = ColumnDecoder(Decoder(namer or Namer(), ports=PORTS, across=True), PORTS)
    blocks: list[DecodedBlock] = []
    error = None
    stream: BinaryIO = io.BufferedReader(io.BytesIO(capture))
    with patch.object(packet_block, "BLOCK_PACKETS", block_packets):
        try:
            for block in read_blocks(stream, NAME):
                for decoded in decoder.feed(block):
                    blocks += portions(decoded)
        except InputError as one:
            error = str(one)
    return [*blocks, decoder.close()], error, decoder.plain_rows


def without_dictionaries(table: pa.Table) -> pa.Table:
    fields = [
        (one.name, pa.string() if pa.types.is_dictionary(one.type) else one.type)
        for one in table.schema
    ]
    return table.cast(pa.schema(fields)).combine_chunks()


def differences(
    capture: bytes,
    block_packets: int = packet_block.BLOCK_PACKETS,
    profile: str | None = None,
) -> list[str]:
    """What the two ways make differently of a capture, a line for each column."""
    read = as_arrays(capture, block_packets, profile)
    return differences_of(packet_by_packet(capture, profile), read)


def differences_of(one: Outcome, other: Outcome) -> list[str]:
    found = []
    if one.error != other.error:
        found.append(f"errors: {one.error} and {other.error}")
    if one.events != other.events:
        found.append(f"events: {len(one.events)} and {len(other.events)}")
    if one.table.num_rows != other.table.num_rows:
        found.append(f"rows: {one.table.num_rows} and {other.table.num_rows}")
    return found + [
        f"column {name}"
        for name in one.table.schema.names
        if not one.table[name].equals(other.table[name])
    ]


def differing_records(
    capture: bytes, block_packets: int, profile: str | None, where: str
) -> list[str]:
    """What the two ways make differently of a capture: objects, and those that a filter takes."""
    blocks, _, _ = blocks_of(capture, block_packets, namer_of(profile))
    objects = PlainObjects(namer_of(profile))
    found = [record for one in blocks for record in plain_records(one, objects)]
    expected, _ = records_of(capture, namer_of(profile))
    takes = parse_where(where)
    some, others = (
        [one for one in records if not isinstance(one, WireEvent) and takes(one)]
        for records in (found, expected)
    )
    told = [] if found == expected else ["objects"]
    return told if some == others else [*told, f"where {where}"]


def differing_texts(
    capture: bytes,
    block_packets: int = packet_block.BLOCK_PACKETS,
    profile: str | None = None,
) -> list[str]:
    """The formats whose lines of a capture differ by one byte or more."""
    records, _ = records_of(capture, namer_of(profile))
    blocks, _, _ = blocks_of(capture, block_packets, namer_of(profile))
    rows = [one for one in records if not isinstance(one, WireEvent)]
    found = []
    for name, line_of, separator in (("jsonl", jsonl_line, ","), ("csv", csv_line, " ")):
        for few in (1, plain_lines.MIN_TEMPLATE_ROWS):
            lines = BlockLines(line_of, separator, namer_of(profile))
            with patch.object(plain_lines, "MIN_TEMPLATE_ROWS", few):
                text = "".join([lines.batch(one).text for one in blocks])
            if text != "".join(map(line_of, rows)):
                found.append(f"{name}, templates from {few} rows on")
    return found


def jsonl_line(transaction: NamedTransaction) -> str:
    return transaction_to_jsonl(transaction).decode()


def generated(number: int, requests: int = 60) -> bytes:
    """A simulated plant's capture: every kind of master and of loss in turn."""
    rng = random.Random(number)
    master, losses = MASTERS[number % len(MASTERS)], rng.choice(ALL_LOSSES)
    return pcap(simulate(master, losses, number, requests).packets)


def damaged(capture: bytes, rng: random.Random) -> bytes:
    """A capture without some of its beginning or end, or with some bytes changed."""
    changed = bytearray(capture)
    for _ in range(rng.choice((0, 0, 1, 5))):
        changed[rng.randrange(24, len(changed))] = rng.randrange(256)
    return bytes(changed[: rng.randrange(24, len(changed))] if rng.random() < 0.3 else changed)


def in_ipv6(capture: bytes) -> bytes:
    """The same Ethernet capture with IPv6 packets in the place of the IPv4 ones."""
    packets = []
    for one in read_capture(io.BytesIO(capture), NAME):
        head, size = one.data[:12], (one.data[14] & 15) * 4
        end = 14 + int.from_bytes(one.data[16:18], "big")
        source, destination = (f"fd00::{ip_address(one.data[at : at + 4])}" for at in (26, 30))
        data = head + b"\x86\xdd" + ipv6(one.data[14 + size : end], source, destination)
        packets.append(replace(one, data=data, original_length=len(data)))
    return pcap(packets, magic=0xA1B23C4D)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=1000, help="how many captures to compare")
    parser.add_argument("--first", type=int, default=0, help="the seed of the first one")
    options = parser.parse_args()
    plain = rows = differing = 0
    for done, number in enumerate(range(options.first, options.first + options.captures), 1):
        rng = random.Random(f"cut {number}")
        made = disturbed(number) if number % 2 else generated(number)
        capture = damaged(in_ipv6(made) if number % 3 == 2 else made, rng)
        size = rng.choice((3, 17, 100, 100, 65_536, 65_536))
        profile, where = PROFILES[number // 2 % len(PROFILES)], rng.choice(WHERE)
        read = as_arrays(capture, size, profile)
        found: Sequence[str] = [
            *differences_of(packet_by_packet(capture, profile), read),
            *differing_texts(capture, size, profile),
            *differing_records(capture, size, profile, where),
        ]
        plain, rows = plain + read.plain, rows + read.table.num_rows
        differing += bool(found)
        if found:
            print(f"capture {number}, blocks of {size}, {profile}: {'; '.join(found)}", flush=True)
        if done % 50 == 0 or done == options.captures:
            told = f"{done} captures, {rows} transactions, {plain} of them read as arrays"
            print(f"{told}: {differing} captures differ", flush=True)


if __name__ == "__main__":
    main()
