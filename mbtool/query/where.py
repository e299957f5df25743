"""Compiles a --where expression into a function that tests a transaction."""

# An expression compares the names in NAMES (terms.py) as Python does, combined with and, or, not:
#
#     unit == 5 and function in (3, 16)
#     outcome == "exception" or latency_ms > 50
#     40 <= address < 50 and 17 in values
#     reference like "HR4*" or points matches "CH[1-4] "
#     point["Flow temperature"] > 60 or text["State"] == "off" or 23.4 in values
#     source == "10.0.0.66" and time >= "2026-11-22T09:14"
#
# There are two operators that Python lacks. `like` compares a whole text with wildcards: * for any
# characters, ? for one. `matches` looks for a regular expression of Python anywhere in a text. If
# the name stands for a list, one member must fit. An address with a port equals a text without a
# port if the hosts are equal.
#
# A comparison is false if one of its names does not apply to the transaction. The expression is
# parsed, never evaluated as Python. Everything that is not a comparison is an error, and so is a
# comparison that can never be true, such as a number with a text (terms.py).
#
# Limits: MAX_LENGTH characters, and MAX_DEPTH levels of not, and, or and parentheses. There is no
# limit for the time that a user's regular expression takes.

from __future__ import annotations

import ast
import difflib
import operator
import re
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from mbtool.core import UsageError
from mbtool.core.moments import parse_iso
from mbtool.query.mistakes import find_mistake
from mbtool.query.terms import (
    NAMES,
    USUAL_NAMES,
    WRONG_CRC,
    Term,
    ValueKind,
    is_at,
    point_term,
    why_never_true,
    why_out_of_range,
)

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction

Where = Callable[["NamedTransaction"], bool]

_Compare = Callable[[Any, Any], bool]

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
_ENDPOINT_COMPARISONS: dict[type[ast.cmpop], _Compare] = {
    ast.Eq: is_at,
    ast.NotEq: lambda one, text: not is_at(one, text),
    ast.In: lambda one, texts: any(text is not None and is_at(one, text) for text in texts),
    ast.NotIn: lambda one, texts: not any(text is not None and is_at(one, text) for text in texts),
}
"""The comparisons of an address with a port (HOST:PORT) and texts that may lack the port."""
_SIGNS: dict[type[ast.cmpop], str] = {
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.In: "in",
    ast.NotIn: "not in",
}

_STRING = r"""(?:"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')"""
_WORDS_AND_TEXTS = re.compile(
    rf"\b(?P<word>like|matches)\s*(?P<pattern>r?{_STRING})|{_STRING}", re.DOTALL
)

MAX_LENGTH = 10_000
MAX_DEPTH = 50

_EXAMPLE = "for example: unit == 5 and function in (3, 16)"
_SHOWN = 60


def parse_where(text: str) -> Where:
    """Compile an expression into a function that returns True for a transaction that it selects.

    Raises UsageError if the expression is wrong, is too long or has too many levels, or if one of
    its comparisons can never be true.
    """
    text = text.strip()
    if len(text) > MAX_LENGTH:
        raise UsageError(f"--where takes at most {MAX_LENGTH} characters, not {len(text)}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python warns of "\d", which is valid in a pattern.
            source = _WORDS_AND_TEXTS.sub(_as_call, text)
            tree = ast.parse(source, mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        mistake = find_mistake(text)
        why = f"; {_EXAMPLE}" if mistake is None else f": {mistake.told}"
        raise UsageError(f"--where {_cut_text(text)!r} is not an expression{why}") from error
    return _Compiler(text, source).condition(tree.body, MAX_DEPTH)


class _Compiler:
    """Turns the nodes of an expression's syntax tree into functions that test a transaction."""

    def __init__(self, text: str, source: str) -> None:
        """`text` is the expression of the user; `source` is the same as valid Python."""
        self._text = text
        self._lines = [line.encode() for line in re.split(r"\r\n?|\n", source)]

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
            case ast.Compare(
                left=left, ops=[(ast.In() | ast.NotIn()) as one], comparators=[ast.Call() as call]
            ):
                return self._fitting(left, call, negated=isinstance(one, ast.NotIn))
            case ast.Compare(left=left, ops=operators, comparators=rights):
                return self._chain(left, operators, rights)
            case _:
                raise self._refused(f"{self._source(node)!r} is not a comparison")

    def _chain(
        self, left: ast.expr, operators: Sequence[ast.cmpop], rights: Sequence[ast.expr]
    ) -> Where:
        """Compile a chain of comparisons, such as `40 <= address < 50`.

        `left` is its first term, `rights` has the term after each operator.
        """
        terms = [self._term(node) for node in (left, *rights)]
        compares = []
        for at, one_operator in enumerate(operators):
            compare = _COMPARISONS.get(type(one_operator))
            if compare is None:
                raise self._refused("compare with == and !=, not with is")
            membership = isinstance(one_operator, ast.In | ast.NotIn)
            self._read_moments(terms, at)
            left_term, right_term = terms[at], terms[at + 1]
            why = why_never_true(left_term, right_term, membership=membership)
            why = why or why_out_of_range(left_term, right_term, _SIGNS[type(one_operator)])
            if why is not None:
                raise self._usage_error(why)
            compares.append(_endpoint_comparison(left_term, right_term, one_operator) or compare)

        def holds(one: NamedTransaction) -> bool:
            values = [term.value(one) for term in terms]
            if any(value is None for value in values):
                return False
            try:
                return all(
                    compare(values[at], values[at + 1]) for at, compare in enumerate(compares)
                )
            except TypeError:
                return False  # A member of a list is None, which cannot be less or greater.

        return holds

    def _read_moments(self, terms: list[Term], at: int) -> None:
        """If a text is compared with a time, replace the text by the time that it names.

        `terms[at]` and `terms[at + 1]` are the two sides of the comparison. Raises UsageError if
        the text is no time in ISO 8601.
        """
        for one, other in ((at, at + 1), (at + 1, at)):
            text = terms[other].constant
            if terms[one].kind is not ValueKind.MOMENT or text is None:
                continue
            ns = parse_iso(text)
            if ns is None:
                raise self._usage_error(
                    f"{text[:_SHOWN]!r} is no moment; write 2026-11-22T09:14:03"
                )
            terms[other] = _moment(repr(text), ns)

    def _fitting(self, left: ast.expr, call: ast.Call, *, negated: bool) -> Where:
        """Compile `left like "..."` or `left matches "..."`; with `negated`, `left not like "..."`.

        `call` is the right side, which the parser sees as a call: like("...").
        """
        match call:
            case ast.Call(
                func=ast.Name(id="like" | "matches" as word),
                args=[ast.Constant(value=str() as pattern)],
                keywords=[],
            ):
                fits = self._pattern(word, pattern)
            case _:
                raise self._refused(f"{self._source(call)!r} is not a name, a number or a text")
        term = self._term(left)
        of_texts = {item.kind for item in term.items} == {ValueKind.TEXT}
        if term.kind is not ValueKind.TEXT and not of_texts:
            raise self._usage_error(f"{term.described}; {word} looks at texts")
        choices = term.choices or tuple(one for item in term.items for one in item.choices)
        if choices and not any(map(fits, choices)):
            raise self._usage_error(
                f"{term.text} never fits {pattern!r}; it is {', '.join(choices)}"
            )

        def holds(one: NamedTransaction) -> bool:
            value = term.value(one)
            if value is None:
                return False
            texts = [value] if isinstance(value, str) else value
            return any(text is not None and fits(text) for text in texts) is not negated

        return holds

    def _pattern(self, word: str, pattern: str) -> Callable[[str], bool]:
        if word == "like":
            found = re.compile(_wildcards(pattern), re.DOTALL)
            return lambda text: found.fullmatch(text) is not None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Python warns of patterns that may change later.
                found = re.compile(pattern)
        except re.error as error:
            place = "" if error.pos is None else f" at character {error.pos + 1}"
            raise self._usage_error(
                f"the pattern {_cut_text(pattern)!r}: {error.msg}{place}"
            ) from None
        except (OverflowError, RecursionError) as error:
            raise self._usage_error(f"the pattern {_cut_text(pattern)!r}: {error}") from None
        return lambda text: found.search(text) is not None

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
                    self._refuse_unquoted(name)
                    near = difflib.get_close_matches(name, NAMES, n=1)
                    meant = f", did you mean {near[0]!r}?" if near else ";"
                    raise self._usage_error(
                        f"there is no {_cut_text(name)!r}{meant} "
                        f"there are {', '.join(USUAL_NAMES)}, "
                        "and the other fields of docs/filters.md"
                    )
                return NAMES[name]
            case ast.Subscript(
                value=ast.Name(id="point" | "text" as word),
                slice=ast.Constant(value=str() as name),
            ):
                return point_term(name, is_text=word == "text")
            case ast.Constant(value=str() as text):
                return Term(
                    text=_cut_text(repr(text)),
                    value=lambda _: text,
                    kind=ValueKind.TEXT,
                    constant=text,
                )
            case ast.Constant(value=int() | float() as number):
                return self._number(node, number)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as number)):
                return self._number(node, -number)
            case _:
                self._refuse_unquoted(ast.unparse(node).replace(" ", ""))
                raise self._refused(
                    f"{self._source(node)!r} is neither a name, a number nor a text"
                )

    def _refuse_unquoted(self, text: str) -> None:
        """Raise UsageError if `text` is one that a name can have, or a date, but lacks quotes."""
        if any(text in term.choices for term in NAMES.values()):
            raise self._usage_error(f'{text!r} is a text; write "{text}"')
        if "crc" in text.lower() or "lrc" in text.lower():
            raise self._usage_error(f"there is no {_cut_text(text)!r}; {WRONG_CRC}")
        if parse_iso(text) is not None:
            raise self._usage_error(f'{text!r} is a moment; write "{text}"')

    def _number(self, node: ast.expr, number: float) -> Term:
        # Show the number as the user wrote it, because Python would write 1e999 as 1e309, and 1e5
        # as 100000.0.
        text = self._source(node)
        if node.lineno == node.end_lineno:
            raw = self._lines[node.lineno - 1][node.col_offset : node.end_col_offset]
            text = _cut_text(raw.decode())
        return Term(text=text, value=lambda _: number, kind=ValueKind.NUMBER, number=number)

    def _refused(self, why: str) -> UsageError:
        return self._usage_error(f"{why}; {_EXAMPLE}")

    def _usage_error(self, why: str) -> UsageError:
        return UsageError(f"--where {_cut_text(self._text)!r}: {why}")

    def _source(self, node: ast.expr) -> str:
        return _cut_text(ast.unparse(node))


def _as_call(match: re.Match[str]) -> str:
    """Replace `like "..."` by `in like("...")`, which is valid Python; the same for `matches`.

    The regular expression of `match` also finds each text in quotes, so that no word inside of it
    is replaced; such a match stays as it is.
    """
    word, pattern = match["word"], match["pattern"]
    if word is None:
        return match[0]
    # Make the text a raw string, because a backslash in it belongs to the regular expression.
    raw = "r" if word == "matches" and not pattern.startswith("r") else ""
    return f"in {word}({raw}{pattern})"


def _wildcards(pattern: str) -> str:
    """Turn a pattern with wildcards (* for any text, ? for one character) into a regular
    expression.
    """
    signs = {"*": ".*", "?": "."}
    return "".join(signs.get(one) or re.escape(one) for one in pattern)


def _endpoint_comparison(left: Term, right: Term, sign: ast.cmpop) -> _Compare | None:
    """Return a function for the comparison of an endpoint with texts that may lack the port.

    An endpoint is an address with a port. Returns None for any other comparison, such as
    `"10.0" in source`, which looks for a part of the text. `sign` is the operator.
    """
    is_equality = isinstance(sign, ast.Eq | ast.NotEq)
    if right.is_endpoint and left.constant is not None and is_equality:
        compare = _ENDPOINT_COMPARISONS[type(sign)]
        return lambda text, one: compare(one, text)
    is_listed = right.kind is ValueKind.LIST and isinstance(sign, ast.In | ast.NotIn)
    if left.is_endpoint and (is_listed or (is_equality and right.constant is not None)):
        return _ENDPOINT_COMPARISONS[type(sign)]
    return None


def _moment(text: str, ns: int) -> Term:
    return Term(text=text, value=lambda _: ns, kind=ValueKind.MOMENT)


def _cut_text(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
