from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
from hypothesis import example, given
from hypothesis import strategies as st

from mbtool.devices.assignment import Assignment, Assignments, Who
from mbtool.devices.loading import load_profile
from mbtool.devices.model import FunctionRule, Point
from mbtool.devices.naming import _MAX_CACHED, _MAX_CACHED_POINTS, Namer
from mbtool.devices.wording import describe, describe_points
from mbtool.modbus.adu import Transport, Verdict, mbap_adu
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome, Transaction
from tests.devices.transactions import transaction

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction


def _namer(device: str) -> Namer:
    return Namer(Assignments([Assignment(Who(), load_profile(device))]))


AT1M8X = _namer("fa3-at1m8x")
FT1A = _namer("idec-ft1a-touch")


def _texts(named: NamedTransaction) -> dict[str, str]:
    return {point.reference: point.text for point in named.points}


def test_without_a_profile_only_the_reference_is_named() -> None:
    named = Namer().name(transaction(3, 107, quantity=3, response_values=[1, 2, 3]))
    assert named.reference == "holding 107..109"
    assert named.device is None
    assert named.points == []
    assert named.findings == []


def test_all_of_the_transaction_is_kept() -> None:
    plain = transaction(3, 0, quantity=1, response_values=[5], latency_ns=7, source="10.0.0.1:9")
    named = FT1A.name(plain)
    for field in plain.__struct_fields__:
        assert getattr(named, field) == getattr(plain, field)


def test_read_brings_the_points_of_the_response() -> None:
    named = AT1M8X.name(transaction(4, 1, quantity=2, response_values=[0x0E30, 0xFFFF]))
    assert _texts(named) == {"RWr1": "0E30H alive check error", "RWr2": "-1"}


def test_read_without_an_answer_has_no_points() -> None:
    named = AT1M8X.name(transaction(4, 2, quantity=8, outcome=Outcome.NO_ANSWER))
    assert named.reference == "RWr2..RWr9"
    assert named.points == []


def test_a_refused_write_has_the_points_of_its_request() -> None:
    named = AT1M8X.name(
        transaction(
            6, 0x102, quantity=1, request_values=[0xFE], outcome=Outcome.EXCEPTION, exception=3
        )
    )
    assert _texts(named) == {"0102H": "CH1 enabled"}
    assert not named.took_effect


def test_registers_without_a_name_beside_named_ones_are_named_by_reference() -> None:
    named = AT1M8X.name(transaction(3, 0xF4, quantity=4, response_values=[3, 30, 7, 8]))
    assert _texts(named) == {"00F4H": "3 times", "00F5H": "30 s", "00F6H": "7", "00F7H": "8"}
    assert describe(named).endswith("; 00F6H 7, 00F7H 8")


def test_a_range_without_any_names_has_no_points() -> None:
    assert AT1M8X.name(transaction(3, 0xF6, quantity=2, response_values=[7, 8])).points == []


def test_a_short_response_has_the_points_that_it_contains() -> None:
    named = AT1M8X.name(transaction(4, 2, quantity=8, response_values=[7, 8]))
    assert list(_texts(named)) == ["RWr2", "RWr3"]


def test_padding_bits_of_a_response_are_no_points() -> None:
    named = AT1M8X.name(transaction(2, 0x10, quantity=3, response_values=[1, 0, 1, 0, 0, 0, 0, 0]))
    assert list(_texts(named)) == ["X10", "X11", "X12"]


def test_function_17h_names_what_it_reads_and_what_it_writes() -> None:
    named = AT1M8X.name(
        transaction(
            0x17,
            0xF2,
            quantity=2,
            write_address=0x102,
            request_values=[0xFE],
            response_values=[600, 10],
        )
    )
    assert named.reference == "00F2H..00F3H, write 0102H"
    assert _texts(named) == {"0102H": "CH1 enabled", "00F2H": "600 s", "00F3H": "10 s"}
    assert [point.written for point in named.points] == [True, False, False]
    assert describe(named) == (
        "00F2H..00F3H, write 0102H A/D conversion enable/disable setting: CH1 enabled; "
        f"read {'; '.join(describe_points(named.points[1:]))}"
    )
    assert named.findings == ["FA3-F23"]


def test_points_read_by_17h_are_not_marked_as_written() -> None:
    named = _namer("wago-750").name(
        transaction(
            0x17,
            0x1000,
            quantity=2,
            write_address=3,
            request_values=[0x123],
            response_values=[100, 255],
        )
    )
    assert [(point.reference, point.written) for point in named.points] == [
        ("0x1000", False),
        ("0x1001", False),
    ]
    assert describe(named).startswith("0x1000..0x1001, write %QW3; read Watchdog time: ")
    assert (named.written_points, named.read_points) == ([], named.points)


def test_points_of_other_functions_are_never_marked_as_written() -> None:
    wrote = AT1M8X.name(transaction(6, 0x102, quantity=1, request_values=[0xFE]))
    read = AT1M8X.name(transaction(3, 0x102, quantity=1, response_values=[0xFE]))
    assert (wrote.written_points, wrote.read_points) == (wrote.points, [])
    assert (read.written_points, read.read_points) == ([], read.points)
    assert not wrote.points[0].written


def test_ranges_are_checked_only_for_values_that_17h_writes() -> None:
    profile = load_profile("idec-ft1a-touch")
    level = Point(name="Level", table=Table.HOLDING_REGISTERS, address=0, maximum=9)
    wide = msgspec.structs.replace(
        profile, points=[level], functions=profile.functions | {"17": FunctionRule()}
    )
    namer = Namer(Assignments([Assignment(Who(), wide)]))

    def findings(write_address: int, asked: list[int], brought: int) -> list[str]:
        one = transaction(
            0x17,
            0,
            quantity=1,
            write_address=write_address,
            request_values=asked,
            response_values=[brought],
        )
        return namer.name(one).findings

    assert findings(5, [1], 99) == []
    assert findings(0, [99], 9) == ["FT1A-V23"]
    assert findings(0, [], 99) == ["MB-104"]


def test_a_read_from_the_beginning_of_a_block_names_only_the_block() -> None:
    wago = _namer("wago-750")

    def names(address: int, quantity: int) -> list[str]:
        read = transaction(3, address, quantity=quantity, response_values=[0] * quantity)
        return [point.name for point in wago.name(read).points]

    statistics = names(0x1029, 9)
    assert statistics[0] == "SlaveDeviceFailure statistics"
    assert statistics[8] == "ModTcpMessageCounter statistics"  # At 1031, where the MAC-ID is.
    assert names(0x1031, 3) == [f"{n}. word of the MAC-ID" for n in (1, 2, 3)]
    assert names(0x1028, 2) == ["Boot configuration", "0x1029"]
    assert names(0x102A, 1) == ["TCP connections"]
    cleared = wago.name(transaction(6, 0x1029, quantity=1, request_values=[0x55AA]))
    assert [(point.name, point.text) for point in cleared.points] == [
        ("Clear statistics", "55AAH clear")
    ]
    assert names(0x2020, 16) == ["Short description"]
    assert names(0x2020, 15) == []  # Not whole, and no compile time either, which is at 2021.
    assert names(0x2021, 8) == ["Compile time of the firmware"]
    assert names(0x2030, 65) == [f"{n}. module" for n in range(65)]


def test_masks_are_not_values() -> None:
    named = AT1M8X.name(transaction(0x16, 0x102, request_values=[0xF2, 0x25]))
    assert named.reference == "0102H"
    assert named.points == []


def test_function_of_the_makers_own_has_his_name() -> None:
    named = AT1M8X.name(
        transaction(
            0x42,
            transport=Transport.TCP,
            response_raw=bytes.fromhex("0000 0000 0004 00 42 0017"),
        )
    )
    assert named.function_name == "read model name"
    assert [(point.name, point.text) for point in named.points] == [("Model code", "FA3-AT1M8Y")]


def test_a_response_of_another_length_has_no_point() -> None:
    for raw in (b"", bytes.fromhex("0000 0000 0005 00 42 001700")):
        named = AT1M8X.name(transaction(0x42, transport=Transport.TCP, response_raw=raw))
        assert named.points == []


def test_a_reported_identity_needs_no_profile() -> None:
    raw = mbap_adu(1, 1, bytes.fromhex("2B 0E 01 01 00 00 02 00 04") + b"Acme" + b"\x01\x02P7")
    named = Namer().name(transaction(0x2B, transport=Transport.TCP, response_raw=raw))
    assert [(point.name, point.text) for point in named.points] == [
        ("vendor", "Acme"),
        ("product code", "P7"),
    ]


def test_findings_of_request_and_exception_stand_together() -> None:
    named = FT1A.name(
        transaction(
            0x10,
            0,
            quantity=110,
            request_values=[0] * 110,
            exception=3,
            outcome=Outcome.EXCEPTION,
        )
    )
    assert named.reference == "HR400001..400110"
    assert named.findings == ["FT1A-Q16", "FT1A-E3"]


def test_two_devices_are_told_apart() -> None:
    namer = Namer(
        Assignments(
            [
                Assignment(Who(unit=1), load_profile("fa3-at1m8x")),
                Assignment(Who(unit=2), load_profile("fa3-at1m8y")),
            ]
        )
    )
    names = [
        namer.name(transaction(6, 0x102, unit=unit, request_values=[0])).points[0].name
        for unit in (1, 2)
    ]
    assert names == [
        "A/D conversion enable/disable setting",
        "D/A conversion enable/disable setting",
    ]


_WORDS = st.none() | st.lists(st.integers(-1, 0x10000), max_size=9)
_NUMBERS = st.none() | st.integers(0, 0xFFFF) | st.integers(0xF0, 0x110)


@given(
    device=st.sampled_from(["fa3-at1m8x", "fa3-th1m16xc", "idec-ft1a-touch"]),
    function=st.integers(0, 0x7F),
    fields=st.fixed_dictionaries(
        {
            "address": _NUMBERS,
            "quantity": _NUMBERS,
            "write_address": _NUMBERS,
            "request_values": _WORDS,
            "response_values": _WORDS,
            "exception": st.none() | st.integers(0, 0xFF),
            "transport": st.sampled_from(list(Transport)),
            "response_raw": st.none() | st.binary(max_size=12),
        }
    ),
)
def test_never_raises(device: str, function: int, fields: dict[str, Any]) -> None:
    named = _namer(device).name(transaction(function, **fields))
    assert named.device == device


_POLLS = st.builds(
    transaction,
    st.sampled_from([1, 2, 3, 4, 5, 6, 0x0F, 0x10, 0x16, 0x17, 0x42]),
    st.none() | st.sampled_from([0, 1, 2, 0x10, 0xF2, 0x102, 0xFFFF]),
    quantity=st.none() | st.integers(0, 9),
    write_address=st.none() | st.integers(0x100, 0x103),
    request_values=_WORDS,
    response_values=_WORDS,
    exception=st.none() | st.integers(1, 12),
    outcome=st.sampled_from(list(Outcome)),
    verdicts=st.lists(st.sampled_from(list(Verdict)), max_size=2),
    transport=st.sampled_from(list(Transport)),
)


@given(
    device=st.sampled_from(["fa3-at1m8x", "idec-ft1a-touch", "chino-lt830"]),
    polls=st.lists(_POLLS, max_size=8),
)
@example(  # No wire carries a read with a place to write to; what it writes counts all the same.
    device="fa3-at1m8x",
    polls=[transaction(1, 0, write_address=256, request_values=words) for words in (None, [0])],
)
def test_earlier_transactions_do_not_change_a_name(device: str, polls: list[Transaction]) -> None:
    namer = _namer(device)
    for poll in polls:
        assert namer.name(poll) == _namer(device).name(poll)


@given(_POLLS)
def test_a_transaction_that_is_named_is_named_anew(poll: Transaction) -> None:
    logged = Namer().name(poll)
    assert AT1M8X.rename(logged) == AT1M8X.name(logged) == AT1M8X.name(poll)
    assert Namer().name(AT1M8X.name(logged)).points == logged.points


def test_renaming_without_an_assignment_changes_nothing() -> None:
    logged = AT1M8X.name(transaction(4, 1, quantity=1, response_values=[7]))
    assert Namer().rename(logged) is logged
    assert Namer().name(logged).device is None


def test_memory_is_bounded() -> None:
    namer = _namer("fa3-at1m8x")
    for address in range(_MAX_CACHED + 10):
        namer.name(transaction(3, address, quantity=1))
    for vocabulary in namer._vocabularies.values():
        assert len(vocabulary._cache) <= _MAX_CACHED


def test_an_exception_has_the_devices_name_for_it() -> None:
    refused = transaction(6, 205, quantity=1, exception=0x11, exception_name="exception 11H")
    assert _namer("chino-lt830").name(refused).exception_name == "value out of setting range"
    assert _namer("fa3-at1m8x").name(refused).exception_name != "value out of setting range"


def test_what_is_kept_of_many_different_requests_is_bounded() -> None:
    namer = _namer("fa3-at1m8x")
    for address in range(400):
        namer.name(transaction(1, address, quantity=60_000, outcome=Outcome.EXCEPTION))
        namer.name(transaction(2, address % 300, quantity=2000 - address // 300))
    vocabulary = [*namer._vocabularies.values()][-1]
    kept = sum(len(one.read) + len(one.written) for one in vocabulary._cache.values())
    assert kept == vocabulary._cached_points < _MAX_CACHED_POINTS + 2000
