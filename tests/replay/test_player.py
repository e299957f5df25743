"""The recorded slave, by script."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus import Answer, encode_pdu
from mbtool.replay import OnMiss, RecordedSlave, Recording
from tests.replay.recorded import LATENCY_NS, MS, answered, to_all, unanswered

if TYPE_CHECKING:
    from mbtool.modbus import Transaction

READ = "03 0000 0001"
SILENCE = None


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


def test_silence_at_the_end_of_a_capture_does_not_last() -> None:
    slave = _slave(answered(0, READ, "03 02 0001"), unanswered(100, READ))
    assert [_ask(slave, READ) for _ in range(3)] == ["03 02 00 01", SILENCE, "03 02 00 01"]


def test_what_was_never_answered_stays_silent() -> None:
    slave = _slave(unanswered(0, READ))
    assert [_ask(slave, READ) for _ in range(2)] == [SILENCE, SILENCE]


def test_another_units_request_gets_silence() -> None:
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


def test_an_address_seen_later_holds_its_first_value() -> None:
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
def test_what_the_image_cannot_answer_gets_an_exception(request_: str, response: str) -> None:
    assert _ask(_slave(answered(0, READ, "03 02 0001")), request_) == response


def test_a_write_never_seen_is_kept() -> None:
    slave = _slave(answered(0, "03 0000 0003", "03 06 0001 0002 0003"))
    assert _ask(slave, "06 0001 00AA") == "06 00 01 00 aa"
    assert _ask(slave, "10 0002 0001 02 00BB") == "10 00 02 00 01"
    assert _ask(slave, "16 0001 00F0 0005") == "16 00 01 00 f0 00 05"
    assert _ask(slave, "03 0001 0002") == "03 04 00 a5 00 bb"
    assert _ask(slave, "17 0000 0002 0000 0001 02 0077") == "17 04 00 77 00 a5"
    # The recorded answer stays as it was.
    assert _ask(slave, "03 0000 0003") == "03 06 00 01 00 02 00 03"


def test_a_change_in_the_recording_ends_a_live_write() -> None:
    slave = _slave(
        answered(0, "03 0000 0002", "03 04 0001 0001"),
        answered(100, "03 0000 0002", "03 04 0002 0001"),
    )
    _ask(slave, "03 0000 0002")
    _ask(slave, "10 0000 0001 02 00AA")
    _ask(slave, "10 0001 0001 02 00BB")
    _ask(slave, "03 0000 0002")
    assert _ask(slave, "03 0000 0001") == "03 02 00 02"
    assert _ask(slave, "03 0001 0001") == "03 02 00 bb"  # There nothing changed.


def test_a_live_write_counts_where_the_recording_has_not_come_yet() -> None:
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
    ("speed", "delay_ns"), [(1.0, LATENCY_NS), (2.0, LATENCY_NS // 2), (0.5, 10 * MS), (None, 0)]
)
def test_speed_scales_the_recorded_latency(speed: float | None, delay_ns: int) -> None:
    recording = Recording.of([answered(0, "03 0000 0002", "03 04 0001 0002")])
    slave = RecordedSlave(recording, speed=speed)
    recorded = slave.respond(1, bytes.fromhex("03 0000 0002"), 0)
    assert recorded == Answer(bytes.fromhex("03 04 0001 0002"), delay_ns)
    from_image = slave.respond(1, bytes.fromhex(READ), 0)
    assert from_image == Answer(bytes.fromhex("03 02 0001"), delay_ns)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed must be more than 0"):
        RecordedSlave(Recording(), speed=speed)


def test_one_recording_can_be_played_twice() -> None:
    recording = Recording.of([answered(0, READ, "03 02 0001"), answered(9, READ, "03 02 0002")])
    for _ in range(2):
        slave = RecordedSlave(recording)
        assert [_ask(slave, READ) for _ in range(2)] == ["03 02 00 01", "03 02 00 02"]


# Properties ------------------------------------------------------------------------------------

_ADDRESSES = 8


def _registers(values: list[int]) -> bytes:
    return encode_pdu(0x03, Direction.RESPONSE, values=tuple(values))


def _read(address: int, quantity: int) -> bytes:
    return encode_pdu(0x03, Direction.REQUEST, address=address, quantity=quantity)


@given(
    st.lists(st.lists(st.integers(0, 3), min_size=_ADDRESSES, max_size=_ADDRESSES), min_size=1),
    st.lists(
        st.one_of(
            st.none(),
            st.tuples(st.integers(0, _ADDRESSES - 1), st.integers(4, 9)),
        ),
        max_size=20,
    ),
)
def test_the_image_is_a_dictionary_that_the_recording_and_the_master_write(
    polls: list[list[int]], steps: list[tuple[int, int] | None]
) -> None:
    """One recorded poll of all addresses; live polls and live writes in any order."""
    whole = _read(0, _ADDRESSES).hex()
    slave = _slave(
        *(answered(at * 100, whole, _registers(row).hex()) for at, row in enumerate(polls))
    )
    model = dict(enumerate(polls[0]))
    recorded = dict(model)
    played = 0
    for step in steps:
        if step is None:
            _ask(slave, whole)
            row = polls[min(played, len(polls) - 1)]
            played += 1
            model.update({at: value for at, value in enumerate(row) if recorded[at] != value})
            recorded = dict(enumerate(row))
        else:
            address, value = step
            _ask(slave, f"06 {address:04x} {value:04x}")
            model[address] = value
        read = slave.respond(1, _read(0, _ADDRESSES - 1), 0)
        assert read == Answer(_registers([model[at] for at in range(_ADDRESSES - 1)]), LATENCY_NS)


@given(st.lists(st.binary(max_size=260), max_size=5), st.sampled_from(OnMiss))
def test_answers_whatever_it_is_asked(requests: list[bytes], on_miss: OnMiss) -> None:
    slave = _slave(answered(0, "03 0000 0002", "03 04 0001 0002"), on_miss=on_miss)
    for request_ in requests:
        answer = slave.respond(1, request_, 0)
        if request_ and on_miss is not OnMiss.SILENT:
            assert answer is not None
            assert answer.pdu[0] & 0x7F == request_[0] & 0x7F
