"""Finds the small changes that can be made to a Python module."""

# Kinds, each an edit of the source text, so that line numbers stay:
#
#     a < b          a <= b; also <=, >, >=, ==, !=, is, in and their opposites
#     7              8 and 6 (a negative literal is the unary minus and its number); from LARGE on
#                    the double and the half: that 60 s become 60 s and 1 ns need not be noticed
#     a and b        a or b, and the other way round
#     if a, a if b   if not (a); `not a` becomes `a`
#     a + b          a - b; * and //, / and *, << and >>, & and |, % becomes //
#     return a       return None, but for `return False`, which is as false
#     Enum.ONE       Enum.TWO, the next member, for the enums of mbtool/
#     a statement    pass: calls, assignments to attributes and items, += and the like, raise,
#                    break and continue
#
# Nothing is changed in annotations, decorators, options of a class (frozen=True), docstrings,
# __all__, __slots__, `if TYPE_CHECKING` and `if __name__`; also not in assert statements, which
# only tell mypy.

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

_COMPARED: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: (r"is\s+not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: (r"not\s+in", "in"),
}
_CALCULATED: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "//"),
    ast.FloorDiv: ("//", "*"),
    ast.Div: ("/", "*"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.BitXor: ("^", "|"),
    ast.Mod: ("%", "//"),
}
_NOT_CHANGED = {"__all__", "__slots__"}
LARGE = 10_000


@dataclass(frozen=True, slots=True, order=True)
class Mutation:
    """One change of one module."""

    path: str
    start: int
    """Where the changed text begins in the module, in bytes."""
    end: int
    after: str
    before: str = field(compare=False)
    line: int = field(compare=False)
    """The number of the line in which it begins, from 1."""
    text: str = field(compare=False)
    """That line."""

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What mutants_equivalent.toml names it by."""
        return self.path, self.text, self.before, self.after

    def applied_to(self, source: bytes) -> bytes:
        return source[: self.start] + self.after.encode() + source[self.end :]

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.before!r} -> {self.after!r} in: {self.text}"


def enum_members(paths: Iterable[Path]) -> dict[str, list[str]]:
    """The members of each enum that some modules define, by the enum's name."""
    return {
        node.name: members
        for path in paths
        for node in ast.walk(ast.parse(path.read_bytes()))
        if isinstance(node, ast.ClassDef)
        and any(ast.unparse(base).endswith("Enum") for base in node.bases)
        and len(members := _members(node)) > 1
    }


def _members(enum: ast.ClassDef) -> list[str]:
    return [
        target.id
        for statement in enum.body
        if isinstance(statement, ast.Assign)
        for target in statement.targets
        if isinstance(target, ast.Name)
    ]


def mutations_of(
    path: str, source: bytes, enums: Mapping[str, list[str]] | None = None
) -> list[Mutation]:
    """Every mutation of a module, in the order of their places."""
    return sorted(set(_Finder(ModuleText(path, source), enums or {}).found(ast.parse(source))))


class ModuleText:
    """The source text of a module, and where its nodes stand in it."""

    def __init__(self, path: str, source: bytes) -> None:
        self.path = path
        self.source = source
        self._lines = source.splitlines(keepends=True)
        self._starts = [0]
        for line in self._lines:
            self._starts.append(self._starts[-1] + len(line))

    def start(self, node: ast.expr | ast.stmt) -> int:
        """Where a node begins, in bytes."""
        return self._starts[node.lineno - 1] + node.col_offset

    def end(self, node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._starts[node.end_lineno - 1] + node.end_col_offset

    def of(self, node: ast.expr | ast.stmt) -> str:
        return self.source[self.start(node) : self.end(node)].decode()

    def replaced(self, node: ast.expr | ast.stmt, after: str) -> Mutation:
        return self.mutation(self.start(node), self.end(node), after)

    def mutation(self, start: int, end: int, after: str) -> Mutation:
        line = self.source.count(b"\n", 0, start) + 1
        before = self.source[start:end].decode()
        text = self._lines[line - 1].decode().strip()
        return Mutation(self.path, start, end, after, before, line, text)


class _Finder:
    """Looks through one module."""

    def __init__(self, text: ModuleText, enums: Mapping[str, list[str]]) -> None:
        self._text = text
        self._enums = enums

    def found(self, node: ast.AST) -> Iterator[Mutation]:
        """The mutations of a node and of all below it."""
        if self._is_kept(node):
            return
        yield from self._own(node)
        for name, value in ast.iter_fields(node):
            if name in {"annotation", "returns", "decorator_list", "bases"}:
                continue
            if name == "keywords" and isinstance(node, ast.ClassDef):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from self.found(child)

    @staticmethod
    def _is_kept(node: ast.AST) -> bool:
        match node:
            case ast.Assert() | ast.JoinedStr() | ast.Import() | ast.ImportFrom():
                return True
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                return True
            case ast.If(test=ast.Compare(left=ast.Name(id="__name__"))):
                return True
            case ast.Assign(targets=[ast.Name(id=name)]):
                return name in _NOT_CHANGED
            case ast.Expr(value=ast.Constant()):
                return True
            case _:
                return False

    def _own(self, node: ast.AST) -> Iterator[Mutation]:
        match node:
            case ast.Compare(left=left, ops=ops, comparators=others):
                for before, kind, after in zip([left, *others], ops, others, strict=False):
                    yield from self._operator(before, after, *_COMPARED[type(kind)])
            case ast.BinOp(op=ast.BitOr()) if _is_type(node.left) or _is_type(node.right):
                return
            case ast.BinOp(left=left, op=kind, right=right) if type(kind) in _CALCULATED:
                old, new = _CALCULATED[type(kind)]
                yield from self._operator(left, right, re.escape(old), new)
            case ast.BoolOp(op=kind, values=values):
                old, new = ("and", "or") if isinstance(kind, ast.And) else ("or", "and")
                for before, after in pairwise(values):
                    yield from self._operator(before, after, old, new)
            case ast.UnaryOp(op=ast.Not()):
                start = self._text.start(node)
                yield self._text.mutation(start, start + len("not "), "")
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
                if not isinstance(test, ast.UnaryOp | ast.Compare | ast.Constant):
                    yield self._text.replaced(test, f"not ({self._text.of(test)})")
            case ast.Constant(value=int(number)) if not isinstance(number, bool):
                yield self._text.replaced(node, str(2 * number if number >= LARGE else number + 1))
                if number >= LARGE:
                    yield self._text.replaced(node, str(number // 2))
                elif number:
                    yield self._text.replaced(node, str(number - 1))
            case ast.Constant(value=bool(value)):
                yield self._text.replaced(node, str(not value))
            case ast.Attribute(value=ast.Name(id=enum), attr=member):
                members = self._enums.get(enum, ())
                if member in members:
                    new = members[(members.index(member) + 1) % len(members)]
                    yield self._text.replaced(node, f"{enum}.{new}")
            case ast.Return(value=ast.expr() as value):
                left_alone = isinstance(value, ast.Constant) and (
                    value.value is None or value.value is False
                )
                if not left_alone:
                    yield self._text.replaced(node, "return None")
            case ast.Expr(value=ast.Call()):
                yield self._text.replaced(node, "pass")
            case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
                yield self._text.replaced(node, "pass")
            case ast.AugAssign() | ast.Raise() | ast.Break() | ast.Continue():
                yield self._text.replaced(node, "pass")

    def _operator(
        self, left: ast.expr, right: ast.expr, pattern: str, after: str
    ) -> Iterator[Mutation]:
        """Change the operator between two operands; parentheses may stand beside it."""
        start, end = self._text.end(left), self._text.start(right)
        between = self._text.source[start:end].decode()
        edge = r"\b" if pattern[0].isalpha() else ""
        found = re.search(edge + pattern + edge, re.sub(r"#.*", _blank, between))
        if found is not None:
            at = start + len(between[: found.start()].encode())
            yield self._text.mutation(at, at + len(found[0]), after)


def _is_type(node: ast.expr) -> bool:
    """True if an operand of `|` names a class, so that the whole is a union of types."""
    match node:
        case ast.BinOp(op=ast.BitOr(), left=left):
            return _is_type(left)
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name[0].isupper() and not name.isupper()
        case _:
            return False


def _blank(comment: re.Match[str]) -> str:
    """As many spaces as a comment has characters."""
    return " " * len(comment[0])
