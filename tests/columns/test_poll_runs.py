"""Account and inventory are the same from arrays as packet by packet."""

from __future__ import annotations

import io
import random
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

from mbtool.columns import packet_block, poll_runs, quiet_rows
from mbtool.columns.column_decoder import ColumnDecoder
from mbtool.columns.packet_block import read_blocks
from mbtool.columns.poll_runs import BlockRun
from mbtool.columns.quiet_rows import BlockRows, QuietParts
from mbtool.core import Direction, InputError
from mbtool.decode.decoder import Decoder
from mbtool.devices import NamedTransaction, Namer
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.ledger import account, distribution, observation, poll_statistics, request_order
from mbtool.ledger.account import Account
from mbtool.ledger.inventory import inventory
from mbtool.ledger.unit_account import UnitAccount, UnitKey
from mbtool.modbus import encode_pdu, exception_pdu
from mbtool.packets import read_capture
from mbtool.views.inventory_documents import inventory_json
from mbtool.views.statistics_document import statistics_document
from tests.columns.both_ways import NAME, PORTS, damaged, generated
from tests.columns.test_equality import poll
from tests.packets.building import Pcapng, Talk, pcap
from tests.troubles.judging import judged

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.decode.decoder import Record
    from mbtool.devices.checking.quiet_run import PollName


def packet_by_packet(capture: bytes) -> Iterator[Record]:
    decoder = Decoder(Namer(), ports=PORTS, across=True)
    try:
        for packet in read_capture(io.BytesIO(capture), NAME):
            yield from decoder.feed(packet)
    except InputError:
        pass
    yield from decoder.close()


def in_runs(capture: bytes) -> Iterator[Record | BlockRun]:
    for part in quiet_parts(capture):
        yield part.run if isinstance(part, BlockRows) else part


def quiet_parts(capture: bytes) -> Iterator[Record | BlockRows]:
    decoder = ColumnDecoder(Decoder(Namer(), ports=PORTS, across=True), PORTS)
    runs = QuietParts(Namer())
    try:
        for block in read_blocks(io.BufferedReader(io.BytesIO(capture)), NAME):
            for decoded in decoder.feed(block):
                yield from runs.parts(decoded)
    except InputError:
        pass
    yield from runs.parts(decoder.close())


UNIT = [name for name in UnitAccount.__slots__ if name not in ("bins", "observed")]


def overview(
    parts: Iterator[Record | BlockRun],
) -> tuple[str, str, dict[UnitKey, list[object]], int]:
    """Both documents, the times of each unit, and how many requests came in runs."""
    counted, in_runs_ = Account(observes=True), 0
    for part in parts:
        if isinstance(part, BlockRun):
            counted.add_run(part)
            in_runs_ += len(part)
        else:
            counted.add(part)
    counted.settle()
    document = statistics_document(counted, judged(counted), sources=[], where=None)
    units = {
        unit: [one.bins.cells, *(getattr(one, name) for name in UNIT)]
        for unit, one in counted.units.items()
    }
    return document, inventory_json(inventory(counted), "1"), units, in_runs_


def assert_equal(capture: bytes, block_packets: int = 65_536) -> int:
    """Both ways give the same documents; return how many requests came in runs."""
    with (
        patch.object(packet_block, "BLOCK_PACKETS", block_packets),
        patch.object(quiet_rows, "FEWEST", 3),
    ):
        *found, requests = overview(in_runs(capture))
    *expected, _ = overview(packet_by_packet(capture))
    assert found == expected
    return requests


def several_polls() -> bytes:
    """Two masters ask three slaves in turn, with other addresses and latencies each time."""
    rng = random.Random(3)
    talks = [Talk() for _ in range(4)]
    for number, talk in enumerate(talks):
        talk.master.port += number
        talk.slave.host = f"10.0.0.{10 + number % 3}"
    packets = [packet for talk in talks for packet in talk.handshake()]
    for _ in range(100):
        talk = rng.choice(talks)
        address = rng.choice((0, 10, 20, 30))
        request = encode_pdu(0x03, Direction.REQUEST, address=address, quantity=2)
        response = encode_pdu(0x03, Direction.RESPONSE, values=(1, address))
        if rng.random() < 0.3:
            request = encode_pdu(0x06, Direction.REQUEST, address=address, value=address)
            response = request
        refused = exception_pdu(request[0], rng.choice((2, 3)))
        answer = rng.choice((response, response, refused))
        packets += poll(talk, rng.choice((1, 5)), request, answer)
    at_ns = 1_700_000_000_000_000_000
    blocks = Pcapng()
    file = blocks.section() + blocks.interface()
    for packet in packets:
        is_request = len(packet.data) % 2 == 0
        at_ns += rng.randrange(1, 40_000_000_000 if is_request else 40_000_000)
        file += blocks.enhanced(packet.data, at_ns // 1000)
    return file


@pytest.mark.parametrize("number", range(14))
def test_simulated_plants_give_equal_documents(number: int) -> None:
    rng = random.Random(number)
    assert_equal(damaged(generated(number), rng), rng.choice((17, 100, 65_536)))


@pytest.mark.parametrize("block_packets", [7, 50, 65_536])
@pytest.mark.parametrize("window", [1, 5, 2048])
def test_polls_that_end_in_different_ways_give_equal_documents(
    window: int, block_packets: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_order, "WINDOW", window)
    assert assert_equal(several_polls(), block_packets) > 20


@pytest.mark.parametrize(
    "limit",
    [
        (account, "MAX_POLLS"), (account, "MAX_LINKS"), (account, "MAX_UNITS"),
        (account, "MAX_USES"), (account, "MAX_MASTERS"), (request_order, "MAX_TAPES"),
        (observation, "MAX_REQUESTS"),
        (poll_statistics, "_PERIOD_BUCKETS"), (poll_runs, "MAX_FORMS"),
    ],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("most", [2, 4])
def test_limits_that_are_reached_give_equal_documents(
    limit: tuple[object, str], most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_order, "WINDOW", 5)
    monkeypatch.setattr(*limit, most)
    assert assert_equal(several_polls(), 60) > 20


@pytest.mark.parametrize("few", [0, 1, 3])
def test_polls_that_come_and_go_within_a_batch_give_equal_documents(
    few: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_order, "WINDOW", 5)
    monkeypatch.setattr(account, "MAX_POLLS", 3)
    monkeypatch.setattr(account, "_FEW", few)
    assert assert_equal(several_polls()) > 20


def test_requests_without_answer_between_polls_give_equal_documents(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(request_order, "WINDOW", 2)
    talk = Talk()
    packets = [*talk.handshake(), *poll(talk, 20)]
    packets += poll(talk, 1)[:1] + poll(talk, 20)
    assert assert_equal(pcap(packets), 13) > 10


def test_durations_added_together_are_counted_as_one_by_one() -> None:
    rng = random.Random(1)
    one, together = distribution.Distribution(16), distribution.Distribution(16)
    for _ in range(40):
        some = [rng.randrange(10 ** rng.randrange(1, 9)) for _ in range(rng.randrange(20))]
        together.add_all(some)
        for ns in some:
            one.add(ns)
        assert [getattr(one, name) for name in one.__slots__] == [
            getattr(together, name) for name in one.__slots__
        ]


def test_a_run_knows_the_packets_and_sizes_of_each_request() -> None:
    capture = several_polls()
    expected = {
        (one.link, one.request_ns): one
        for one in packet_by_packet(capture)
        if isinstance(one, NamedTransaction)
    }
    found = 0
    with patch.object(quiet_rows, "FEWEST", 3):
        runs = [part for part in in_runs(capture) if isinstance(part, BlockRun)]
    for run in runs:
        sizes = zip(run.rows.request_bytes, run.rows.response_bytes, strict=True)
        for place, (asking, answering) in enumerate(sizes):
            like = run.like(place)
            one = expected[like.link, like.request_ns]
            assert run.packets(place) == (one.request_packet, one.response_packet)
            assert asking == len(one.request_raw or b"")
            assert answering == len(one.response_raw or b"")
            fields = ("address", "quantity", "reference", "exception", "transaction_id", "source")
            assert [getattr(like, name) for name in fields] == [
                getattr(one, name) for name in fields
            ]
            found += 1
    assert found > 20


def test_the_values_of_a_poll_leave_out_its_refused_requests() -> None:
    refused = count = 0
    with patch.object(quiet_rows, "FEWEST", 3):
        parts = [one for one in quiet_parts(several_polls()) if isinstance(one, BlockRows)]
    for part in parts:
        refused += len(part.run.refused)
        for index, (_, _, function, _, quantity) in enumerate(part.reads.asked):
            one = part.reads[index]
            if function == 3:
                assert len(one.values.words()) == 2 * quantity * len(one.request_ns)
                count += len(one.request_ns)
    assert refused > 5
    assert count > 5


@pytest.mark.parametrize("number", range(20))
def test_polls_used_together_leave_the_same_entries_as_one_by_one(number: int) -> None:
    rng = random.Random(number)
    limit = rng.randrange(1, 12)
    together: LruDict[PollName, list[int]] = LruDict(list, limit=limit)
    singly: LruDict[PollName, list[int]] = LruDict(list, limit=limit)
    talk = Talk()
    packets = talk.handshake()
    for _ in range(rng.randrange(30, 120)):
        address = rng.randrange(rng.choice((4, 20)))
        request = encode_pdu(0x03, Direction.REQUEST, address=address, quantity=1)
        packets += poll(talk, 1, request, encode_pdu(0x03, Direction.RESPONSE, values=(1,)))
    with (
        patch.object(quiet_rows, "FEWEST", 3),
        patch.object(packet_block, "BLOCK_PACKETS", rng.choice((20, 60, 65_536))),
    ):
        runs = [part for part in in_runs(pcap(packets)) if isinstance(part, BlockRun)]
    uses = 0
    for run in runs:
        for value, stay in together.use(run):
            value += [uses + place for place in stay.places]
        polls = run.stays((), len(run)).left
        for place, name in sorted((place, one.name) for one in polls for place in one.places):
            singly[name].append(uses + place)
        uses += len(run)
        assert list(together.items()) == list(singly.items())
    assert uses > 20
