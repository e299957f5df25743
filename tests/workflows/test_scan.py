"""A scan finds the units and areas that are there, and only reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import Direction
from mbtool.decode.transactions import Ends, no_answer, with_response
from mbtool.devices import Assignments, Namer, builtin_profiles, load_profile
from mbtool.master.other_master import NoPauseError
from mbtool.modbus import Adu, rtu_adu
from mbtool.modbus.adu import DirectionBy, Transport
from mbtool.modbus.tables import READS_OF_TABLE
from mbtool.slave.device import RegisterImage
from mbtool.slave.families import make_device
from mbtool.workflows.scan import FoundArea, Scan, ScanState, final_reads

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.devices import NamedTransaction

READ_ONLY = {1, 2, 3, 4, 8, 0x2B}
REFUSED = bytes.fromhex("83 02")
IDENTITY = bytes.fromhex("2b 0e 01 01 00 00 01 00 03 41 42 43")


class Units:
    """Units that answer a request PDU by a function each; keeps what they were asked."""

    def __init__(self, answers: dict[int, Callable[[bytes], bytes | None]]) -> None:
        self._answers = answers
        self._namer = Namer(Assignments([]))
        self.asked: list[tuple[int, bytes]] = []

    def ask(self, unit: int, pdu: bytes) -> NamedTransaction:
        self.asked.append((unit, pdu))
        request = self._adu(Direction.REQUEST, unit, pdu)
        given = self._answers.get(unit)
        answer = None if given is None else given(pdu)
        ends = Ends("line")
        if answer is None:
            return self._namer.name(no_answer(ends, request, 0))
        response = self._adu(Direction.RESPONSE, unit, answer)
        return self._namer.name(with_response(ends, request, response, 0, ()))

    @staticmethod
    def _adu(direction: Direction, unit: int, pdu: bytes) -> Adu:
        return Adu(
            start_ns=10**12,
            end_ns=10**12,
            transport=Transport.RTU,
            direction=direction,
            direction_by=DirectionBy.PORT,
            confidence=1.0,
            unit=unit,
            pdu=pdu,
            raw=rtu_adu(unit, pdu),
        )


def areas_of(units: Units, unit: int, last: int, *, every: bool = False) -> list[FoundArea]:
    work = Scan(units.ask, ScanState(link="line"), is_tcp=False, every=every)
    assert list(work.scan_registers(unit, range(last + 1)))
    return work.state.areas


def registers(allowed: set[int], most: int = 125) -> Callable[[bytes], bytes | None]:
    """Answers reads of holding registers; any other function is illegal."""

    def answer(pdu: bytes) -> bytes | None:
        if pdu[0] != 3:
            return bytes([pdu[0] | 0x80, 1])
        first, quantity = int.from_bytes(pdu[1:3]), int.from_bytes(pdu[3:5])
        if quantity > most:
            return bytes.fromhex("83 03")
        if not set(range(first, first + quantity)) <= allowed:
            return REFUSED
        return bytes([3, 2 * quantity]) + bytes(2 * quantity)

    return answer


@pytest.mark.parametrize("name", builtin_profiles())
def test_every_register_that_a_device_lets_read_is_found(name: str) -> None:
    device = make_device(load_profile(name), RegisterImage())

    def answer(pdu: bytes) -> bytes | None:
        response = device.respond(1, pdu, 0)
        return None if response is None else response.pdu

    units = Units({1: answer})
    last = 2047
    found = areas_of(units, 1, last)
    for table, code in READS_OF_TABLE.items():
        readable = {
            at
            for at in range(last + 1)
            if (answer(bytes([code]) + at.to_bytes(2) + b"\x00\x01") or b"\x80")[0] == code
        }
        told = {
            at
            for area in found
            if area.table == table.value
            for at in range(area.first, area.last + 1)
        }
        assert told <= readable, table
        assert len(told) >= 0.95 * len(readable), table


@pytest.mark.parametrize("most", [125, 100, 33, 1])
def test_areas_are_found_to_both_ends_whatever_the_longest_read(most: int) -> None:
    allowed = {*range(17), *range(93, 140), *range(200, 201), *range(500, 777)}
    found = areas_of(Units({7: registers(allowed, most)}), 7, 999)
    assert [(one.first, one.last) for one in found] == [(0, 16), (93, 139), (200, 200), (500, 776)]


def test_each_address_is_tried_only_with_every() -> None:
    units = {7: registers({3, 777})}
    assert areas_of(Units(units), 7, 999) == []
    found = areas_of(Units(units), 7, 999, every=True)
    assert [(one.first, one.last) for one in found] == [(3, 3), (777, 777)]


def test_units_are_found_by_any_answer_but_that_of_a_gateway() -> None:
    units = Units(
        {
            3: registers({0}),
            4: lambda pdu: bytes([pdu[0] | 0x80, 1]),
            9: lambda pdu: pdu if pdu[0] == 8 else None,
            11: lambda pdu: bytes([pdu[0] | 0x80, 0x0B]),
            12: lambda pdu: IDENTITY if pdu[0] == 0x2B else None,
        }
    )
    work = Scan(units.ask, ScanState(link="line"), is_tcp=False)
    assert list(work.units(range(1, 21))) == list(range(1, 21))
    assert [one.unit for one in work.state.units] == [3, 4, 9, 12]
    assert work.state.units[-1].identity == ["vendor: ABC"]
    assert {pdu[0] for _, pdu in units.asked} <= READ_ONLY


def test_a_tcp_device_that_answers_for_every_unit_is_one() -> None:
    everywhere = dict.fromkeys(range(256), registers(set(range(10))))
    work = Scan(Units(everywhere).ask, ScanState(link="tcp"), is_tcp=True)
    assert len(list(work.units(range(1, 248)))) < 8
    assert [(one.unit, one.is_any) for one in work.state.units] == [(1, True)]


def test_a_scan_that_goes_on_asks_nothing_twice() -> None:
    answers = {2: registers(set(range(300)))}
    first, state = Units(answers), ScanState(link="line")
    blocks = Scan(first.ask, state, is_tcp=False).scan_registers(2, range(1000))
    for _ in range(3):
        next(blocks)
    second = Units(answers)
    list(Scan(second.ask, state, is_tcp=False).scan_registers(2, range(1000)))
    assert not {pdu for _, pdu in first.asked} & {pdu for _, pdu in second.asked if pdu[0] == 3}
    assert [(one.first, one.last) for one in state.areas] == [(0, 299)]
    assert [pdu.hex(" ") for pdu in final_reads(state, 2)] == [
        "03 00 00 00 7d",
        "03 00 7d 00 7d",
        "03 00 fa 00 32",
    ]


def test_a_unit_that_answers_no_more_is_left() -> None:
    alive = registers(set(range(50)))
    count = 0

    def answer(pdu: bytes) -> bytes | None:
        nonlocal count
        count += 1
        return alive(pdu) if count < 10 else None

    units = Units({2: answer})
    work = Scan(units.ask, ScanState(link="line"), is_tcp=False)
    list(work.scan_registers(2, range(10_000)))
    assert len(units.asked) < 30
    assert "unit 2 answers no more" in work.state.remarks[0]


def test_units_behind_a_gateway_that_answer_alike_are_told_apart_by_their_values() -> None:
    def unit(value: int) -> Callable[[bytes], bytes | None]:
        return lambda pdu: bytes([3, 2, 0, value]) if pdu[0] == 3 else bytes([pdu[0] | 0x80, 1])

    units = Units({number: unit(number) for number in range(1, 9)})
    work = Scan(units.ask, ScanState(link="tcp"), is_tcp=True)
    assert len(list(work.units(range(1, 13)))) == 12
    assert [one.unit for one in work.state.units] == list(range(1, 9))


def test_four_equal_units_behind_a_gateway_are_no_single_device() -> None:
    units = Units(dict.fromkeys(range(1, 9), registers(set(range(10)))))
    work = Scan(units.ask, ScanState(link="tcp"), is_tcp=True)
    list(work.units(range(1, 13)))
    assert [one.unit for one in work.state.units] == list(range(1, 9))


def test_a_device_for_every_unit_is_found_also_after_an_interruption() -> None:
    units = Units(dict.fromkeys(range(256), registers(set(range(10)))))
    state = ScanState(link="tcp")
    begun = Scan(units.ask, state, is_tcp=True).units(range(1, 248))
    next(begun)
    next(begun)
    list(Scan(units.ask, state, is_tcp=True).units(range(1, 248)))
    assert [(one.unit, one.is_any) for one in state.units] == [(1, True)]


def test_a_device_that_refuses_addresses_as_wrong_values_is_read_in_whole_blocks() -> None:
    allowed = set(range(200))

    def answer(pdu: bytes) -> bytes | None:
        response = registers(allowed)(pdu)
        return bytes.fromhex("83 03") if response == REFUSED else response

    units = Units({5: answer, 6: registers(set(range(500)))})
    work = Scan(units.ask, ScanState(link="line"), is_tcp=False)
    for unit in (5, 6):
        list(work.scan_registers(unit, range(2000)))
    assert [(one.unit, one.first, one.last) for one in work.state.areas] == [
        (5, 0, 199),
        (6, 0, 499),
    ]
    assert sum(unit == 5 for unit, _ in units.asked) < 500
    assert sum(unit == 6 for unit, _ in units.asked) < 500


def test_a_unit_that_answers_each_request_with_a_failure_is_left_soon() -> None:
    units = Units({4: lambda pdu: bytes([pdu[0] | 0x80, 4])})
    work = Scan(units.ask, ScanState(link="tcp"), is_tcp=True)
    list(work.scan_registers(4, range(10_000)))
    assert len(units.asked) < 120
    assert work.state.areas == []


def test_a_unit_that_refuses_addresses_with_a_failure_is_read_all_the_same() -> None:
    def answer(pdu: bytes) -> bytes | None:
        response = registers({*range(10), *range(500, 520)})(pdu)
        return bytes.fromhex("83 04") if response == REFUSED else response

    found = areas_of(Units({5: answer}), 5, 999)
    assert [(one.first, one.last) for one in found] == [(0, 9), (500, 519)]


def test_a_read_whose_answer_is_lost_is_repeated() -> None:
    count = 0

    def answer(pdu: bytes) -> bytes | None:
        nonlocal count
        count += 1
        return None if count % 3 == 0 else registers({*range(17), *range(93, 140)})(pdu)

    found = areas_of(Units({7: answer}), 7, 999)
    assert [(one.first, one.last) for one in found] == [(0, 16), (93, 139)]


def test_a_block_that_is_too_long_for_the_pauses_of_another_master_is_halved() -> None:
    units = Units({7: registers({*range(17), *range(93, 140)})})

    def ask(unit: int, pdu: bytes) -> NamedTransaction:
        if pdu[0] in (1, 2, 3, 4) and int.from_bytes(pdu[3:5]) > 20:
            raise NoPauseError("a request needs a pause of 412 ms")
        return units.ask(unit, pdu)

    work = Scan(ask, ScanState(link="line"), is_tcp=False)
    list(work.scan_registers(7, range(1000)))
    assert [(one.first, one.last) for one in work.state.areas] == [(0, 16), (93, 139)]
