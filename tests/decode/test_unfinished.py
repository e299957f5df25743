"""A capture may be cut anywhere: nobody is blamed for an answer that comes behind its end."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Connection, Direction, Endpoint, Quiet, SerialFormat
from mbtool.decode.connections import Bus, ConnectionDecoder
from mbtool.decode.decoder import Decoder
from mbtool.decode.unfinished import SLOWER, USUAL_NS
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Outcome, Transaction, Verdict, ascii_adu, mbap_adu, rtu_adu
from tests.adversary.judgement import decode
from tests.adversary.network import ALL_LOSSES, MASTERS, simulate
from tests.benchmarks.plants.catalog import PLANTS, record
from tests.benchmarks.plants.delivery import Adapter, delivered
from tests.columns.both_ways import differences
from tests.packets.building import pcap
from tests.workflows.evidence import LINE, MS, READ, START_NS, exchange, heard

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mbtool.decode.connections import Decoded
    from tests.benchmarks.adapters import Read

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
SECOND = 1000 * MS
FORMAT = SerialFormat(19200)
ANSWER = bytes.fromhex("03 02 022B")
CONNECTION = Connection(Endpoint("10.0.0.1", 40000), Endpoint("10.0.0.9", 502))


def outcomes(decoded: Iterable[object]) -> list[Outcome]:
    return [one.outcome for one in decoded if isinstance(one, Transaction | NamedTransaction)]


def asked(number: int) -> bytes:
    return mbap_adu(number, 5, bytes.fromhex("03 006B 0001"))


def polled(latency_ns: int) -> tuple[ConnectionDecoder, int]:
    """A connection with one answered request and an open one, and when that was sent."""
    talk = ConnectionDecoder(CONNECTION)
    talk.feed(REQUEST, asked(1), 0)
    talk.feed(RESPONSE, mbap_adu(1, 5, ANSWER), latency_ns)
    talk.feed(REQUEST, asked(2), latency_ns + MS)
    return talk, latency_ns + MS


@pytest.mark.parametrize(
    ("latency_ns", "allowed_ns"),
    [(5 * MS, USUAL_NS), (2 * SECOND, SLOWER * 2 * SECOND)],
    ids=["fast", "slow"],
)
def test_a_request_that_waited_less_than_a_response_may_take_is_not_captured(
    latency_ns: int, allowed_ns: int
) -> None:
    talk, sent_ns = polled(latency_ns)
    (last,) = [one for one in talk.close(sent_ns + allowed_ns - 1) if isinstance(one, Transaction)]
    assert (last.outcome, last.verdicts) == (Outcome.NOT_CAPTURED, [Verdict.CAPTURE_END])
    talk, sent_ns = polled(latency_ns)
    assert outcomes(talk.close(sent_ns + allowed_ns)) == [Outcome.NO_ANSWER]


def test_a_request_of_a_connection_that_ended_has_no_answer() -> None:
    talk, _ = polled(5 * MS)
    assert outcomes(talk.close()) == [Outcome.NO_ANSWER]


def test_a_request_that_its_master_gave_up_had_no_answer_if_the_usual_time_is_over() -> None:
    talk, sent_ns = polled(2 * SECOND)
    talk.feed(REQUEST, asked(2), sent_ns + SECOND)  # The same again.
    found = outcomes(talk.close(sent_ns + SECOND + MS))
    assert found == [Outcome.NO_ANSWER, Outcome.NOT_CAPTURED]


@pytest.mark.parametrize("frame", [rtu_adu(1, READ), ascii_adu(1, READ)], ids=["rtu", "ascii"])
@pytest.mark.parametrize(
    ("silence_ns", "outcome"), [(0, Outcome.NOT_CAPTURED), (2 * SECOND, Outcome.NO_ANSWER)]
)
def test_a_silence_at_the_end_of_a_line_tells_that_nobody_answered(
    frame: bytes, silence_ns: int, outcome: Outcome
) -> None:
    bus = Bus("line", FORMAT, ascii=frame.startswith(b":"))
    decoded = bus.feed(frame, START_NS) + bus.advance(START_NS + silence_ns)
    assert outcomes(decoded + bus.close(START_NS + silence_ns)) == [outcome]


def test_a_live_line_that_is_ended_soon_after_a_request_blames_nobody() -> None:
    decoder = Decoder(Namer(), lines={LINE.name: LINE})
    records = [one for chunk in [*exchange(0), heard(100, READ)] for one in decoder.feed(chunk)]
    records += decoder.feed(Quiet(START_NS + 150 * MS, LINE.name))
    assert outcomes(records + decoder.close()) == [Outcome.OK, Outcome.NOT_CAPTURED]


def test_a_long_answer_that_is_cut_in_its_middle_has_begun_in_time() -> None:
    """At 1200 baud 250 bytes take 2.3 s."""
    line = SerialFormat(1200)
    answer = rtu_adu(1, bytes([3, 244, *range(244)]))
    bus = Bus("line", line)
    decoded = bus.feed(rtu_adu(1, bytes.fromhex("03 0000 007A")), START_NS)
    for at, byte in enumerate(answer[:-5], 1):
        decoded += bus.feed(bytes([byte]), START_NS + 50 * MS + at * line.character_ns)
    end_ns = START_NS + 50 * MS + len(answer) * line.character_ns
    assert outcomes(decoded + bus.close(end_ns)) == [Outcome.NOT_CAPTURED]


@pytest.mark.parametrize("master", MASTERS)
def test_no_answer_behind_the_end_of_a_network_capture_is_missed(master: str) -> None:
    for losses in ALL_LOSSES[:9]:
        packets = simulate(master, losses, seed=3, requests=40).packets
        whole = answered(decode(packets))
        for cut in Random(f"{master} {losses}").sample(range(1, len(packets)), 5):
            for one in unanswered(decode(packets[:cut])):
                response_ns = whole.get(one, 0)
                is_in_time = response_ns - one[0] <= USUAL_NS
                assert not (is_in_time and response_ns > packets[cut - 1].ts_ns), losses


@pytest.mark.parametrize("master", ["constant 3", "pipelined counting"])
def test_a_cut_capture_is_the_same_read_as_arrays(master: str) -> None:
    packets = simulate(master, (), seed=4, requests=60).packets
    for cut in range(20, len(packets), 40):
        assert differences(pcap(packets[:cut])) == []


@pytest.mark.parametrize("adapter", [Adapter.EXACT, Adapter.BURST_62, Adapter.NO_TIMES])
@pytest.mark.parametrize("plant", PLANTS)
def test_no_answer_behind_the_end_of_a_line_is_missed(plant: str, adapter: Adapter) -> None:
    recording = record(plant, 5, 30)
    reads = delivered(recording, adapter)
    is_timed = adapter is not Adapter.NO_TIMES
    whole = answered(heard_of(recording.line, reads, timed=is_timed))
    size = sum(len(data) for data, _ in reads)
    for cut in Random(f"{plant} {adapter}").sample(range(1, size), 4):
        part = beginning(reads, cut)
        for one in unanswered(heard_of(recording.line, part, timed=is_timed)):
            assert whole.get(one, 0) <= part[-1][1]


def heard_of(line: SerialFormat, reads: Sequence[Read], *, timed: bool) -> list[Transaction]:
    bus = Bus("line", line, timed=timed)
    decoded: list[Decoded] = [one for data, ts_ns in reads for one in bus.feed(data, ts_ns)]
    decoded += bus.close(reads[-1][1])
    return [one for one in decoded if isinstance(one, Transaction)]


def beginning(reads: Sequence[Read], size: int) -> list[Read]:
    part: list[Read] = []
    for data, ts_ns in reads:
        if size > 0:
            part.append((data[:size], ts_ns))
        size -= len(data)
    return part


def answered(
    found: Sequence[Transaction | NamedTransaction],
) -> dict[tuple[int, bytes | None], int]:
    """When each request was answered, by its time and bytes."""
    return {
        (one.request_ns, one.request_raw): one.response_ns
        for one in found
        if one.request_ns is not None and one.response_ns is not None
    }


def unanswered(
    found: Sequence[Transaction | NamedTransaction],
) -> list[tuple[int, bytes | None]]:
    """The requests that are told as not answered."""
    return [
        (one.request_ns, one.request_raw)
        for one in found
        if one.outcome is Outcome.NO_ANSWER and one.request_ns is not None
    ]
