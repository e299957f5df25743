"""Writes a count with its noun, and a duration with its unit, for messages and tables."""

from __future__ import annotations


def counted(count: int, noun: str, separator: str = ",") -> str:
    """A count and its noun: `1 packet`, `2,000 packets`. The separator stands between thousands."""
    return f"{count:{separator}} {plural(count, noun)}"


def plural(count: int, noun: str) -> str:
    """A noun in singular form, with an "s" added unless the count is 1."""
    return noun if count == 1 else f"{noun}s"


def milliseconds(ns: float) -> str:
    """A duration in ns as a text in ms with one decimal: 8_249_999 becomes `8.2 ms`."""
    return f"{ns / 1e6:.1f} ms"
