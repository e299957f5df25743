"""Finds the usual mistakes in a --where text that is no expression, and says what to write."""

from __future__ import annotations

import re
from typing import NamedTuple

from mbtool.query.terms import NAMES

_STRING = r"""(?:"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')"""
_QUOTED = re.compile(_STRING, re.DOTALL)
_SIGNS = {
    "=": "==", "=>": ">=", "=<": "<=", "=!": "!=", "<>": "!=", "===": "==", "&&": "and",
    "||": "or", "!": "not",
}  # fmt: skip
"""Operators of other languages, and what stands for them here."""
_SIGN = re.compile(r"[=<>!]+|&&|\|\|")
_WORD = re.compile(r"\b(?:AND|OR|NOT|IN|LIKE|MATCHES)\b")
_TIME = re.compile(r"\b(?:[0-9]{4}-[0-9]{2}-[0-9]{2}|[0-9]{1,2}:[0-9]{2})")
_PATTERN = re.compile(r"\b(?P<word>like|matches)\s+(?![\s_]|r_)")
_NO_OPERATOR = re.compile(rf"\b(?P<name>{'|'.join(NAMES)})\s+(?P<value>[0-9][\w.]*|_{{2,}}|[\w-]+)")
_LONGEST = 60
"""A value that is longer, in characters, is not shown again."""


class Mistake(NamedTuple):
    """A mistake in a text."""

    at: int
    """The index in the text of the mistake's first character."""
    told: str
    """Advice to the user what to write instead."""


def find_mistake(text: str) -> Mistake | None:
    """Return the first usual mistake in a text that is no expression; None if none is known."""
    bare = _QUOTED.sub(lambda match: "_" * len(match[0]), text)
    found = [
        *(_sign_mistake(match) for match in _SIGN.finditer(bare)),
        *(Mistake(one.start(), f"write {one[0].lower()}") for one in _WORD.finditer(bare)),
        *(_time_mistake(match) for match in _TIME.finditer(bare)),
        *(_pattern_mistake(match) for match in _PATTERN.finditer(bare)),
        *(_missing_operator_mistake(match, text) for match in _NO_OPERATOR.finditer(bare)),
    ]
    return min((one for one in found if one is not None), default=None)


def _sign_mistake(match: re.Match[str]) -> Mistake | None:
    instead = _SIGNS.get(match[0])
    return None if instead is None else Mistake(match.start(), f"write {instead}")


def _time_mistake(match: re.Match[str]) -> Mistake:
    return Mistake(match.start(), 'write a time in quotes: "2026-11-22T09:14:03"')


def _pattern_mistake(match: re.Match[str]) -> Mistake:
    return Mistake(match.end(), f"write the text behind {match['word']} in quotes")


def _missing_operator_mistake(match: re.Match[str], text: str) -> Mistake | None:
    """Tell of a name with a value behind it, but no operator between them."""
    name, value = match["name"], text[match.start("value") : match.end("value")]
    if len(value) > _LONGEST or not value.isprintable():
        return None
    if not value[0].isdigit() and value[0] not in "\"'":
        if value not in NAMES[name].choices:
            return None
        value = f'"{value}"'
    return Mistake(match.start("value"), f"write {name} == {value}")
