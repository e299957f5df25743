"""The filter expressions of --where: compiled once, then asked about each transaction."""

# The language is the comparisons of Python over the names in NAMES, joined by and, or, not:
#
#     unit == 5 and function in (3, 16)
#     outcome == "exception" or latency_ms > 50
#     40 <= address < 50 and 17 in values
#
# A name that does not apply to a transaction compares as false, whatever it is compared with.
# The expression is parsed, never evaluated as Python: what is not a comparison is refused.

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from mbtool.core import UsageError

if TYPE_CHECKING:
    from mbtool.devices.named import NamedTransaction

Where = Callable[["NamedTransaction"], bool]
_Value = Callable[["NamedTransaction"], Any]

NAMES: dict[str, _Value] = {
    "link": lambda one: one.link,
    "transport": lambda one: one.transport,
    "source": lambda one: one.source,
    "destination": lambda one: one.destination,
    "unit": lambda one: one.unit,
    "transaction_id": lambda one: one.transaction_id,
    "function": lambda one: one.function,
    "address": lambda one: one.address,
    "quantity": lambda one: one.quantity,
    "values": lambda one: (one.request_values or []) + (one.response_values or []),
    "outcome": lambda one: one.outcome,
    "exception": lambda one: one.exception,
    "latency_ms": lambda one: None if one.latency_ns is None else one.latency_ns / 1e6,
    "retries": lambda one: one.retries,
    "device": lambda one: one.device,
    "reference": lambda one: one.reference,
    "points": lambda one: [point.name for point in one.points],
    "findings": lambda one: one.findings,
    "verdicts": lambda one: one.verdicts,
}

_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda item, group: item in group,
    ast.NotIn: lambda item, group: item not in group,
}

_EXAMPLE = "for example: unit == 5 and function in (3, 16)"


def parse_where(text: str) -> Where:
    """Compile an expression. Raises UsageError."""
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError) as error:
        raise UsageError(f"--where {text!r} is no expression; {_EXAMPLE}") from error
    return _condition(tree.body, text)


def _condition(node: ast.expr, text: str) -> Where:
    match node:
        case ast.BoolOp(op=ast.And(), values=values):
            parts = [_condition(value, text) for value in values]
            return lambda one: all(part(one) for part in parts)
        case ast.BoolOp(values=values):
            parts = [_condition(value, text) for value in values]
            return lambda one: any(part(one) for part in parts)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            part = _condition(operand, text)
            return lambda one: not part(one)
        case ast.Compare(left=left, ops=operators, comparators=rights):
            return _chain(left, operators, rights, text)
        case _:
            raise UsageError(
                f"--where {text!r}: {ast.unparse(node)!r} is not a comparison; {_EXAMPLE}"
            )


def _chain(
    left: ast.expr, operators: Sequence[ast.cmpop], rights: Sequence[ast.expr], text: str
) -> Where:
    """A chain of comparisons, as in `40 <= address < 50`."""
    terms = [_term(node, text) for node in (left, *rights)]
    compares = []
    for one_operator in operators:
        compare = _COMPARISONS.get(type(one_operator))
        if compare is None:
            raise UsageError(f"--where {text!r}: compare with == and !=, not with is; {_EXAMPLE}")
        compares.append(compare)

    def holds(one: NamedTransaction) -> bool:
        values = [term(one) for term in terms]
        if any(value is None for value in values):
            return False
        try:
            return all(compare(values[at], values[at + 1]) for at, compare in enumerate(compares))
        except TypeError:
            return False  # A number was compared with a text: it is neither more nor less.

    return holds


def _term(node: ast.expr, text: str) -> _Value:
    match node:
        case ast.Name(id=name):
            if name not in NAMES:
                raise UsageError(
                    f"--where {text!r}: there is no {name!r}; there are {', '.join(NAMES)}"
                )
            return NAMES[name]
        case ast.Constant(value=int() | float() | str() as constant):
            return lambda _: constant
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as number)):
            return lambda _: -number
        case ast.Tuple(elts=items) | ast.List(elts=items):
            parts = [_term(item, text) for item in items]
            return lambda one: [part(one) for part in parts]
        case _:
            raise UsageError(
                f"--where {text!r}: {ast.unparse(node)!r} is neither a name, a number nor a text; "
                f"{_EXAMPLE}"
            )
