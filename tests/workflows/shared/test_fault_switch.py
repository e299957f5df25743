"""Faults that come and go while a slave answers."""

from __future__ import annotations

import pytest

from mbtool.core import TcpLink, UsageError, parse_link
from mbtool.devices import load_profile
from mbtool.modbus import Response
from mbtool.workflows.shared.faults import FaultSwitch

READ = bytes.fromhex("03 0000 0001")  # read holding registers, address 0, quantity 1
ANSWER = bytes.fromhex("03 02 1234")


class Fixed:
    """Gives one response to every request."""

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response:
        return Response(ANSWER)


def switch() -> FaultSwitch:
    link = parse_link("tcp:127.0.0.1:0")
    assert isinstance(link, TcpLink)
    return FaultSwitch(Fixed(), link, [load_profile("idec-ft1a-touch")])


def pdus(one: FaultSwitch, count: int) -> list[str]:
    answers = [one.respond(1, READ, now_ns) for now_ns in range(count)]
    return [answer.pdu.hex() for answer in answers if answer is not None]


def test_a_fault_that_is_added_counts_from_the_next_request_on() -> None:
    one = switch()
    assert pdus(one, 2) == ["03021234"] * 2
    one.add({"faults": [{"kind": "exception", "code": 6, "nth": 2, "times": 1}]})
    assert pdus(one, 3) == ["03021234", "8306", "03021234"]


def test_faults_act_one_after_the_other_until_they_are_cleared() -> None:
    one = switch()
    one.add({"faults": [{"kind": "offset", "by": 1}]})
    one.add({"faults": [{"kind": "offset", "by": 2, "registers": "HR400001"}]})
    assert pdus(one, 1) == ["03021237"]
    one.clear()
    assert pdus(one, 1) == ["03021234"]


def test_a_wrong_fault_changes_nothing() -> None:
    one = switch()
    with pytest.raises(UsageError, match="Modbus/TCP has no checksum"):
        one.add({"faults": [{"kind": "bad-crc"}]})
    assert pdus(one, 1) == ["03021234"]


def test_an_action_happens_once_before_the_next_request() -> None:
    one = switch()
    times: list[int] = []
    one.before_next(times.append)
    one.respond(1, READ, 5)
    one.respond(1, READ, 6)
    assert times == [5]
