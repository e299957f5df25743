"""The filter expressions of --where: compiled once, then asked about each transaction."""

# The language is the comparisons of Python over the names in NAMES, joined by and, or, not:
#
#     unit == 5 and function in (3, 16)
#     outcome == "exception" or latency_ms > 50
#     40 <= address < 50 and 17 in values
#
# A name that does not apply to a transaction compares as false, whatever it is compared with.
# The expression is parsed, never evaluated as Python: what is not a comparison is refused.
#
# Limits: MAX_LENGTH characters, and MAX_DEPTH levels of not, and, or and parentheses.

from __future__ import annotations

import ast
import operator
import warnings
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

MAX_LENGTH = 10_000
MAX_DEPTH = 50

_EXAMPLE = "for example: unit == 5 and function in (3, 16)"
_SHOWN = 60


def parse_where(text: str) -> Where:
    """Compile an expression. Raises UsageError."""
    text = text.strip()
    if len(text) > MAX_LENGTH:
        raise UsageError(f"--where takes at most {MAX_LENGTH} characters, not {len(text)}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python warns of "\d"; here it is a text.
            tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise UsageError(f"--where {_short(text)!r} is no expression; {_EXAMPLE}") from error
    return _Compiler(text).condition(tree.body, MAX_DEPTH)


class _Compiler:
    """Makes functions of the nodes of one expression's tree."""

    def __init__(self, text: str) -> None:
        self._text = text

    def condition(self, node: ast.expr, depth: int) -> Where:
        if not depth:
            raise self._refused(f"more than {MAX_DEPTH} levels deep")
        match node:
            case ast.BoolOp(op=ast.And(), values=values):
                parts = [self.condition(value, depth - 1) for value in values]
                return lambda one: all(part(one) for part in parts)
            case ast.BoolOp(values=values):
                parts = [self.condition(value, depth - 1) for value in values]
                return lambda one: any(part(one) for part in parts)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                part = self.condition(operand, depth - 1)
                return lambda one: not part(one)
            case ast.Compare(left=left, ops=operators, comparators=rights):
                return self._chain(left, operators, rights)
            case _:
                raise self._refused(f"{self._source(node)!r} is not a comparison")

    def _chain(
        self, left: ast.expr, operators: Sequence[ast.cmpop], rights: Sequence[ast.expr]
    ) -> Where:
        """A chain of comparisons, as in `40 <= address < 50`."""
        terms = [self._term(node) for node in (left, *rights)]
        compares = []
        for one_operator in operators:
            compare = _COMPARISONS.get(type(one_operator))
            if compare is None:
                raise self._refused("compare with == and !=, not with is")
            compares.append(compare)

        def holds(one: NamedTransaction) -> bool:
            values = [term(one) for term in terms]
            if any(value is None for value in values):
                return False
            try:
                return all(
                    compare(values[at], values[at + 1]) for at, compare in enumerate(compares)
                )
            except TypeError:
                return False  # A number was compared with a text: it is neither more nor less.

        return holds

    def _term(self, node: ast.expr) -> _Value:
        match node:
            case ast.Tuple(elts=items) | ast.List(elts=items):
                parts = [self._single(item) for item in items]
                return lambda one: [part(one) for part in parts]
            case _:
                return self._single(node)

    def _single(self, node: ast.expr) -> _Value:
        match node:
            case ast.Name(id=name):
                if name not in NAMES:
                    raise UsageError(
                        f"--where {_short(self._text)!r}: there is no {_short(name)!r}; "
                        f"there are {', '.join(NAMES)}"
                    )
                return NAMES[name]
            case ast.Constant(value=int() | float() | str() as constant):
                return lambda _: constant
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as number)):
                return lambda _: -number
            case _:
                raise self._refused(
                    f"{self._source(node)!r} is neither a name, a number nor a text"
                )

    def _refused(self, why: str) -> UsageError:
        return UsageError(f"--where {_short(self._text)!r}: {why}; {_EXAMPLE}")

    def _source(self, node: ast.expr) -> str:
        return _short(ast.get_source_segment(self._text, node) or "")


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
