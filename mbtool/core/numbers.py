"""Reads the numbers that a user writes, such as units and TCP ports."""

from __future__ import annotations

from mbtool.core.errors import UsageError

UNITS = range(0x100)
"""The unit numbers that a user may write: 0 to 255. Serial lines use 0 to 247; Modbus/TCP also uses
255."""


def parse_unit(text: str, where: str, others: str = "") -> int:
    """Read a unit number. Raises UsageError if `text` is no number from 0 to 255.

    `where` names the option for the text of the error, and `others` lists other values that are
    allowed there.
    """
    return parse_number(text, "unit", UNITS, where, others)


def parse_number(text: str, what: str, allowed: range, where: str, others: str = "") -> int:
    """Read a decimal number of ASCII digits.

    Raises UsageError if `text` is no such number or not in `allowed`. In the text of the error,
    `what` names the number, `where` names the option or text that it is part of, and `others` lists
    other values that are allowed there.
    """
    is_short = len(text) <= len(str(allowed.stop))
    if text.isascii() and text.isdecimal() and is_short and int(text) in allowed:
        return int(text)
    raise UsageError(
        f"{where}: {text!r} is no {what}; write a number from {allowed.start} to "
        f"{allowed.stop - 1}{others}"
    )
