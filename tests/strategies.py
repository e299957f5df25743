"""Generated PDUs, ADUs and conversations, for hypothesis."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import assume
from hypothesis import strategies as st

from mbtool.core import Direction
from mbtool.modbus import FUNCTIONS, Outcome, encode_pdu, exception_pdu
from mbtool.modbus.layouts import Value
from mbtool.serial_line.costs import COUNTS

WORD = st.integers(0, 0xFFFF)
UNIT = st.integers(1, 247)
SIZES = st.lists(st.integers(1, 40), max_size=60)
"""Where to cut."""
UNKNOWN_FUNCTIONS = sorted(set(range(1, 0x80)) - set(FUNCTIONS))


@dataclass(frozen=True, slots=True)
class Message:
    """A PDU and the fields it is made from."""

    code: int
    direction: Direction
    fields: dict[str, Value]

    @property
    def pdu(self) -> bytes:
        return encode_pdu(self.code, self.direction, **self.fields)


@dataclass(frozen=True, slots=True)
class Exchange:
    """A request, its response if there is one, and what a transaction of them says."""

    unit: int
    request: bytes
    response: bytes | None
    outcome: Outcome
    says: dict[str, object] = field(default_factory=dict)
    """Values of the transaction's attributes."""


def registers(least: int, most: int) -> st.SearchStrategy[tuple[int, ...]]:
    return st.lists(WORD, min_size=least, max_size=most).map(tuple)


def bits(least: int, most: int) -> st.SearchStrategy[tuple[int, ...]]:
    return st.lists(st.integers(0, 1), min_size=least, max_size=most).map(tuple)


@st.composite
def messages(draw: st.DrawFn, direction: Direction | None = None) -> Message:
    """Any request, response or exception response that can be encoded."""
    if direction is None:
        direction = draw(st.sampled_from((Direction.REQUEST, Direction.RESPONSE)))
    if direction is Direction.RESPONSE and draw(st.integers(0, 9)) == 0:
        code = draw(st.integers(0x80, 0xFF))
        return Message(code, direction, {"exception_code": draw(st.integers(0, 255))})
    code = draw(st.sampled_from([*FUNCTIONS, *UNKNOWN_FUNCTIONS[:3]]))
    make = _request_fields if direction is Direction.REQUEST else _response_fields
    return Message(code, direction, draw(make(code)))


@st.composite
def _request_fields(draw: st.DrawFn, code: int) -> dict[str, Value]:
    address, word = draw(WORD), draw(WORD)
    match code:
        case 0x01 | 0x02 | 0x03 | 0x04:
            quantity = draw(st.integers(1, FUNCTIONS[code].limit))
            return {"address": address, "quantity": quantity}
        case 0x05:
            return {"address": address, "value": draw(st.sampled_from((0x0000, 0xFF00)))}
        case 0x06:
            return {"address": address, "value": word}
        case 0x07 | 0x0B | 0x0C | 0x11:
            return {}
        case 0x08:
            sub_function = draw(st.integers(0, 20))
            if sub_function in COUNTS:  # Only its answer has one.
                return {"sub_function": sub_function, "values": (0,)}
            most = 1 if sub_function else 8
            return {"sub_function": sub_function, "values": draw(registers(1, most))}
        case 0x0F:
            values = draw(bits(1, 40))
            return {"address": address, "quantity": len(values), "values": values}
        case 0x10:
            values = draw(registers(1, 12))
            return {"address": address, "quantity": len(values), "values": values}
        case 0x14:
            return {"groups": tuple(draw(st.lists(st.tuples(WORD, WORD, WORD), max_size=5)))}
        case 0x15:
            group = st.tuples(WORD, WORD, registers(0, 8))
            return {"groups": tuple(draw(st.lists(group, max_size=5)))}
        case 0x16:
            return {"address": address, "and_mask": word, "or_mask": draw(WORD)}
        case 0x17:
            values = draw(registers(1, 12))
            return {
                "address": address,
                "quantity": draw(st.integers(1, 125)),
                "write_address": word,
                "write_quantity": len(values),
                "values": values,
            }
        case 0x18:
            return {"address": address}
        case 0x2B:
            return draw(_encapsulated_request())
        case _:
            return {"data": draw(st.binary(max_size=20))}


@st.composite
def _response_fields(draw: st.DrawFn, code: int) -> dict[str, Value]:
    match code:
        case 0x01 | 0x02:
            return {"values": draw(bits(1, 40).filter(lambda some: len(some) % 8 == 0))}
        case 0x03 | 0x04 | 0x17:
            return {"values": draw(registers(1, 125))}
        case 0x07:
            return {"status": draw(st.integers(0, 255))}
        case 0x0B:
            return {"status": draw(st.sampled_from((0, 0xFFFF))), "event_count": draw(WORD)}
        case 0x0C | 0x11:
            return {"data": draw(st.binary(max_size=70))}
        case 0x0F | 0x10:
            return {"address": draw(WORD), "quantity": draw(WORD)}
        case 0x14:
            return {"groups": tuple(draw(st.lists(st.tuples(registers(0, 8)), max_size=5)))}
        case 0x18:
            queue = draw(registers(0, 31))
            return {"fifo": (len(queue), *queue)}
        case 0x2B:
            return draw(_encapsulated_response())
        case _:
            return draw(_request_fields(code))


@st.composite
def _encapsulated_request(draw: st.DrawFn) -> dict[str, Value]:
    if draw(st.booleans()):
        return {
            "mei_type": draw(st.sampled_from((0x0D, 0x99))),
            "data": draw(st.binary(max_size=9)),
        }
    return {"mei_type": 0x0E, "read_code": draw(st.integers(1, 4)), "object_id": 0}


@st.composite
def _encapsulated_response(draw: st.DrawFn) -> dict[str, Value]:
    if draw(st.booleans()):
        return {"mei_type": 0x0D, "data": draw(st.binary(max_size=9))}
    one = st.tuples(st.integers(0, 255), st.binary(max_size=20))
    return {
        "mei_type": 0x0E,
        "read_code": draw(st.integers(1, 4)),
        "conformity": draw(st.integers(1, 3)),
        "more_follows": draw(st.sampled_from((0, 0xFF))),
        "next_object_id": 0,
        "objects": tuple(draw(st.lists(one, max_size=5))),
    }


@st.composite
def exchanges(draw: st.DrawFn, *, broadcasts: bool = False) -> Exchange:
    """A transaction as a master and a slave that keep the rules have it."""
    unit = draw(UNIT)
    code = draw(st.sampled_from([1, 2, 3, 4, 5, 6, 7, 8, 0x0F, 0x10, 0x16, 0x17, 0x18, 0x2B, 0x41]))
    fields = draw(_request_fields(code))
    request = Message(code, Direction.REQUEST, fields)
    says = _what_a_request_says(code, fields)
    fate = draw(st.sampled_from(("ok", "ok", "ok", "exception", "none", "broadcast")))
    if fate == "broadcast" and broadcasts and code in (5, 6, 0x0F, 0x10):
        return Exchange(0, request.pdu, None, Outcome.BROADCAST, says)
    if fate == "none":
        return Exchange(unit, request.pdu, None, Outcome.NO_ANSWER, says)
    if fate == "exception":
        exception = draw(st.integers(1, 0x12))
        says["exception"] = exception
        return Exchange(unit, request.pdu, exception_pdu(code, exception), Outcome.EXCEPTION, says)
    response, told = draw(_answers(request))
    return Exchange(unit, request.pdu, response, Outcome.OK, {**says, "response_values": told})


@st.composite
def _answers(draw: st.DrawFn, request: Message) -> tuple[bytes, list[int] | None]:
    """The response to a request, and the values it tells."""
    fields: dict[str, Value]
    quantity = request.fields.get("quantity", 0)
    assert isinstance(quantity, int)
    match request.code:
        case 0x01 | 0x02:
            values = draw(bits(quantity, quantity)) if quantity < 40 else (1, 0, 0) * 700
            values = values[:quantity]
            padded = values + (0,) * (-quantity % 8)
            response = encode_pdu(request.code, Direction.RESPONSE, values=padded)
            # An answer that equals its request byte by byte is taken for a repeated request.
            assume(response != request.pdu)
            return response, list(values)
        case 0x03 | 0x04 | 0x17:
            values = draw(registers(min(quantity, 20), 20))[:quantity]
            values += (7,) * (quantity - len(values))
            return encode_pdu(request.code, Direction.RESPONSE, values=values), list(values)
        case 0x05 | 0x06 | 0x16:
            return request.pdu, None
        case 0x08:
            assume(request.fields["sub_function"] != 4)  # Nobody answers "force listen only".
            words = request.fields["values"]
            assert isinstance(words, tuple)
            return request.pdu, [word for word in words if isinstance(word, int)]
        case 0x0F | 0x10:
            return request.pdu[:5], None
        case _:
            fields = draw(_response_fields(request.code))
            if request.code == 0x2B:
                fields["mei_type"] = request.fields["mei_type"]
                if fields["mei_type"] == 0x0E:
                    fields = {
                        "conformity": 1,
                        "more_follows": 0,
                        "next_object_id": 0,
                        "objects": ((0, b"maker"),),
                        **fields,
                        "read_code": request.fields["read_code"],
                    }
                else:
                    fields = {"data": b"", **fields}
            told = {0x07: fields.get("status"), 0x18: fields.get("fifo")}.get(request.code)
            response = encode_pdu(request.code, Direction.RESPONSE, **fields)
            if isinstance(told, tuple):
                return response, [word for word in told[1:] if isinstance(word, int)]
            return response, [told] if isinstance(told, int) else None


def _what_a_request_says(code: int, fields: dict[str, Value]) -> dict[str, object]:
    values = fields.get("values")
    asked: object = list(values) if isinstance(values, tuple) else None
    quantity: object = fields.get("quantity")
    if code == 0x05:
        asked, quantity = [int(fields["value"] == 0xFF00)], 1
    elif code == 0x06:
        asked, quantity = [fields["value"]], 1
    elif code == 0x16:
        asked, quantity = [fields["and_mask"], fields["or_mask"]], 1
    return {
        "function": code,
        "address": fields.get("address"),
        "quantity": quantity,
        "write_address": fields.get("write_address"),
        "request_values": asked,
        "response_values": None,
        "exception": None,
        "sub_function": fields.get("sub_function", fields.get("mei_type")),
    }
