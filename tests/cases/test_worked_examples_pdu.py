"""Worked examples made by others: every one parses without a problem and encodes to its bytes."""

# The file stands beside the captures made by others. It has whole ADUs and bare PDUs, of the
# manuals of several devices and of the standard's own section 6.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import pytest

from mbtool.core import Direction, SerialFormat
from mbtool.framing import MbapSplitter, RtuStreamSplitter
from mbtool.modbus import (
    Adu,
    Transport,
    ascii_adu,
    encode_pdu,
    mbap_adu,
    parse_pdu,
    rtu_adu,
)
from mbtool.modbus.pdu import pdu_of
from mbtool.serial_line import AsciiSplitter, RtuSplitter
from tests.cases.worked_examples import worked_examples
from tests.feeding import Line, every_way, feed_all
from tests.modbus.reading import adus

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.modbus import Skipped

pytestmark = pytest.mark.public_captures

FORMAT = SerialFormat(9600)

# Examples of no device that has a profile: of the standard, of a sister model, and made to mislead.
OTHERS = {"modbus-spec", "chino-kp3000", "resync"}

# Why an example is not what the tests expect of all others.
EXPLAINED = {
    "exc-03 request": "its byte count is wrong on purpose, to get exception 03",
    "protocol-id-nonzero request": "its protocol id is wrong on purpose",
}


@dataclass(frozen=True, slots=True)
class Vector:
    """One message, as the file has it."""

    device: str
    name: str
    direction: Direction
    transport: str
    """`pdu`, `rtu`, `tcp` or `ascii`."""
    hex: str

    @property
    def raw(self) -> bytes:
        return bytes.fromhex(self.hex)

    @property
    def unit_and_pdu(self) -> tuple[int, bytes]:
        return (
            (1, self.raw)
            if self.transport == "pdu"
            else pdu_of(Transport(self.transport), self.raw)
        )

    def __str__(self) -> str:
        return f"{self.name} {self.direction}"


@pytest.fixture(scope="module")
def vectors(public_captures: Path) -> list[Vector]:
    file = public_captures.parent / "vectors.json"
    if not file.is_file():
        pytest.skip("no worked examples made by others beside the captures")
    found = msgspec.json.decode(file.read_bytes(), type=list[Vector])
    assert len(found) >= 200
    assert {vector.transport for vector in found} == {"pdu", "rtu", "tcp", "ascii"}
    return found


@pytest.fixture(scope="module")
def ordinary(vectors: list[Vector]) -> list[Vector]:
    explained = {str(vector) for vector in vectors} & set(EXPLAINED)
    assert explained == set(EXPLAINED)  # No explanation outlives its example.
    return [vector for vector in vectors if str(vector) not in EXPLAINED]


def test_every_example_parses_and_encodes_to_its_bytes(ordinary: list[Vector]) -> None:
    for vector in ordinary:
        unit, pdu = vector.unit_and_pdu
        parsed = parse_pdu(pdu, vector.direction)
        assert parsed.problem is None, vector
        encoded = encode_pdu(parsed.code, vector.direction, **parsed.fields)
        match vector.transport:
            case "rtu":
                assert rtu_adu(unit, encoded) == vector.raw, vector
            case "ascii":
                assert ascii_adu(unit, encoded) == vector.raw, vector
            case "tcp":
                number = int.from_bytes(vector.raw[:2])
                assert mbap_adu(number, unit, encoded) == vector.raw, vector
            case _:
                assert encoded == vector.raw, vector


def test_every_example_of_a_manual_is_a_case_of_our_own(vectors: list[Vector]) -> None:
    ours = {
        (example.transport, raw)
        for example in worked_examples()
        for raw in (example.request_bytes, example.response_bytes)
    }
    assert {vector.device for vector in vectors} > OTHERS
    missing = [
        str(vector)
        for vector in vectors
        if vector.device not in OTHERS and (vector.transport, vector.raw) not in ours
    ]
    assert missing == []


def test_request_with_a_wrong_byte_count_is_told(vectors: list[Vector]) -> None:
    (wrong,) = [vector for vector in vectors if str(vector) == "exc-03 request"]
    problem = parse_pdu(wrong.unit_and_pdu[1], wrong.direction).problem
    assert problem == "2 registers for a quantity of 1"


def test_every_adu_is_found_in_a_stream(ordinary: list[Vector]) -> None:
    splitters: dict[str, type[MbapSplitter | RtuStreamSplitter]] = {
        "tcp": MbapSplitter,
        "rtu": RtuStreamSplitter,
    }
    for vector in ordinary:
        make = splitters.get(vector.transport)
        if make is not None:
            _is_alone(every_way(lambda: make(vector.direction), vector.raw), vector)  # noqa: B023


def test_every_adu_is_found_on_a_line(ordinary: list[Vector]) -> None:
    for vector in ordinary:
        if vector.transport in ("rtu", "ascii"):
            splitter = AsciiSplitter if vector.transport == "ascii" else RtuSplitter
            events: list[Adu | Skipped] = feed_all(
                splitter(FORMAT), Line(FORMAT).send(vector.raw).reads()
            )
            _is_alone(events, vector)


def test_request_and_response_of_each_example_are_told_apart_on_a_line(
    ordinary: list[Vector],
) -> None:
    responses = {
        (vector.device, vector.name): vector
        for vector in ordinary
        if vector.transport == "rtu" and vector.direction is Direction.RESPONSE
    }
    compared = 0
    for request in ordinary:
        response = responses.get((request.device, request.name))
        if request.transport == "rtu" and request.direction is Direction.REQUEST and response:
            line = Line(FORMAT).send(request.raw).frame(response.raw)
            heard = adus(feed_all(RtuSplitter(FORMAT), line.reads()))
            assert [adu.direction for adu in heard] == [Direction.REQUEST, Direction.RESPONSE]
            compared += 1
    assert compared > 30


def _is_alone(events: list[Adu | Skipped], vector: Vector) -> None:
    (adu,) = events
    assert isinstance(adu, Adu), vector
    assert (adu.raw, (adu.unit, adu.pdu)) == (vector.raw, vector.unit_and_pdu), vector
