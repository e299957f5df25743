"""The page of a capture does not depend on how the capture is read."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pytest

from mbtool.columns import packet_block, quiet_rows
from mbtool.core import Direction
from mbtool.devices.checking import checker
from mbtool.ledger import account
from mbtool.modbus import encode_pdu, exception_pdu, mbap_adu
from mbtool.values import values
from mbtool.views.report import late_answers, transaction_rows
from mbtool.workflows.report import ReportRun
from mbtool.workflows.shared import reading_choice
from mbtool.workflows.shared.reading import ReadingOptions
from tests.benchmarks.file_workloads import clean, dirty, make_capture
from tests.columns.both_ways import generated
from tests.packets.building import Talk, pcap
from tests.views.report.pages import Page

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from mbtool.core import Packet

NEVER = 1 << 60
START_NS = 1_700_000_000_000_000_000
READ = encode_pdu(3, Direction.REQUEST, address=0, quantity=1)


def page_of(path: Path, at_least: int, *, everything: bool = False) -> tuple[Any, list[str]]:
    """What the page shows; the capture is read as arrays if it has at least so many bytes."""
    with patch.object(reading_choice, "WORTH_BYTES", at_least):
        run = ReportRun([str(path)], ReadingOptions(), everything=everything)
    run.read()
    document = Page(run.page()).document
    del document["made"]
    return document, run.remarks


def demand_equal(path: Path, *, everything: bool = False) -> int:
    """Compare both ways, with small blocks; return how many reads were taken together."""
    rows = ReportRun._add_rows
    with (
        patch.object(packet_block, "BLOCK_PACKETS", 150),
        patch.object(quiet_rows, "FEWEST", 2),
        patch.object(checker, "_ONE_BY_ONE", 1),
        patch.object(ReportRun, "_add_rows", autospec=True, side_effect=rows) as taken,
    ):
        expected = page_of(path, NEVER, everything=everything)
        assert page_of(path, 0, everything=everything) == expected
    return sum(len(some) for (_, some), _ in taken.call_args_list)


def mixed_polls(seed: int) -> bytes:
    """Two masters read registers and bits of three slaves, some of them the same ones; few values
    change. Some requests are refused, some write, some get no answer.
    """
    rng = random.Random(seed)
    talks = [Talk(ts_ns=START_NS) for _ in range(4)]
    for number, talk in enumerate(talks):
        talk.master.host = f"10.0.0.{1 + number // 3}"
        talk.slave.host = f"10.0.0.{10 + number % 3}"
    packets = [packet for talk in talks for packet in talk.handshake()]
    polls = [(rng.choice((1, 2, 3, 4)), rng.randrange(12), rng.choice((1, 3, 9))) for _ in range(9)]
    at_ns = START_NS + 1_000_000_000
    for number in range(500):
        talk = rng.choice(talks)
        talk.ts_ns = at_ns = at_ns + rng.choice((1, 40, 2000)) * 1_000_000
        packets += exchange(talk, rng, number, *rng.choice(polls))
        at_ns = talk.ts_ns
    return pcap(packets)


def exchange(
    talk: Talk, rng: random.Random, number: int, function: int, address: int, quantity: int
) -> Iterator[Packet]:
    kind = rng.random()
    unit = rng.choice((1, 5))
    if kind < 0.02:
        pdu = encode_pdu(6, Direction.REQUEST, address=address, value=rng.randrange(3))
        yield talk.request(mbap_adu(number, unit, pdu))
        yield talk.response(mbap_adu(number, unit, pdu))
        return
    pdu = encode_pdu(function, Direction.REQUEST, address=address, quantity=quantity)
    yield talk.request(mbap_adu(number, unit, pdu))
    if kind < 0.03:
        return
    found = tuple(int(rng.random() < 0.1) for _ in range(quantity))
    answer = encode_pdu(function, Direction.RESPONSE, values=found)
    if kind < 0.05:
        answer = exception_pdu(function, 2)
    yield talk.response(mbap_adu(number, unit, answer))


@pytest.mark.parametrize("seed", range(4))
def test_the_page_of_mixed_polls_is_the_same_both_ways(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "polls.pcap"
    path.write_bytes(mixed_polls(seed))
    with patch.object(transaction_rows, "FIRST", 40 * seed):
        assert demand_equal(path, everything=seed == 3) > 100


def two_masters(
    sent_ns: Callable[[int, int], int],
    late_ns: Callable[[int], int] = lambda _: 0,
    value: Callable[[int], int] = lambda _: 7,
) -> bytes:
    """Return a capture of two masters that poll a slave each, 400 times.

    `sent_ns` gives the time of a request (ns behind START_NS) by host (1 or 2) and number,
    `late_ns` and `value` the delay of its answer in ns and the register in it, by number.
    """
    packets = []
    for host in (1, 2):
        talk = Talk(ts_ns=START_NS)
        talk.slave.host = f"10.0.0.{host}"
        packets += talk.handshake()
        for number in range(400):
            talk.ts_ns = START_NS + sent_ns(host, number)
            packets.append(talk.request(mbap_adu(number, host, READ)))
            talk.ts_ns += late_ns(number)
            answer = encode_pdu(3, Direction.RESPONSE, values=(value(number),))
            packets.append(talk.response(mbap_adu(number, host, answer)))
    return pcap(sorted(packets, key=lambda one: one.ts_ns))


def steady_with_late_answers() -> bytes:
    """Every 50th answer is late, some of them by the same time."""
    return two_masters(
        lambda host, number: (number + 1) * 1_000_000_000 + host * 1000,
        lambda number: number % 150 * 1_000_000 + 99_000_000 if number % 50 == 49 else 0,
    )


def test_late_answers_are_rows_both_ways(tmp_path: Path) -> None:
    path = tmp_path / "late.pcap"
    path.write_bytes(steady_with_late_answers())
    with (
        patch.object(transaction_rows, "FIRST", 100),
        patch.object(late_answers, "OF_UNIT", 3),
    ):
        assert demand_equal(path) > 100
        told = page_of(path, 0)[0]["transactions"]
    assert told["late"] == 6
    late = [row[:1] + row[7:8] for row in told["rows"][100:]]
    assert late == [
        [number + host, latency_us]
        for number, latency_us in ((199, 199_000), (299, 249_000), (599, 249_000))
        for host in (0, 1)
    ]


def polling_with_pauses() -> bytes:
    """One of two masters makes 7 pauses of 3.2 to 9.2 s."""

    def sent_ns(host: int, number: int) -> int:
        part = number // 50 if host == 1 else 0
        paused_s = sum(range(2, 2 + part)) + part
        return (number * 200 + paused_s * 1000 + host) * 1_000_000

    return two_masters(sent_ns, value=lambda number: number)


def test_transactions_beside_the_longest_pauses_are_rows_both_ways(tmp_path: Path) -> None:
    path = tmp_path / "pauses.pcap"
    path.write_bytes(polling_with_pauses())
    with patch.object(transaction_rows, "FIRST", 30):
        assert demand_equal(path) > 100
        document = page_of(path, 0)[0]
    told = document["transactions"]
    (trouble,) = document["verdict"]["troubles"]
    assert "7 times" in trouble["text"]
    assert (trouble["cases_of"], len(trouble["cases"])) == (7, 5)
    beside = told["rows"][30:]
    assert told["beside_pauses"] == len(beside) == 10
    values = [told["texts"][row[5]] for row in beside]
    assert values == [str(50 * part + at) for part in range(3, 8) for at in (-1, 0)]
    begins = {told["begin_us"] + row[1] for row in beside[::2]}
    assert begins == {at_us for at_us, _ in trouble["cases"]}


@pytest.mark.parametrize(
    "limit",
    [
        (values, "MAX_POLLS", 5), (values, "MAX_OF_POLL", 2), (account, "MAX_UNITS", 3),
    ],
    ids=str,
)  # fmt: skip
def test_limits_that_are_reached_give_the_same_page(
    limit: tuple[object, str, int], tmp_path: Path
) -> None:
    path = tmp_path / "polls.pcap"
    path.write_bytes(mixed_polls(4))
    with patch.object(*limit):
        assert demand_equal(path) > 100


@pytest.mark.parametrize("frames", [clean, dirty], ids=lambda one: one.__name__)
def test_the_page_of_steady_polling_is_the_same_both_ways(
    frames: Callable[[int, random.Random], Iterator[tuple[bytes, int]]], tmp_path: Path
) -> None:
    made = make_capture(tmp_path / "polls.pcap", frames, 2000)
    assert demand_equal(made.path) > 300


@pytest.mark.parametrize("number", [0, 12, 36])
def test_the_page_of_a_simulated_plant_is_the_same_both_ways(number: int, tmp_path: Path) -> None:
    path = tmp_path / "plant.pcap"
    path.write_bytes(generated(number, requests=100))
    demand_equal(path)


def test_the_page_of_a_cut_capture_is_the_same_both_ways(tmp_path: Path) -> None:
    path = tmp_path / "polls.pcap"
    path.write_bytes(mixed_polls(5)[:-20])
    assert demand_equal(path) > 100
