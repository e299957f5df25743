"""Defines the names of the --where language, and rejects comparisons that are never true."""

# Each name has a kind (number, text, list), and some names a fixed set of texts. A comparison of
# different kinds, or with a text that the name never has, would select nothing without a word; so
# it is an error when the expression is parsed. A text may be searched in a text
# (`"HR4" in reference`); there any part will do.

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus import Outcome
from mbtool.modbus.adu import Transport, Verdict


class ValueKind(StrEnum):
    """The kind of a term; only terms of one kind can be compared."""

    NUMBER = "a number"
    TEXT = "a text"
    LIST = "a list"


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """One side of a comparison."""

    text: str
    """The term as error messages write it."""
    value: Callable[[NamedTransaction], Any]
    """Returns the term's value in a transaction; None if the transaction has no such value."""
    kind: ValueKind
    choices: tuple[str, ...] = ()
    """All texts that a name can have; empty if it can be any text."""
    constant: str | None = None
    """The text itself, if the term is a text in quotes; else None."""
    items: tuple[Term, ...] = ()
    """The members of a list; for a name, one term that stands for all members."""

    @property
    def described(self) -> str:
        if self.kind is ValueKind.LIST and len({item.kind for item in self.items}) == 1:
            return f"{self.text} is a list of {self.items[0].kind.removeprefix('a ')}s"
        return f"{self.text} is {self.kind}"


def why_never_true(left: Term, right: Term, *, membership: bool) -> str | None:
    """Say why a comparison can never be true, and what to write instead; None if it can.

    `membership` is True for `left in right`.
    """
    if not membership:
        return _why_never_equal(left, right)
    if right.kind is ValueKind.LIST:
        return _first(_why_never_equal(left, item) for item in right.items)
    if right.kind is ValueKind.TEXT:
        return None if left.kind is ValueKind.TEXT else _unlike(left, right)
    return f"{right.described}, and in looks into a list: unit in (1, 2)"


def _why_never_equal(left: Term, right: Term) -> str | None:
    if left.kind is ValueKind.LIST and right.kind is ValueKind.LIST:
        return _first(_why_never_equal(one, other) for one in left.items for other in right.items)
    for one, other in ((left, right), (right, left)):
        if one.kind is ValueKind.LIST:
            fits = not any(_why_never_equal(other, item) for item in one.items)
            return _unlike(left, right, f"write {other.text} in {one.text}" if fits else None)
        if one.choices and other.constant is not None and other.constant not in one.choices:
            return f"{one.text} is never {other.text}; it is {_either(one.choices)}"
    return None if left.kind is right.kind else _unlike(left, right)


def _unlike(left: Term, right: Term, instead: str | None = None) -> str:
    both = f"{left.described} and {right.described}"
    return f"{both}; {instead or 'they cannot be compared'}"


def _first(reasons: Iterable[str | None]) -> str | None:
    return next((one for one in reasons if one is not None), None)


def _either(choices: tuple[str, ...]) -> str:
    return f"{', '.join(choices[:-1])} or {choices[-1]}"


def _number(name: str, value: Callable[[NamedTransaction], Any]) -> Term:
    return Term(text=name, value=value, kind=ValueKind.NUMBER)


def _text(name: str, value: Callable[[NamedTransaction], Any], choices: Iterable[str] = ()) -> Term:
    return Term(text=name, value=value, kind=ValueKind.TEXT, choices=tuple(choices))


def _list(
    name: str,
    value: Callable[[NamedTransaction], Any],
    kind: ValueKind,
    choices: Iterable[str] = (),
) -> Term:
    item = Term(text=f"one of {name}", value=value, kind=kind, choices=tuple(choices))
    return Term(text=name, value=value, kind=ValueKind.LIST, items=(item,))


_TERMS = (
    _text("link", lambda one: one.link),
    _text("transport", lambda one: one.transport, Transport),
    _text("source", lambda one: one.source),
    _text("destination", lambda one: one.destination),
    _number("unit", lambda one: one.unit),
    _number("transaction_id", lambda one: one.transaction_id),
    _number("function", lambda one: one.function),
    _number("address", lambda one: one.address),
    _number("quantity", lambda one: one.quantity),
    _list(
        "values",
        lambda one: (one.request_values or []) + (one.response_values or []),
        ValueKind.NUMBER,
    ),
    _text("outcome", lambda one: one.outcome, Outcome),
    _number("exception", lambda one: one.exception),
    _number("latency_ms", lambda one: None if one.latency_ns is None else one.latency_ns / 1e6),
    _number("retries", lambda one: one.retries),
    _text("device", lambda one: one.device),
    _text("reference", lambda one: one.reference),
    _list("points", lambda one: [point.name for point in one.points], ValueKind.TEXT),
    _list("findings", lambda one: one.findings, ValueKind.TEXT),
    _list("verdicts", lambda one: one.verdicts, ValueKind.TEXT, Verdict),
)

NAMES = {term.text: term for term in _TERMS}
"""The names that an expression can use. README.md lists them."""
