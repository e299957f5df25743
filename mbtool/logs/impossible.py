"""Counts the messages of a log that are left out because a number in them is out of range."""

# The types of the fields give the range of each number (modbus/transaction.py), such as 0 to 255
# for a unit. The recorder writes no number outside it, so such a message was made by another
# program or by hand.

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
    """Counts the messages that were left out, and keeps the fault of the first one."""

    def __init__(self) -> None:
        self._count = 0
        self._first = ""

    def note(self, error: Exception, data: bytes) -> bool:
        """Count a message if `error` says that a number in it is out of range; return True then.

        `error` was raised when the message `data` (JSON) was decoded. Returns False for an error of
        another cause.
        """
        match = _OUT_OF_RANGE.fullmatch(str(error))
        if match is None:
            return False
        self._count += 1
        if self._count == 1:
            shown = "" if match[2] else f" {_field(data, match[1])!r}"[:_SHOWN]
            self._first = f"{match[1]}{shown}, {str(error).partition(' - at ')[0]}"
        return True

    def events(self, ts_ns: int) -> Iterator[WireEvent]:
        """Yield one event that tells how many messages were left out; none if there were none.

        `ts_ns` is the event's time in UTC ns. A second call yields nothing.
        """
        if self._count:
            text = (
                f"{self._count} {plural(self._count, 'message')} of the log left out, with numbers "
                f"that nothing on a wire has; the first: {self._first}"
            )
            self._count = 0
            yield WireEvent(ts_ns=ts_ns, link="", kind=EventKind.UNREADABLE, message=text)


def _field(data: bytes, name: str) -> object:
    """Return the value of the field `name` of `data`, a message in JSON.

    Returns "too deep" if the message nests too deep to be parsed.
    """
    try:
        return msgspec.json.decode(data, type=dict[str, object])[name]
    except RecursionError:
        return "too deep"
