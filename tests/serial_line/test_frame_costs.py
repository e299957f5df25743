"""The cost of a frame as a request or a response, in a bus state."""

from __future__ import annotations

import pytest

from mbtool.core import Direction
from mbtool.serial_line.bus_model import SURE, BusModel
from tests.serial_line.test_bus_model import ANSWER, MS, READ, WRITE, TappedLine

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@pytest.mark.parametrize(("pdu", "role"), [(READ, REQUEST), (ANSWER, RESPONSE)])
def test_units_from_248_on_cost_more(pdu: bytes, role: Direction) -> None:
    model = BusModel()
    first, last, reserved = (model.cost(model.state, unit, pdu, role, 0) for unit in (1, 247, 248))
    assert first == last < reserved


def test_second_retry_is_as_likely_as_a_response_that_is_a_little_late() -> None:
    """No write on this line takes more than 20 ms. The third frame comes 25 ms after the retry."""
    line = TappedLine().learn_latency(5 * MS)
    line.hear(1, WRITE, 30 * MS)
    assert line.hear(1, WRITE, 300 * MS).direction is REQUEST
    third = line.hear(1, WRITE, 25 * MS)
    assert third.direction is REQUEST
    assert third.confidence < SURE


def test_second_response_has_the_length_of_the_first() -> None:
    """The slave responds to the request and to its retry. A longer frame is a new request."""
    for last, direction in ((b"\x45\x02\x03", RESPONSE), (b"\x45\x02\x03\x04", REQUEST)):
        line = TappedLine().learn_latency(5 * MS)
        line.hear(1, b"\x45\x01", 30 * MS)
        assert line.hear(1, b"\x45\x01", 300 * MS).direction is REQUEST
        assert line.hear(1, b"\x45\x09\x08", 5 * MS).direction is RESPONSE
        assert line.hear(1, last, 5 * MS).direction is direction
