"""Defines the names of the --where language, and rejects comparisons that are never true."""

# Each name has a kind (number, text, list, moment). Some names can only have certain texts, or
# numbers in a range. A comparison of different kinds, or with a text or number that the name never
# has, would silently select nothing. So it is reported as an error when the expression is parsed.
# `"HR4" in reference` searches any part of a text. A text that is compared with a moment (a point
# in time) is read as ISO 8601.

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from operator import attrgetter
from typing import Any

from msgspec import inspect

from mbtool.core.moments import host_of
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.devices.transaction_fields import transaction_fields
from mbtool.modbus import FUNCTIONS

_WITH_UNIT = re.compile(r"(?P<host>.+)/(?P<unit>[0-9]{1,3})")
_WITH_PORT = re.compile(r"[^:]+:[0-9]+|\[.*\]:[0-9]+")
WRONG_CRC = 'a response with a wrong CRC or LRC is found among outcome == "no-answer"'
"""The advice for a user whose expression names a CRC or LRC, which no field has."""


class ValueKind(StrEnum):
    """The kind of one side of a comparison; only terms of the same kind can be compared."""

    NUMBER = "a number"
    TEXT = "a text"
    LIST = "a list"
    MOMENT = "a moment"


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """One side of a comparison in a --where expression: a name, a number, a text or a list."""

    text: str
    """The term as text, for error messages."""
    value: Callable[[NamedTransaction], Any]
    """Returns the term's value in a transaction; None if the transaction has no such value."""
    kind: ValueKind
    choices: tuple[str, ...] = ()
    """If the term is a name: all texts that it can have; empty if it can be any text."""
    allowed: range | None = None
    """If the term is a name: the numbers that it can have; None if it can be any number."""
    number: float | None = None
    """The number, if the term is a number in the expression; otherwise None."""
    is_endpoint: bool = False
    """True if the value is an address with a port (HOST:PORT). A text without a port equals it if
    the hosts are equal."""
    is_host: bool = False
    """True if the value is the address of a host (HOST), without a port."""
    constant: str | None = None
    """The text, if the term is a text in quotes; otherwise None."""
    items: tuple[Term, ...] = ()
    """If the term is a list: its members. If a name stands for a list: one term for any member."""

    @property
    def described(self) -> str:
        if self.kind is ValueKind.LIST and len({item.kind for item in self.items}) == 1:
            return f"{self.text} is a list of {self.items[0].kind.removeprefix('a ')}s"
        return f"{self.text} is {self.kind}"


def why_never_true(left: Term, right: Term, *, membership: bool) -> str | None:
    """Say why a comparison can never be true, and what to write instead; None if it can be true.

    `membership` is True for `left in right` and `left not in right`, False for other operators.
    An empty list is accepted, as scripts fill in lists that may be empty.
    """
    if not membership:
        return _why_never_equal(left, right)
    if right.kind is ValueKind.LIST:
        return _first_reason(_why_never_equal(left, item) for item in right.items)
    if right.kind is ValueKind.TEXT:
        return None if left.kind is ValueKind.TEXT else _unlike(left, right)
    return f"{right.described}, and in looks into a list: unit in (1, 2)"


def why_out_of_range(left: Term, right: Term, compare: str) -> str | None:
    """Say why a comparison of a name with a number is useless; None if it is not.

    It is useless if the name can never have this number, as in `unit == 300` and `unit != 300`, or
    none in this range, as in `unit < 0`. `compare` is the operator: `==`, `!=`, `in`, `not in`,
    `<`, `<=`, `>` or `>=`.
    """
    if compare in ("in", "not in"):
        return _first_reason(why_out_of_range(left, item, "==") for item in right.items)
    if left.number is not None:
        left, right = right, left
        compare = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}.get(compare, compare)
    allowed, number = left.allowed, right.number
    if allowed is None or number is None:
        return None
    least, most = allowed[0], allowed[-1]
    holds = {
        "<": least < number,
        "<=": least <= number,
        ">": most > number,
        ">=": most >= number,
    }.get(compare, number in allowed)
    if holds:
        return None
    never = "" if compare in ("==", "!=") else f"{compare} "
    return f"{left.text} is never {never}{right.text}; it is a number from {least} to {most}"


def _why_never_equal(left: Term, right: Term) -> str | None:
    if left.kind is ValueKind.LIST and right.kind is ValueKind.LIST:
        return _first_reason(
            _why_never_equal(one, other) for one in left.items for other in right.items
        )
    for one, other in ((left, right), (right, left)):
        if one.kind is ValueKind.LIST:
            fits = not any(_why_never_equal(other, item) for item in one.items)
            return _unlike(left, right, f"write {other.text} in {one.text}" if fits else None)
        if one.choices and other.constant is not None and other.constant not in one.choices:
            is_check = re.search("[cl]rc", other.constant, re.IGNORECASE) is not None
            instead = WRONG_CRC if is_check else f"it is {_either(one.choices)}"
            return f"{one.text} is never {other.text}; {instead}"
        if one.is_host and other.constant is not None and _WITH_PORT.fullmatch(other.constant):
            whole = "source" if one.text == "master" else "destination"
            return f"{one.text} has no port; write {whole} == {other.text}"
        behind = _WITH_UNIT.fullmatch(other.constant or "")
        if behind is not None and (one.is_host or one.is_endpoint):
            return _without_suffix(one.text, behind["host"], behind["unit"])
    return None if left.kind is right.kind else _unlike(left, right)


def _without_suffix(name: str, host: str, number: str) -> str:
    """Say what to write for an address with a unit or a network prefix behind it.

    An address that ends in 0, such as 10.0.0.0/24, is that of a network.
    """
    if not host.endswith((".0", "::")):
        return (
            f'{name} has no unit or prefix behind it; write {name} == "{host}" and unit == {number}'
        )
    instead = "compare with like or matches"
    if number in ("8", "16", "24") and host.count(".") == 3:
        octets = host.split(".")[: int(number) // 8]
        instead = f'write {name} like "{".".join(octets)}.*"'
    return f"{name} has no network prefix behind it; {instead}"


def _unlike(left: Term, right: Term, instead: str | None = None) -> str:
    both = f"{left.described} and {right.described}"
    return f"{both}; {instead or 'they cannot be compared'}"


def _first_reason(reasons: Iterable[str | None]) -> str | None:
    return next((one for one in reasons if one is not None), None)


def _either(choices: tuple[str, ...]) -> str:
    return f"{', '.join(choices[:-1])} or {choices[-1]}"


def is_at(endpoint: str, text: str) -> bool:
    """True if `text` equals an endpoint (HOST:PORT), or its host without the port."""
    return endpoint == text or host_of(endpoint) == text.strip("[]")


def _number(
    name: str, value: Callable[[NamedTransaction], Any], allowed: range | None = None
) -> Term:
    return Term(text=name, value=value, kind=ValueKind.NUMBER, allowed=allowed)


def _endpoint(name: str, value: Callable[[NamedTransaction], Any]) -> Term:
    return Term(text=name, value=value, kind=ValueKind.TEXT, is_endpoint=True)


def _host(name: str, value: Callable[[NamedTransaction], Any]) -> Term:
    return Term(text=name, value=value, kind=ValueKind.TEXT, is_host=True)


def _text(name: str, value: Callable[[NamedTransaction], Any], choices: Iterable[str] = ()) -> Term:
    return Term(text=name, value=value, kind=ValueKind.TEXT, choices=tuple(choices))


def _list(
    name: str,
    value: Callable[[NamedTransaction], Any],
    kind: ValueKind,
    choices: Iterable[str] = (),
    allowed: range | None = None,
) -> Term:
    item = Term(
        text=f"one of {name}", value=value, kind=kind, choices=tuple(choices), allowed=allowed
    )
    return Term(text=name, value=value, kind=ValueKind.LIST, items=(item,))


def _field(name: str) -> Term:
    """Return the term of a field of a transaction, by its type."""
    (found,) = (one for one in transaction_fields() if one.name == name)
    match found.type:
        case inspect.IntType(le=le):
            allowed = range(le + 1) if le is not None and le <= _WORD[-1] else None
            return _number(name, attrgetter(name), allowed)
        case inspect.FloatType():
            return _number(name, attrgetter(name))
        case inspect.EnumType(cls=choices):
            return _text(name, attrgetter(name), choices)
        case inspect.ListType(item_type=inspect.EnumType(cls=choices)):
            return _list(name, attrgetter(name), ValueKind.TEXT, choices)
        case inspect.ListType():
            return _list(name, attrgetter(name), ValueKind.TEXT)
        case _:
            return _text(name, attrgetter(name))


def _written(one: NamedTransaction, *, bits: bool) -> list[int] | None:
    """The addresses of registers (or bits) that a request writes, also if the slave refuses it.

    None if the request writes none.
    """
    function = FUNCTIONS.get(one.function)
    if function is None or function.table is None or function.table.is_bits is not bits:
        return None
    first, quantity = one.address, one.quantity
    if one.write_address is not None:
        first, quantity = one.write_address, one.write_quantity
    elif not function.writes:
        return None
    if first is None:
        return None
    return list(range(first, first + (1 if quantity is None else quantity)))


class _Values(list[float]):
    """The values of a transaction's registers or bits. The numbers of its points are in it, too."""

    def __init__(self, one: NamedTransaction) -> None:
        super().__init__((one.request_values or []) + (one.response_values or []))
        self._one = one

    def __contains__(self, number: object) -> bool:
        return super().__contains__(number) or any(one == number for one in _numbers(self._one))


def _numbers(one: NamedTransaction) -> Iterator[float]:
    """The numbers of points, as a register holds them and as a person would write them."""
    for point in one.points:
        if point.value is not None:
            yield point.value
            if not float(point.value).is_integer():
                yield float(f"{point.value:.{_SHOWN_DIGITS}g}")
                yield _shown_number(point.value)


def _shown_number(number: float) -> float:
    """Return a number of a point as it is shown: one of 32 bits with its 7 digits, 23.4 and not
    23.399999618.
    """
    if float(number).is_integer():
        return number
    shown = float(f"{number:.7g}")
    is_of_32_bits = abs(number) < _MOST_OF_32_BITS and _rounded_to_32_bits(number) == number
    return shown if is_of_32_bits and _rounded_to_32_bits(shown) == number else number


def _rounded_to_32_bits(number: float) -> float:
    return float(struct.unpack("f", struct.pack("f", number))[0])


_MOST_OF_32_BITS = 3e38


def point_term(name: str, *, is_text: bool) -> Term:
    """Return the term of a point: `point["Speed"]`, or `text["State"]` for its value in words."""
    wanted = name.casefold()

    def value(one: NamedTransaction) -> object:
        for point in one.points:
            if point.name.casefold() == wanted:
                if is_text:
                    return point.text
                return None if point.value is None else _shown_number(point.value)
        return None

    kind = ValueKind.TEXT if is_text else ValueKind.NUMBER
    return Term(text=f'{"text" if is_text else "point"}["{name}"]', value=value, kind=kind)


_SHOWN_DIGITS = 6
"""A number of a point also equals the number that it gives when rounded to this many digits: 23.4
equals 23.399999618."""
_WORD = range(0x10000)
_ADDRESS = ValueKind.NUMBER

_TERMS = (
    _field("link"),
    _field("transport"),
    _endpoint("source", lambda one: one.source),
    _endpoint("destination", lambda one: one.destination),
    _host("master", lambda one: one.master),
    _host("slave", lambda one: one.slave),
    _field("file"),
    Term(text="time", value=lambda one: one.start_ns, kind=ValueKind.MOMENT),
    _field("unit"),
    _field("transaction_id"),
    _field("function"),
    _field("address"),
    _field("quantity"),
    _list(
        "values",
        lambda one: _Values(one),
        ValueKind.NUMBER,
    ),
    _list("written_registers", lambda one: _written(one, bits=False), _ADDRESS, allowed=_WORD),
    _list("written_bits", lambda one: _written(one, bits=True), _ADDRESS, allowed=_WORD),
    _field("outcome"),
    _field("exception"),
    _number("latency_ms", lambda one: one.latency_ms),
    _field("retries"),
    _field("device"),
    _field("reference"),
    _list("points", lambda one: [point.name for point in one.points], ValueKind.TEXT),
    _field("findings"),
    _field("verdicts"),
)

_SCALARS = (inspect.IntType, inspect.FloatType, inspect.StrType, inspect.EnumType)


def _other_fields() -> Iterator[Term]:
    """Yield a term for each other field that has one number or text and is no time in ns."""
    named = {term.text for term in _TERMS}
    for field in transaction_fields():
        is_time = field.name.endswith("_ns")
        if field.name not in named and not is_time and isinstance(field.type, _SCALARS):
            yield _field(field.name)


USUAL_NAMES = tuple(term.text for term in _TERMS)
"""The names that messages list."""
NAMES = {term.text: term for term in (*_TERMS, *_other_fields())}
"""The names that a --where expression can use, such as `unit`. docs/filters.md lists them."""
