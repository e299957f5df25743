"""Compiles a --where expression into a test of transactions."""

# An expression has Python's comparisons of the names in NAMES, combined with and, or, not:
#
#     unit == 5 and function in (3, 16)
#     outcome == "exception" or latency_ms > 50
#     40 <= address < 50 and 17 in values
#
# A comparison is false if one of its names does not apply to the transaction. The expression is
# parsed, never evaluated as Python. Everything that is not a comparison is an error, and so is a
# comparison that can never be true, such as a number with a text (terms.py).
#
# Limits: MAX_LENGTH characters, and MAX_DEPTH levels of not, and, or and parentheses.

from __future__ import annotations

import ast
import operator
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from mbtool.core import UsageError
from mbtool.query.terms import NAMES, Term, ValueKind, why_never_true

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

Where = Callable[["NamedTransaction"], bool]

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
    """Compile an expression into a function that tells whether a transaction passes.

    Raises UsageError if the expression is wrong, is too long or has too many levels, or if one of
    its comparisons can never be true.
    """
    text = text.strip()
    if len(text) > MAX_LENGTH:
        raise UsageError(f"--where takes at most {MAX_LENGTH} characters, not {len(text)}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python warns of "\d", which is a valid text here.
            tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise UsageError(f"--where {_short(text)!r} is not an expression; {_EXAMPLE}") from error
    return _Compiler(text).condition(tree.body, MAX_DEPTH)


class _Compiler:
    """Turns the nodes of one expression's syntax tree into functions."""

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
        """Compile a chain of comparisons, as in `40 <= address < 50`."""
        terms = [self._term(node) for node in (left, *rights)]
        compares = []
        for at, one_operator in enumerate(operators):
            compare = _COMPARISONS.get(type(one_operator))
            if compare is None:
                raise self._refused("compare with == and !=, not with is")
            membership = isinstance(one_operator, ast.In | ast.NotIn)
            why = why_never_true(terms[at], terms[at + 1], membership=membership)
            if why is not None:
                raise self._wrong(why)
            compares.append(compare)

        def holds(one: NamedTransaction) -> bool:
            values = [term.value(one) for term in terms]
            if any(value is None for value in values):
                return False
            try:
                return all(
                    compare(values[at], values[at + 1]) for at, compare in enumerate(compares)
                )
            except TypeError:
                return False  # A name inside a list does not apply, so it cannot be ordered.

        return holds

    def _term(self, node: ast.expr) -> Term:
        match node:
            case ast.Tuple(elts=nodes) | ast.List(elts=nodes):
                items = tuple(self._single(item) for item in nodes)
                return Term(
                    text=self._source(node),
                    value=lambda one: [item.value(one) for item in items],
                    kind=ValueKind.LIST,
                    items=items,
                )
            case _:
                return self._single(node)

    def _single(self, node: ast.expr) -> Term:
        match node:
            case ast.Name(id=name):
                if name not in NAMES:
                    raise self._wrong(f"there is no {_short(name)!r}; there are {', '.join(NAMES)}")
                return NAMES[name]
            case ast.Constant(value=str() as text):
                return Term(
                    text=_short(repr(text)),
                    value=lambda _: text,
                    kind=ValueKind.TEXT,
                    constant=text,
                )
            case ast.Constant(value=int() | float() as number):
                return self._number(node, number)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as number)):
                return self._number(node, -number)
            case _:
                raise self._refused(
                    f"{self._source(node)!r} is neither a name, a number nor a text"
                )

    def _number(self, node: ast.expr, number: float) -> Term:
        return Term(text=self._source(node), value=lambda _: number, kind=ValueKind.NUMBER)

    def _refused(self, why: str) -> UsageError:
        return self._wrong(f"{why}; {_EXAMPLE}")

    def _wrong(self, why: str) -> UsageError:
        return UsageError(f"--where {_short(self._text)!r}: {why}")

    def _source(self, node: ast.expr) -> str:
        return _short(ast.unparse(node))


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
