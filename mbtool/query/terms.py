"""What a --where expression can speak of, and which comparisons of it can ever hold."""

# Each name has a kind, and some a fixed set of words. A comparison across kinds, or with a word
# that the name never has, would silently choose nothing; so it is refused when the expression is
# read. Texts may be looked for in texts (`"HR4" in reference`); there a part of a word will do.

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus import Outcome
from mbtool.modbus.adu import Transport, Verdict


class ValueKind(StrEnum):
    """What can be compared with what."""

    NUMBER = "a number"
    TEXT = "a text"
    LIST = "a list"


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """One side of a comparison."""

    text: str
    """How the expression, or this program, writes it."""
    value: Callable[[NamedTransaction], Any]
    kind: ValueKind
    words: tuple[str, ...] = ()
    """All that a name's text can be; none where it can be anything."""
    constant: str | None = None
    """A text that stands in the expression itself."""
    items: tuple[Term, ...] = ()
    """What a list can hold: its members, or for a name one that stands for all of them."""

    @property
    def described(self) -> str:
        if self.kind is ValueKind.LIST and len({item.kind for item in self.items}) == 1:
            return f"{self.text} is a list of {self.items[0].kind.removeprefix('a ')}s"
        return f"{self.text} is {self.kind}"


def complaint(left: Term, right: Term, *, membership: bool) -> str | None:
    """Why a comparison can never hold, and what would be right; None where it can.

    `membership` says that the left is looked for in the right.
    """
    if not membership:
        return _of_equals(left, right)
    if right.kind is ValueKind.LIST:
        return _first(_of_equals(left, item) for item in right.items)
    if right.kind is ValueKind.TEXT:
        return None if left.kind is ValueKind.TEXT else _unlike(left, right)
    return f"{right.described}, and in looks into a list: unit in (1, 2)"


def _of_equals(left: Term, right: Term) -> str | None:
    if left.kind is ValueKind.LIST and right.kind is ValueKind.LIST:
        return _first(_of_equals(one, other) for one in left.items for other in right.items)
    for one, other in ((left, right), (right, left)):
        if one.kind is ValueKind.LIST:
            fits = not any(_of_equals(other, item) for item in one.items)
            return _unlike(left, right, f"write {other.text} in {one.text}" if fits else None)
        if one.words and other.constant is not None and other.constant not in one.words:
            return f"{one.text} is never {other.text}; it is {_either(one.words)}"
    return None if left.kind is right.kind else _unlike(left, right)


def _unlike(left: Term, right: Term, instead: str | None = None) -> str:
    both = f"{left.described} and {right.described}"
    return f"{both}; {instead or 'they cannot be compared'}"


def _first(complaints: Iterable[str | None]) -> str | None:
    return next((one for one in complaints if one is not None), None)


def _either(words: tuple[str, ...]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def _number(name: str, value: Callable[[NamedTransaction], Any]) -> Term:
    return Term(text=name, value=value, kind=ValueKind.NUMBER)


def _text(name: str, value: Callable[[NamedTransaction], Any], words: Iterable[str] = ()) -> Term:
    return Term(text=name, value=value, kind=ValueKind.TEXT, words=tuple(words))


def _list(
    name: str,
    value: Callable[[NamedTransaction], Any],
    kind: ValueKind,
    words: Iterable[str] = (),
) -> Term:
    item = Term(text=f"one of {name}", value=value, kind=kind, words=tuple(words))
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
"""Each name and what it is of a transaction: None where it does not apply."""
