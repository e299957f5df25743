"""Counts the items of a log that are left out because a number in them is impossible."""

# The types of the fields give the range of each number (modbus/transaction.py). The recorder writes
# no number outside it, so such an item was made by another program or by hand.

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import EventKind, WireEvent
from mbtool.core.wording import plural

if TYPE_CHECKING:
    from collections.abc import Iterator

_OUT_OF_RANGE = re.compile(r"Expected `(?:int|float)` [<>]=? \S+ - at `\$\.(\w+)(\[[^\]]*\])?`")
_SHOWN = 40


class ImpossibleItems:
    """The number of items that were left out, and the fault of the first one."""

    def __init__(self) -> None:
        self._count = 0
        self._first = ""

    def note(self, error: Exception, data: bytes) -> bool:
        """Count an item of a log if a number in it is out of range; return False if none is."""
        match = _OUT_OF_RANGE.fullmatch(str(error))
        if match is None:
            return False
        self._count += 1
        if self._count == 1:
            shown = "" if match[2] else f" {_field(data, match[1])!r}"[:_SHOWN]
            self._first = f"{match[1]}{shown}, {str(error).partition(' - at ')[0]}"
        return True

    def events(self, ts_ns: int) -> Iterator[WireEvent]:
        """Give one event that counts the items, if there are any. A second call gives none."""
        if self._count:
            text = (
                f"{self._count} {plural(self._count, 'message')} of the log left out, with numbers "
                f"that nothing on a wire has; the first: {self._first}"
            )
            self._count = 0
            yield WireEvent(ts_ns=ts_ns, link="", kind=EventKind.UNREADABLE, message=text)


def _field(data: bytes, name: str) -> object:
    """The value of a field of a message; "too deep" if other fields keep it from being read."""
    try:
        return msgspec.json.decode(data, type=dict[str, object])[name]
    except RecursionError:
        return "too deep"
