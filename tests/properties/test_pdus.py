"""What holds for every PDU."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus.expected_response import is_response_to
from mbtool.modbus.pdu import parse_pdu, pdu_length
from tests.strategies import Message, messages

DIRECTIONS = st.sampled_from(tuple(Direction))
NO_LENGTH = 0
DIAGNOSTICS = 0x08


@given(messages())
def test_what_is_encoded_is_parsed_as_it_was(message: Message) -> None:
    parsed = parse_pdu(message.pdu, message.direction)
    assert parsed.problem is None
    assert (parsed.code, parsed.fields) == (message.code, message.fields)


@given(messages())
def test_length_by_structure_is_the_encoded_length(message: Message) -> None:
    length = pdu_length(message.pdu, message.direction)
    if message.code == DIAGNOSTICS:
        assert length == 5  # Nothing in it says when it is longer.
    else:
        assert length in (len(message.pdu), NO_LENGTH)


@given(messages())
def test_beginning_has_the_length_of_the_whole_or_asks_for_more(message: Message) -> None:
    pdu = message.pdu
    length = pdu_length(pdu, message.direction)
    known = [pdu_length(pdu[:size], message.direction) for size in range(len(pdu))]
    assert set(known) <= {None, length}
    told = [each for each in known if each is not None]
    assert known == [None] * (len(known) - len(told)) + told  # Once known, it stays so.


@given(messages(), st.data())
def test_beginning_keeps_fields_and_names_a_problem(message: Message, data: st.DataObject) -> None:
    pdu = message.pdu
    cut = pdu[: data.draw(st.integers(0, len(pdu) - 1))]
    parsed = parse_pdu(cut, message.direction)
    if pdu_length(pdu, message.direction) == len(pdu):
        assert parsed.problem is not None
    whole = parse_pdu(pdu, message.direction).fields
    numbers = {name: value for name, value in parsed.fields.items() if isinstance(value, int)}
    assert numbers.items() <= whole.items()


@given(messages(), st.binary(min_size=1, max_size=9))
def test_bytes_too_many_are_a_problem_and_the_fields_stay(message: Message, extra: bytes) -> None:
    pdu = message.pdu
    parsed = parse_pdu(pdu + extra, message.direction)
    if pdu_length(pdu, message.direction) == len(pdu) and message.code != DIAGNOSTICS:
        assert parsed.problem is not None
        assert parsed.fields == parse_pdu(pdu, message.direction).fields


@given(st.binary(max_size=300), DIRECTIONS)
def test_no_bytes_raise(data: bytes, direction: Direction) -> None:
    parsed = parse_pdu(data, direction)
    pdu_length(data, direction)
    is_response_to(parsed, data)


@given(messages(), st.binary(max_size=20), st.integers(0, 30), DIRECTIONS)
def test_no_damaged_pdu_raises(
    message: Message, damage: bytes, at: int, direction: Direction
) -> None:
    pdu = message.pdu[:at] + damage + message.pdu[at + len(damage) :]
    parse_pdu(pdu, direction)
    pdu_length(pdu, direction)
