"""The recorded slave, by script."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.modbus import (
    Response,
    Table,
    Transport,
    parse_pdu,
    register_access,
    response_to,
    rtu_adu,
    values_after,
)
from mbtool.modbus.response import wire_pieces
from mbtool.replay.matching import MatchStrategy, OnEnd
from mbtool.replay.player import OnMiss, RecordedSlave
from mbtool.replay.recording import Recording
from mbtool.replay.steering import Control
from mbtool.replay.timeline import TimeRange
from tests.replay.recorded import LATENCY_NS, MS, answered, to_all, unanswered

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

READ = "03 0000 0001"
SILENCE = None
BEGIN = 1_700_000_000_000_000_000


def _slave(*transactions: Transaction, on_miss: OnMiss = OnMiss.IMAGE) -> RecordedSlave:
    return RecordedSlave(Recording.of(transactions), on_miss=on_miss)


def _ask(slave: RecordedSlave, request: str, unit: int = 1) -> str | None:
    answer = slave.respond(unit, bytes.fromhex(request), 0)
    return None if answer is None else answer.pdu.hex(" ")


def test_values_that_change_come_in_order_and_the_last_one_stays() -> None:
    slave = _slave(
        answered(0, READ, "03 02 0001"),
        answered(100, READ, "03 02 0002"),
        answered(200, READ, "03 02 0003"),
    )
    answers = [_ask(slave, READ) for _ in range(5)]
    assert answers == [f"03 02 00 0{number}" for number in (1, 2, 3, 3, 3)]


def test_each_request_has_its_own_sequence() -> None:
    slave = _slave(
        answered(0, READ, "03 02 0001"),
        answered(100, READ, "03 02 0002", unit=2),
        answered(200, "03 0005 0001", "03 02 0003"),
        answered(300, READ, "03 02 0004"),
    )
    assert _ask(slave, READ, unit=2) == "03 02 00 02"
    assert _ask(slave, "03 0005 0001") == "03 02 00 03"
    assert _ask(slave, READ) == "03 02 00 01"
    assert _ask(slave, READ) == "03 02 00 04"


def test_writes_of_other_values_are_other_requests() -> None:
    slave = _slave(
        answered(0, "06 0000 0001", "06 0000 0001"), answered(100, "06 0000 0002", "86 04")
    )
    assert _ask(slave, "06 0000 0002") == "86 04"
    assert _ask(slave, "06 0000 0001") == "06 00 00 00 01"


@pytest.mark.parametrize("rare", ["03 02 0009", None])
def test_one_rare_request_moves_the_registers_only_until_the_next_response(
    rare: str | None,
) -> None:
    late = "03 00C8 0001"
    polls = [answered(100 * n, "03 0000 0004", "03 08" + f"{n:04X}" * 4) for n in range(31)]
    more = [answered(100 * n + 10, "03 0004 0002", f"03 04 {n:04X} {n:04X}") for n in range(31)]
    last = unanswered(3060, late) if rare is None else answered(3060, late, rare)
    slave = _slave(*polls, *more, last)
    assert _ask(slave, "03 0000 0004") == "03 08" + " 00 00" * 4
    assert _ask(slave, late) == (None if rare is None else "03 02 00 09")
    assert _ask(slave, "03 0000 0004") == "03 08" + " 00 01" * 4
    assert _ask(slave, "03 0000 0004") == "03 08" + " 00 02" * 4
    assert _ask(slave, "03 0000 0006") == "03 0c" + " 00 02" * 4 + " 00 01" * 2


def test_silence_does_not_move_the_registers() -> None:
    slave = _slave(
        answered(0, READ, "03 02 0001"),
        answered(100, READ, "03 02 0002"),
        answered(200, "03 0001 0001", "03 02 0007"),
        unanswered(300, "03 00C8 0001"),
    )
    assert _ask(slave, READ) == "03 02 00 01"
    assert _ask(slave, "03 00C8 0001") is SILENCE
    assert _ask(slave, "03 0000 0002") == "03 04 00 01 00 07"


def test_exceptions_and_silence_are_played_as_recorded() -> None:
    slave = _slave(
        answered(0, READ, "83 06"),
        unanswered(100, READ),
        answered(200, READ, "03 02 0001"),
    )
    assert [_ask(slave, READ) for _ in range(3)] == ["83 06", SILENCE, "03 02 00 01"]


def test_a_malformed_answer_is_played_as_recorded() -> None:
    slave = _slave(answered(0, "03 0000 0002", "03 02 0001"))
    assert _ask(slave, "03 0000 0002") == "03 02 00 01"


def test_silence_at_the_end_of_a_capture_is_not_repeated() -> None:
    slave = _slave(answered(0, READ, "03 02 0001"), unanswered(100, READ))
    assert [_ask(slave, READ) for _ in range(3)] == ["03 02 00 01", SILENCE, "03 02 00 01"]


@pytest.mark.parametrize("match", MatchStrategy)
@pytest.mark.parametrize("on_end", OnEnd)
def test_a_unit_that_never_answered_stays_silent(match: MatchStrategy, on_end: OnEnd) -> None:
    transactions = [
        unanswered(0, READ, unit=2),
        answered(5, READ, "03 02 0001"),
        to_all(9, "06 0000 0007"),
        unanswered(20, "06 0000 0001", unit=2),
    ]
    recording = Recording.of(transactions)
    slave = RecordedSlave(recording, match=match, on_end=on_end, devices={2: _Device()})
    for request in (READ, "06 0000 0001", "06 0000 0002", "03 0000 0002", "11", "03 0000 0000"):
        for _ in range(2):
            assert _ask(slave, request, unit=2) is SILENCE
    assert recording.units == {1}


def test_a_request_to_an_unknown_unit_gets_silence() -> None:
    slave = _slave(answered(0, READ, "03 02 0001"))
    assert _ask(slave, READ, unit=2) is SILENCE
    assert _ask(slave, "06 0000 0001", unit=0) is SILENCE


def test_a_broadcast_is_silent_and_changes_the_image() -> None:
    slave = _slave(answered(0, "03 0000 0002", "03 04 0001 0002"), to_all(100, "06 0000 0009"))
    assert _ask(slave, READ) == "03 02 00 01"
    assert _ask(slave, "06 0000 0009", unit=0) is SILENCE
    assert _ask(slave, READ) == "03 02 00 09"


# The register image ----------------------------------------------------------------------------


def test_part_of_a_recorded_range_is_answered() -> None:
    slave = _slave(answered(0, "03 0000 0004", "03 08 0001 0002 0003 0004"))
    assert _ask(slave, "03 0001 0002") == "03 04 00 02 00 03"


def test_several_recorded_ranges_are_answered_in_one() -> None:
    slave = _slave(
        answered(0, "03 0000 0002", "03 04 0001 0002"),
        answered(100, "03 0002 0001", "03 02 0003"),
        answered(200, "10 0003 0001 02 0004", "10 0003 0001"),
    )
    assert _ask(slave, "03 0000 0004") == "03 08 00 01 00 02 00 03 00 04"


def test_the_image_is_as_of_the_latest_answer_that_was_given() -> None:
    slave = _slave(
        answered(0, "03 0000 0002", "03 04 0001 0001"),
        answered(100, "03 0000 0002", "03 04 0002 0002"),
        answered(200, "04 0000 0001", "04 02 0000"),
        answered(300, "03 0000 0002", "03 04 0003 0003"),
    )
    assert _ask(slave, READ) == "03 02 00 01"  # The beginning.
    _ask(slave, "03 0000 0002")
    assert _ask(slave, READ) == "03 02 00 01"
    _ask(slave, "04 0000 0001")
    assert _ask(slave, READ) == "03 02 00 02"
    _ask(slave, "03 0000 0002")  # The one of 100 ms: the image does not go back.
    assert _ask(slave, READ) == "03 02 00 02"
    _ask(slave, "03 0000 0002")
    assert _ask(slave, READ) == "03 02 00 03"


def test_an_address_has_its_first_value_from_the_beginning() -> None:
    slave = _slave(
        answered(0, "03 0000 0001", "03 02 0001"), answered(900, "03 0001 0001", "03 02 0009")
    )
    assert _ask(slave, "03 0000 0002") == "03 04 00 01 00 09"


def test_bits_are_answered_too() -> None:
    slave = _slave(answered(0, "02 0000 000B", "02 02 21 03"))
    assert _ask(slave, "02 0005 0004") == "02 01 09"


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("03 0000 0002", "83 02"),  # 0001 was never seen
        ("04 0000 0001", "84 02"),  # nor was the table
        ("06 0001 0001", "86 02"),
        ("17 0000 0001 0001 0001 02 0001", "97 02"),
        ("03 0000 0000", "83 03"),
        ("03 0000 007E", "83 03"),
        ("03 0000", "83 03"),
        ("2B 0E 01 00", "ab 01"),
        ("42 00", "c2 01"),
    ],
)
def test_a_request_that_the_image_cannot_answer_gets_an_exception(
    request_: str, response: str
) -> None:
    assert _ask(_slave(answered(0, READ, "03 02 0001")), request_) == response


def test_a_write_never_seen_is_kept() -> None:
    slave = _slave(answered(0, "03 0000 0003", "03 06 0001 0002 0003"))
    assert _ask(slave, "06 0001 00AA") == "06 00 01 00 aa"
    assert _ask(slave, "10 0002 0001 02 00BB") == "10 00 02 00 01"
    assert _ask(slave, "16 0001 00F0 0005") == "16 00 01 00 f0 00 05"
    assert _ask(slave, "03 0001 0002") == "03 04 00 a5 00 bb"
    assert _ask(slave, "17 0000 0002 0000 0001 02 0077") == "17 04 00 77 00 a5"
    assert _ask(slave, "03 0000 0003") == "03 06 00 77 00 a5 00 bb"


def test_a_recorded_write_ends_a_live_one_and_a_recorded_change_does_not() -> None:
    slave = _slave(
        answered(0, "03 0000 0003", "03 06 0001 0001 0001"),
        answered(50, "06 0000 0002", "06 0000 0002"),
        answered(100, "03 0000 0003", "03 06 0002 0002 0002"),
    )
    assert _ask(slave, "03 0000 0003") == "03 06 00 01 00 01 00 01"
    _ask(slave, "10 0000 0001 02 00AA")
    _ask(slave, "10 0001 0001 02 00BB")
    assert _ask(slave, "03 0000 0002") == "03 04 00 aa 00 bb"
    for _ in range(3):
        assert _ask(slave, "03 0000 0003") == "03 06 00 02 00 bb 00 02"
        assert _ask(slave, "03 0000 0001") == "03 02 00 02"
        assert _ask(slave, "03 0001 0001") == "03 02 00 bb"


def test_a_repeated_last_answer_does_not_undo_a_write() -> None:
    slave = _slave(answered(0, "03 0000 0002", "03 04 0001 0001"), answered(9, READ, "03 02 0001"))
    for _ in range(2):
        _ask(slave, "03 0000 0002")
    _ask(slave, "06 0000 0009")
    for _ in range(3):
        assert _ask(slave, "03 0000 0002") == "03 04 00 09 00 01"
        assert _ask(slave, READ) == "03 02 00 09"


def test_a_command_that_the_device_takes_back_is_played_so() -> None:
    """The live master writes what the recorded one wrote, and the device answers as it did."""
    slave = _slave(
        answered(0, READ, "03 02 0000"),
        answered(100, "06 0000 0001", "06 0000 0001"),
        answered(200, READ, "03 02 0001"),
        answered(300, READ, "03 02 0000"),
    )
    assert _ask(slave, READ) == "03 02 00 00"
    _ask(slave, "06 0000 0001")
    assert [_ask(slave, READ) for _ in range(3)] == ["03 02 00 01", "03 02 00 00", "03 02 00 00"]


def test_an_answer_from_before_a_recorded_write_does_not_take_it_back() -> None:
    """A block and its first register, each with its own sequence of answers."""
    slave = _slave(
        answered(0, "03 0000 0002", "03 04 0001 0001"),
        answered(10, READ, "03 02 0001"),
        answered(20, "03 0000 0002", "03 04 0001 0001"),
        answered(100, "06 0000 0005", "06 0000 0005"),
        answered(200, READ, "03 02 0005"),
        answered(300, READ, "03 02 0006"),
    )
    _ask(slave, "06 0000 0009")
    reads = [_ask(slave, request) for request in (READ, READ, "03 0000 0002", READ, "03 0000 0002")]
    assert reads == [
        "03 02 00 09", "03 02 00 05", "03 04 00 05 00 01", "03 02 00 06", "03 04 00 06 00 01",
    ]  # fmt: skip


def test_a_live_write_outweighs_a_value_that_comes_later_in_the_recording() -> None:
    slave = _slave(
        answered(0, "04 0000 0001", "04 02 0000"), answered(900, "03 0000 0002", "03 04 0001 0002")
    )
    _ask(slave, "06 0000 00AA")
    assert _ask(slave, READ) == "03 02 00 aa"


def test_a_recorded_write_that_is_repeated_counts_again() -> None:
    slave = _slave(
        answered(0, "05 0000 FF00", "05 0000 FF00"), answered(100, "05 0000 0000", "05 0000 0000")
    )
    for value, read in (("FF00", "01"), ("0000", "00"), ("FF00", "01"), ("0000", "00")):
        _ask(slave, f"05 0000 {value}")
        assert _ask(slave, "01 0000 0001") == f"01 01 {read}"


def test_a_recorded_write_that_was_refused_changes_nothing() -> None:
    slave = _slave(
        answered(0, "03 0000 0002", "03 04 0001 0001"), answered(1, "06 0000 0009", "86 04")
    )
    _ask(slave, "06 0000 0009")
    assert _ask(slave, READ) == "03 02 00 01"


# Options ---------------------------------------------------------------------------------------


def test_a_miss_can_be_an_exception_or_silence() -> None:
    transactions = [answered(0, "03 0000 0002", "03 04 0001 0002")]
    refusing = _slave(*transactions, on_miss=OnMiss.EXCEPTION)
    assert _ask(refusing, READ) == "83 02"
    assert _ask(refusing, "2B 0E 01 00") == "ab 01"
    silent = _slave(*transactions, on_miss=OnMiss.SILENT)
    assert _ask(silent, READ) is SILENCE
    for slave in (refusing, silent):
        assert _ask(slave, "03 0000 0002") == "03 04 00 01 00 02"


@pytest.mark.parametrize(
    ("rate", "delay_ns"),
    [
        (Fraction(1), LATENCY_NS),
        (Fraction(2), LATENCY_NS // 2),
        (Fraction(1, 2), 10 * MS),
        (None, 0),
    ],
)
def test_the_rate_scales_the_recorded_latency(rate: Fraction | None, delay_ns: int) -> None:
    recording = Recording.of([answered(0, "03 0000 0002", "03 04 0001 0002")])
    slave = RecordedSlave(recording, rate=rate)
    recorded = slave.respond(1, bytes.fromhex("03 0000 0002"), 0)
    assert recorded == Response(bytes.fromhex("03 04 0001 0002"), delay_ns)
    from_image = slave.respond(1, bytes.fromhex(READ), 0)
    assert from_image == Response(bytes.fromhex("03 02 0001"), delay_ns)


@pytest.mark.parametrize("rate", [Fraction(0), Fraction(-1)])
def test_a_rate_must_be_above_0(rate: Fraction) -> None:
    with pytest.raises(ValueError, match="rate must be more than 0"):
        RecordedSlave(Recording(), rate=rate)


@pytest.mark.parametrize("match", [MatchStrategy.TIME, MatchStrategy.IMAGE])
def test_a_clock_without_a_rate_is_an_error(match: MatchStrategy) -> None:
    with pytest.raises(ValueError, match="needs a rate"):
        RecordedSlave(Recording(), match=match, rate=None)


def test_one_recording_can_be_played_twice() -> None:
    recording = Recording.of([answered(0, READ, "03 02 0001"), answered(9, READ, "03 02 0002")])
    for _ in range(2):
        slave = RecordedSlave(recording)
        assert [_ask(slave, READ) for _ in range(2)] == ["03 02 00 01", "03 02 00 02"]


# The clock -------------------------------------------------------------------------------------


def _at(slave: RecordedSlave, at_ms: float, request: str, unit: int = 1) -> str | None:
    answer = slave.respond(unit, bytes.fromhex(request), BEGIN + round(at_ms * MS))
    return None if answer is None else answer.pdu.hex(" ")


def _by_clock(match: MatchStrategy, **options: object) -> RecordedSlave:
    """Two registers that change after 100 and 300 ms of half a second."""
    transactions = [
        answered(at, "03 0000 0002", f"03 04 {value:04x} {value:04x}", latency_ns=0)
        for at, value in ((0, 1), (100, 2), (300, 3), (500, 3))
    ]
    return RecordedSlave(Recording.of(transactions), match=match, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("match", [MatchStrategy.TIME, MatchStrategy.IMAGE])
def test_the_clock_starts_with_the_first_request(match: MatchStrategy) -> None:
    slave = _by_clock(match)
    whole = "03 0000 0002"
    answers = [_at(slave, at, whole) for at in (5000, 5049, 5101, 5310, 9999)]
    assert answers == [f"03 04 00 0{value} 00 0{value}" for value in (1, 1, 2, 3, 3)]


def test_parts_come_from_the_image_at_the_clocks_moment() -> None:
    slave = _by_clock(MatchStrategy.IMAGE, rate=Fraction(2))
    values = [_at(slave, at, READ) for at in (0, 49, 50, 149, 150)]
    assert values == [f"03 02 00 0{value}" for value in (1, 1, 2, 2, 3)]


def test_a_write_lasts_until_the_recording_writes_there_also_in_a_later_lap() -> None:
    transactions = [
        answered(at, request, request if request[1] == "6" else "03 04 0001 0001", latency_ns=0)
        for at, request in ((0, "03 0000 0002"), (100, "06 0000 0002"), (500, "03 0000 0002"))
    ]
    recording = Recording.of(transactions)
    slave = RecordedSlave(recording, match=MatchStrategy.IMAGE, on_end=OnEnd.LOOP)
    _at(slave, 0, READ)
    _at(slave, 310, "10 0000 0002 04 0077 0078")
    both = "03 0000 0002"
    assert [_at(slave, at, both) for at in (320, 499, 501, 599)] == ["03 04 00 77 00 78"] * 4
    assert [_at(slave, at, both) for at in (601, 1700)] == ["03 04 00 02 00 78"] * 2
    assert slave.progress(BEGIN + 1700 * MS).lap == 3


def test_the_end_of_the_clock_can_be_silence() -> None:
    slave = _by_clock(MatchStrategy.IMAGE, on_end=OnEnd.SILENT)
    assert _at(slave, 0, READ) == "03 02 00 01"
    assert _at(slave, 501, READ) is SILENCE


def test_a_pause_stops_the_clock_and_a_step_goes_to_the_next_request() -> None:
    slave = _by_clock(MatchStrategy.IMAGE)
    _at(slave, 0, READ)
    slave.control(Control.PAUSE, BEGIN + 10 * MS)
    assert _at(slave, 9999, READ) == "03 02 00 01"
    for value in (2, 3, 3, 3):
        slave.control(Control.STEP, BEGIN + 9999 * MS)
        assert _at(slave, 9999, READ) == f"03 02 00 0{value}"
    progress = slave.progress(BEGIN + 9999 * MS)
    assert (progress.position_ns, progress.is_paused) == (500 * MS, True)


def test_a_step_after_the_last_request_begins_the_next_lap() -> None:
    transactions = [answered(at, READ, f"03 02 000{at}") for at in (1, 2, 3)]
    slave = RecordedSlave(Recording.of(transactions), match=MatchStrategy.TIME, on_end=OnEnd.LOOP)
    _at(slave, 0, READ)
    slave.control(Control.PAUSE, BEGIN)
    shown = []
    for _ in range(5):
        slave.control(Control.STEP, BEGIN)
        shown.append((_at(slave, 0, READ), slave.progress(BEGIN).lap))
    assert shown == [
        (f"03 02 00 0{at}", lap) for at, lap in ((2, 0), (3, 0), (1, 1), (2, 1), (3, 1))
    ]


def test_without_a_clock_a_pause_repeats_the_answer_and_a_step_plays_one() -> None:
    slave = _slave(*(answered(at, READ, f"03 02 000{at}") for at in range(5)))
    assert _ask(slave, READ) == "03 02 00 00"
    slave.control(Control.PAUSE, 0)
    assert [_ask(slave, READ) for _ in range(2)] == ["03 02 00 00"] * 2
    slave.control(Control.STEP, 0)
    assert [_ask(slave, READ) for _ in range(2)] == ["03 02 00 01"] * 2
    slave.control(Control.PAUSE, 0)
    assert _ask(slave, READ) == "03 02 00 02"


def test_faster_shortens_the_latencies() -> None:
    slave = _slave(answered(0, READ, "03 02 0001"))
    slave.control(Control.FASTER, 0)
    assert slave.respond(1, bytes.fromhex(READ), 0) == Response(
        b"\x03\x02\x00\x01", LATENCY_NS // 2
    )


def test_an_hour_drifts_less_than_a_millisecond() -> None:
    """A register that changes once, after an hour of recorded time; asked unevenly until then."""
    hour = 3_600_000
    slave = RecordedSlave(
        Recording.of(
            [answered(0, READ, "03 02 0001"), answered(hour, READ, "03 02 0002", latency_ns=0)]
        ),
        match=MatchStrategy.IMAGE,
        rate=Fraction(1, 3),
    )
    at_ns = 0
    while at_ns < 3 * (hour - 1) * MS:
        assert _at(slave, at_ns / MS, READ) == "03 02 00 01"
        at_ns += 700 * MS + at_ns % 977_777
    assert _at(slave, 3 * hour - 0.9, READ) == "03 02 00 01"
    assert _at(slave, 3 * hour + 0.9, READ) == "03 02 00 02"


def test_a_time_range_begins_with_the_values_of_that_time() -> None:
    transactions = [
        answered(0, "03 0000 0002", "03 04 0001 0001", latency_ns=0),
        answered(100, "06 0001 0005", "06 0001 0005", latency_ns=0),
        answered(200, "03 0000 0002", "03 04 0002 0005", latency_ns=0),
        answered(300, "03 0000 0002", "03 04 0003 0005", latency_ns=0),
    ]
    recording = Recording.of(transactions, TimeRange(150 * MS, 250 * MS))
    assert recording.length_ns == 100 * MS
    slave = RecordedSlave(recording)
    assert _ask(slave, "03 0001 0001") == "03 02 00 05"
    assert [_ask(slave, "03 0000 0002") for _ in range(2)] == ["03 04 00 02 00 05"] * 2


# What the recording does not know ---------------------------------------------------------------


class _Device:
    """Two registers behind those of a recording."""

    def __init__(self) -> None:
        self.values = {address: 0x70 + address for address in range(4)}

    def learn(self, table: Table, address: int, value: int) -> None:
        assert table is Table.HOLDING_REGISTERS
        self.values[address] = value

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        request = parse_pdu(pdu, Direction.REQUEST)
        reach = register_access(request)
        if reach is None:
            return None
        for address in reach.writes:
            self.values[address] = values_after(request, [0])[address - reach.writes.start]
        return Response(response_to(request, pdu, [self.values[each] for each in reach.reads]))


def test_a_device_answers_what_the_recording_does_not_know_and_only_that() -> None:
    recording = Recording.of([answered(0, "03 0000 0002", "03 04 0001 0002")])
    slave = RecordedSlave(recording, devices={1: _Device()})
    assert _ask(slave, READ) == "03 02 00 01"
    assert _ask(slave, "03 0001 0003") == "03 06 00 02 00 72 00 73"
    assert _ask(slave, "10 0001 0002 04 0011 0022") == "10 00 01 00 02"
    assert _ask(slave, "03 0001 0002") == "03 04 00 11 00 22"
    assert _ask(slave, "03 0001 0001") == "03 02 00 11"
    assert _ask(slave, "11") is SILENCE
    assert _ask(slave, READ, unit=2) is SILENCE
    assert slave.respond(1, bytes.fromhex("03 0002 0001"), 0) == Response(
        bytes.fromhex("03 02 0022"), LATENCY_NS
    )


def test_a_device_is_not_asked_where_a_miss_is_an_exception() -> None:
    recording = Recording.of([answered(0, READ, "03 02 0001")])
    slave = RecordedSlave(recording, on_miss=OnMiss.EXCEPTION, devices={1: _Device()})
    assert _ask(slave, "03 0002 0001") == "83 02"


def test_a_live_broadcast_writes_to_every_unit_of_a_line() -> None:
    transactions = [answered(0, "03 0000 0002", "03 04 0001 0002", unit=unit) for unit in (1, 2)]
    line = _slave(*transactions)
    network = RecordedSlave(Recording.of(transactions), transport=Transport.TCP)
    for slave, value in ((line, "99"), (network, "01")):
        assert _ask(slave, "06 0000 0099", unit=0) is SILENCE
        assert [_ask(slave, READ, unit) for unit in (1, 2)] == [f"03 02 00 {value}"] * 2


def test_damaged_responses_are_played_on_request() -> None:
    wrong = rtu_adu(1, b"\x03\x02\x00\x01")[:-1] + b"\x00"
    event = WireEvent(ts_ns=7 * MS, link="rs485", kind=EventKind.BAD_CHECK, message="", raw=wrong)
    recording = Recording.of([unanswered(0, READ)], events=[event])
    assert RecordedSlave(recording).respond(1, bytes.fromhex(READ), 0) is None
    slave = RecordedSlave(recording, with_damage=True)
    answer = slave.respond(1, bytes.fromhex(READ), 0)
    assert answer is not None
    assert answer.delay_ns == 7 * MS
    assert wire_pieces(answer, Transport.RTU, 1) == [(0, wrong)]
    network = RecordedSlave(recording, with_damage=True, transport=Transport.TCP)
    assert network.respond(1, bytes.fromhex(READ), 0) is None


def test_requests_that_are_not_in_the_recording_are_counted() -> None:
    slave = _slave(answered(0, "03 0000 0002", "03 04 0001 0002"))
    for request in ("03 0000 0002", READ, READ):
        _ask(slave, request)
    assert (slave.asked, slave.missed) == (3, 2)
    assert slave.progress(0).done == "3 asked, 1 as recorded"


# Properties ------------------------------------------------------------------------------------


@given(st.lists(st.binary(max_size=260), max_size=5), st.sampled_from(OnMiss))
def test_no_request_raises_an_error(requests: list[bytes], on_miss: OnMiss) -> None:
    slave = _slave(answered(0, "03 0000 0002", "03 04 0001 0002"), on_miss=on_miss)
    for request_ in requests:
        answer = slave.respond(1, request_, 0)
        if request_ and on_miss is not OnMiss.SILENT:
            assert answer is not None
            assert answer.pdu[0] & 0x7F == request_[0] & 0x7F
