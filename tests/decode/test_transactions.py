"""The record of a transaction, from its request and its response."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from mbtool.core import Direction, LinkAddresses, Origin
from mbtool.decode.transactions import (
    MAX_CACHED_REQUESTS,
    Ends,
    _request_facts,
    add_origins,
    broadcast,
    capture_ended,
    no_answer,
    response_not_captured,
    unsolicited,
    with_response,
)
from mbtool.modbus.adu import Adu, DirectionBy, Transport, Verdict
from mbtool.modbus.transaction import Outcome, Transaction

ENDS = Ends("rs485")


def adu(direction: Direction, pdu: str, at_ns: int, *verdicts: Verdict) -> Adu:
    data = bytes.fromhex(pdu)
    return Adu(
        start_ns=at_ns,
        end_ns=at_ns + 10,
        transport=Transport.RTU,
        direction=direction,
        direction_by=DirectionBy.FORM,
        confidence=0.9 if direction is Direction.REQUEST else 0.99,
        unit=5,
        pdu=data,
        raw=b"\x05" + data + b"\x00\x00",
        verdicts=verdicts,
    )


def request(pdu: str, *verdicts: Verdict) -> Adu:
    return adu(Direction.REQUEST, pdu, 100, *verdicts)


def response(pdu: str, *verdicts: Verdict) -> Adu:
    return adu(Direction.RESPONSE, pdu, 150, *verdicts)


def exchange(asked: str, told: str) -> Transaction:
    return with_response(ENDS, request(asked), response(told), 0, ())


@pytest.mark.parametrize(
    ("asked", "told", "fields"),
    [
        (
            "01 0013 0003", "01 01 FD",  # The rest of the byte is padding.
            {"address": 0x13, "quantity": 3, "response_values": [1, 0, 1]},
        ),
        (
            "03 006B 0002", "03 04 022B 0064",
            {"address": 0x6B, "quantity": 2, "response_values": [0x22B, 0x64]},
        ),
        (
            "05 00AC FF00", "05 00AC FF00",
            {"address": 0xAC, "quantity": 1, "request_values": [1]},
        ),
        (
            "05 00AC 0000", "05 00AC 0000",
            {"address": 0xAC, "quantity": 1, "request_values": [0]},
        ),
        (
            "06 0001 0003", "06 0001 0003",
            {"address": 1, "quantity": 1, "request_values": [3]},
        ),
        ("07", "07 6D", {"response_values": [0x6D]}),
        (
            "08 0000 A537", "08 0000 A537",
            {"sub_function": 0, "request_values": [0xA537], "response_values": [0xA537]},
        ),
        ("0B", "0B FFFF 0108", {"response_values": [0xFFFF, 0x108]}),
        ("11", "11 03 01 FF 00", {}),
        (
            "0F 0013 000A 02 CD01", "0F 0013 000A",
            {"address": 0x13, "quantity": 10, "request_values": [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]},
        ),
        (
            "10 0001 0002 04 000A 0102", "10 0001 0002",
            {"address": 1, "quantity": 2, "request_values": [10, 0x102]},
        ),
        (
            "16 0004 00F2 0025", "16 0004 00F2 0025",
            {"address": 4, "quantity": 1, "request_values": [0xF2, 0x25]},
        ),
        (
            "17 0003 0002 000E 0001 02 00FF", "17 04 00FE 0ACD",
            {
                "address": 3, "quantity": 2, "write_address": 14, "write_quantity": 1,
                "request_values": [0xFF], "response_values": [0xFE, 0xACD],
            },
        ),
        (
            "18 04DE", "18 0006 0002 01B8 1284",
            {"address": 0x4DE, "response_values": [0x1B8, 0x1284]},
        ),
        ("2B 0E 01 00", "2B 0E 01 01 00 00 01 00 01 41", {"sub_function": 0x0E}),
        ("41 00", "41 00 13", {}),
    ],
)  # fmt: skip
def test_transaction_says_what_was_asked_and_told(
    asked: str, told: str, fields: dict[str, Any]
) -> None:
    done = exchange(asked, told)
    names = (
        "address", "quantity", "write_address", "write_quantity", "request_values",
        "response_values", "sub_function",
    )  # fmt: skip
    assert {name: getattr(done, name) for name in names} == {**dict.fromkeys(names), **fields}
    assert (done.outcome, done.verdicts, done.exception) == (Outcome.OK, [], None)
    assert (done.request_ns, done.response_ns, done.latency_ns) == (110, 160, 40)
    assert (done.function, done.unit, done.link) == (bytes.fromhex(asked)[0], 5, "rs485")


def test_exception_response_has_a_name() -> None:
    done = exchange("03 006B 0002", "83 02")
    assert (done.outcome, done.function) == (Outcome.EXCEPTION, 3)
    assert (done.exception, done.exception_name) == (2, "illegal data address")
    assert (done.response_values, done.quantity, done.latency_ns) == (None, 2, 40)


def test_exception_response_that_is_too_long_is_noticed() -> None:
    done = exchange("03 006B 0002", "83 02 00")
    assert (done.outcome, done.verdicts) == (Outcome.EXCEPTION, [Verdict.MALFORMED_RESPONSE])


@pytest.mark.parametrize("told", ["03 02 0000", "03 04 0000 00", "03", "83"])
def test_response_of_another_form_is_malformed(told: str) -> None:
    done = exchange("03 006B 0002", told)
    assert (done.outcome, done.verdicts) == (Outcome.MALFORMED, [Verdict.MALFORMED_RESPONSE])
    assert done.response_raw == b"\x05" + bytes.fromhex(told) + b"\x00\x00"


def test_malformed_request_may_be_answered_well() -> None:
    done = exchange("10 0001 0001 04 000A 0102", "10 0001 0001")
    assert (done.outcome, done.verdicts) == (Outcome.OK, [Verdict.MALFORMED_REQUEST])
    assert done.request_values == [10, 0x102]


def test_coil_value_that_is_neither_on_nor_off_is_no_value() -> None:
    done = exchange("05 0001 1234", "05 0001 1234")
    assert (done.outcome, done.request_values) == (Outcome.OK, None)
    assert done.verdicts == [Verdict.MALFORMED_REQUEST]


def test_verdicts_of_both_frames_are_kept_once() -> None:
    done = with_response(
        ENDS,
        request("07", Verdict.GLUED),
        response("07 00", Verdict.SPLIT, Verdict.GLUED),
        2,
        (Verdict.OTHER_TRANSACTION_ID,),
    )
    assert done.verdicts == [Verdict.GLUED, Verdict.SPLIT, Verdict.OTHER_TRANSACTION_ID]
    assert (done.retries, done.confidence) == (2, 0.9)


def test_request_alone_has_no_response() -> None:
    for done, outcome in (
        (no_answer(ENDS, request("06 0001 0003"), 1), Outcome.NO_ANSWER),
        (broadcast(ENDS, request("06 0001 0003")), Outcome.BROADCAST),
    ):
        assert (done.outcome, done.address, done.request_values) == (outcome, 1, [3])
        assert (done.response_ns, done.response_raw, done.latency_ns) == (None, None, None)
        assert done.start_ns == 110
    assert no_answer(ENDS, request("06 0001"), 0).verdicts == [Verdict.MALFORMED_REQUEST]


def test_request_with_the_exception_bit_keeps_its_code() -> None:
    done = no_answer(ENDS, request("83 00"), 0)
    assert (done.function, done.function_name) == (0x83, "function 83H")


def test_response_alone_has_no_request() -> None:
    done = unsolicited(ENDS, response("10 0001 0002"))
    assert (done.outcome, done.address, done.quantity) == (Outcome.UNSOLICITED, 1, 2)
    assert (done.request_ns, done.request_raw, done.request_values) == (None, None, None)
    assert done.start_ns == 160
    assert unsolicited(ENDS, response("83 02")).exception_name == "illegal data address"
    assert unsolicited(ENDS, response("03 02")).verdicts == [Verdict.MALFORMED_RESPONSE]


def test_values_of_a_transaction_are_its_own() -> None:
    """The same request is read once, and what it says is given to each transaction anew."""
    write = "10 0001 0002 04 000A 0102"
    first = exchange(write, "10 0001 0002")
    assert first.request_values is not None
    first.request_values.append(7)
    assert exchange(write, "10 0001 0002").request_values == [10, 0x102]


def test_requests_remembered_are_bounded() -> None:
    for number in range(2 * MAX_CACHED_REQUESTS):
        assert exchange(f"06 0001 {number:04X}", "83 02").request_values == [number]
    assert _request_facts.cache_info().currsize == MAX_CACHED_REQUESTS


def cut(one: Adu, missing: int = 2) -> Adu:
    """The ADU as a capture has it that lacks its last bytes."""
    return replace(
        one,
        pdu=one.pdu[:-missing],
        raw=one.raw[:-missing],
        missing=missing,
        verdicts=(Verdict.CUT,),
    )


def test_a_transaction_of_which_the_capture_lacks_bytes_tells_the_rest() -> None:
    read, values = request("03 006B 0002"), response("03 04 022B 0064")
    done = with_response(ENDS, read, cut(values), 3, (Verdict.AMBIGUOUS,), 0.5)
    assert (done.outcome, done.verdicts) == (Outcome.NOT_CAPTURED, [Verdict.CUT, Verdict.AMBIGUOUS])
    assert (done.address, done.quantity, done.response_values) == (0x6B, 2, None)
    assert (done.request_ns, done.response_ns, done.latency_ns) == (110, 160, 40)
    assert (done.request_raw, done.response_raw) == (read.raw, cut(values).raw)
    assert (done.retries, done.confidence, done.exception) == (0, 0.5, None)
    done = with_response(ENDS, cut(request("06 0001 0003"), 1), response("86 02"), 0, ())
    assert (done.outcome, done.exception, done.address) == (Outcome.NOT_CAPTURED, 2, 1)
    assert (done.exception_name, done.request_values) == ("illegal data address", None)
    done = with_response(ENDS, cut(read), values, 0, ())
    assert done.response_values == [0x22B, 0x64]


def test_cut_adus_without_their_other_half_are_not_malformed() -> None:
    done = no_answer(ENDS, cut(request("10 0001 0002 04 000A 0102")), 0)
    assert (done.verdicts, done.request_values, done.quantity) == ([Verdict.CUT], None, 2)
    alone = unsolicited(ENDS, cut(response("03 04 022B 0064")))
    assert (alone.outcome, alone.verdicts) == (Outcome.NOT_CAPTURED, [Verdict.CUT])
    assert (alone.response_values, alone.function) == (None, 3)


@pytest.mark.parametrize("share", [0.3, 0.95])
def test_a_transaction_is_as_sure_as_the_least_sure_of_its_parts(share: float) -> None:
    asked, answered = request("07"), response("07 00")
    for one, other in ((asked, answered), (asked, cut(answered, 1))):
        done = with_response(ENDS, one, other, 0, (), share)
        assert done.confidence == min(share, 0.9)
        sure = replace(one, confidence=1.0)
        assert with_response(ENDS, sure, other, 0, ()).confidence == 0.99


@pytest.mark.parametrize(
    ("start_ns", "end_ns", "latency_ns"),
    [
        (110, 120, 0),
        (111, 120, 1),
        (105, 115, 0),  # One read brought the end of the one and the start of the other.
        (100, 110, 0),
        (99, 109, None),  # The clock was set back.
    ],
)
def test_latency_is_from_the_end_of_the_request_to_the_start_of_the_response(
    start_ns: int, end_ns: int, latency_ns: int | None
) -> None:
    answered = replace(response("07 00"), start_ns=start_ns, end_ns=end_ns)
    for one in (answered, cut(answered, 1)):
        assert with_response(ENDS, request("07"), one, 0, ()).latency_ns == latency_ns
        untimed = Ends("rs485", timed=False)
        assert with_response(untimed, request("07"), one, 0, ()).latency_ns is None


def test_a_request_alone_says_why_it_has_no_response() -> None:
    asked = request("07", Verdict.GLUED)
    lost, ended = response_not_captured(ENDS, asked), capture_ended(ENDS, asked)
    assert (lost.outcome, lost.verdicts) == (Outcome.NOT_CAPTURED, [Verdict.GLUED])
    assert (ended.outcome, ended.verdicts) == (
        Outcome.NOT_CAPTURED, [Verdict.GLUED, Verdict.CAPTURE_END],
    )  # fmt: skip
    others = broadcast(ENDS, asked), unsolicited(ENDS, response("07 00"))
    assert [one.retries for one in (lost, ended, *others)] == [0, 0, 0, 0]


THERE = LinkAddresses("00:01", "00:02", 7)
BACK = LinkAddresses("00:02", "00:01", 8)
MASTERS = {"source_mac": "00:01", "destination_mac": "00:02", "vlan": 7}


@pytest.mark.parametrize(
    ("asked", "answered", "fields"),
    [
        (
            Origin("a", 3, THERE), Origin("a", 4, BACK),
            {"file": "a", "request_packet": 3, "response_packet": 4, **MASTERS},
        ),
        (
            Origin("a", 3, THERE), Origin("b", 1, BACK),
            {
                "file": "a", "request_packet": 3, "response_file": "b", "response_packet": 1,
                **MASTERS,
            },
        ),
        (Origin("a", 3, THERE), None, {"file": "a", "request_packet": 3, **MASTERS}),
        (
            None, Origin("a", 4, BACK),
            {"file": "a", "response_packet": 4, **MASTERS, "vlan": 8},
        ),
        (
            # Only the response tells the slave's address.
            Origin("a", 3, LinkAddresses("00:01", None, 7)),
            Origin("a", 4, LinkAddresses("00:02", None, 8)),
            {
                "file": "a", "request_packet": 3, "response_packet": 4,
                "source_mac": "00:01", "destination_mac": "00:02", "vlan": 8,
            },
        ),
        (
            Origin("line.bin", 0, None, 0), Origin("line.bin", 0, None, 8),
            {"file": "line.bin", "request_offset": 0, "response_offset": 8},
        ),
        (Origin("", 0), Origin("", 0), {}),
    ],
)  # fmt: skip
def test_a_transaction_says_where_its_parts_stand_and_who_sent_them(
    asked: Origin | None, answered: Origin | None, fields: dict[str, Any]
) -> None:
    found: dict[str, Any] = {}
    add_origins(found, asked, answered)
    assert {name: value for name, value in found.items() if value is not None} == fields
    if asked is not None and answered is not None:
        one, other = (
            replace(request("07"), origin=asked),
            replace(response("07 00"), origin=answered),
        )
        done = with_response(ENDS, one, other, 0, ())
        assert {name: getattr(done, name) for name in fields} == fields
