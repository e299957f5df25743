"""Whom a request is for."""

from __future__ import annotations

import pytest

from mbtool.core import SerialLink, TcpLink, parse_link
from mbtool.devices import load_profile
from mbtool.modbus import Response
from mbtool.slave.device.responder import Units, units_on
from tests.slave.scripted import Scripted, echo

READ = bytes.fromhex("03 0000 0001")
WRITE = bytes.fromhex("06 0000 1234")


def test_passes_a_request_to_the_slave_it_names() -> None:
    first, second = Scripted(echo), Scripted(lambda unit, pdu: Response(b"\x03\x02\x00\x02"))
    units = Units({1: first, 2: second})
    assert units.respond(2, READ, 0) == Response(b"\x03\x02\x00\x02")
    assert first.asked == []


def test_is_silent_for_the_unit_of_another_slave() -> None:
    slave = Scripted(echo)
    assert Units({1: slave}).respond(2, READ, 0) is None
    assert slave.asked == []


def test_a_broadcast_is_executed_by_all_and_answered_by_none() -> None:
    first, second = Scripted(echo), Scripted(echo)
    units = Units({1: first, 2: second}, broadcast=True)
    assert units.respond(0, WRITE, 0) is None
    assert first.asked == second.asked == [(0, WRITE)]


def test_unit_0_is_a_unit_where_nothing_is_broadcast() -> None:
    assert Units({0: Scripted(echo)}).respond(0, WRITE, 0) == Response(WRITE)


@pytest.mark.parametrize(
    ("profile", "link", "unit", "answered"),
    [
        ("fa3-at1m8x", "tcp:127.0.0.1:1502", 0, True),
        ("fa3-at1m8x", "tcp:127.0.0.1:1502", 77, True),
        ("fa3-at1m8x", "rtu+tcp:127.0.0.1:1502", 77, False),
        ("idec-ft1a-touch", "tcp:127.0.0.1:1502", 5, True),
        ("idec-ft1a-touch", "tcp:127.0.0.1:1502", 77, False),
        ("idec-ft1a-touch", "rtu:/dev/ttyUSB0", 5, True),
        ("idec-ft1a-touch", "rtu:/dev/ttyUSB0", 0, False),
        ("idec-ft1a-touch", "rtu+tcp:127.0.0.1:1502", 0, False),
    ],
)
def test_a_device_follows_the_rules_of_its_link(
    profile: str, link: str, unit: int, answered: bool
) -> None:
    spec = parse_link(link)
    assert isinstance(spec, SerialLink | TcpLink)
    units = units_on(spec, load_profile(profile), 5, Scripted(echo))
    assert (units.respond(unit, READ, 0) is not None) is answered


@pytest.mark.parametrize(
    ("link", "unit", "asked"),
    [
        ("rtu:/dev/a@9600", 5, [1, 0]),
        ("rtu:/dev/a@9600", 3, [0, 1]),
        ("rtu:/dev/a@9600", 0, [1, 1]),
        ("rtu:/dev/a@9600", 9, [0, 0]),
        ("tcp:127.0.0.1:1502", 9, [1, 0]),
        ("tcp:127.0.0.1:1502", 3, [0, 1]),
        ("tcp:127.0.0.1:1502", 0, [1, 0]),
        ("rtu+tcp:127.0.0.1:1502", 0, [1, 1]),
    ],
)
def test_others_may_be_beside_a_device(link: str, unit: int, asked: list[int]) -> None:
    spec = parse_link(link)
    assert isinstance(spec, SerialLink | TcpLink)
    first, other = Scripted(echo), Scripted(echo)
    units_on(spec, load_profile("wago-750"), 5, first, {3: other}).respond(unit, READ, 0)
    assert [len(first.asked), len(other.asked)] == asked
