"""Words for a number of things."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """`1 request`, `2,000 requests`."""
    return f"{number:,} {plural(number, noun)}"


def plural(number: int, noun: str) -> str:
    """`request` for one, `requests` for any other number."""
    return noun if number == 1 else f"{noun}s"
