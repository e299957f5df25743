"""Counts the damaged places of a log while it is read, and reports them."""

# A damaged byte costs only the record that holds it. Skipped records are counted here. Where items
# (chunks, packets, transactions, events) may be missing, a GAP event is put among the items, so
# that the decoder does not join bytes from before the damage to bytes from after it.
#
# Memory: the text of the first damage, and counts.

from __future__ import annotations

import re
from collections.abc import Iterator

import msgspec

from mbtool.core import DamageError, EventKind, InputError, WireEvent
from mbtool.core.moments import counted, plural

# ImpossibleItems counts the messages of a log that are left out because a number is out of range.
#
# The types of the fields give the range of each number (modbus/transaction.py), such as 0 to 255
# for a unit. The recorder writes no number outside it, so such a message was made by another
# program or by hand.

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


_MENDED = "mbtool recover makes a whole log of it"


class Damage:
    """Collects the damaged places of one log. Its truth value is False while there are none."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._first = ""
        self._places = 0
        self._skipped = 0
        """The number of bytes of the log that were skipped in all."""
        self._hole = 0
        """The number of skipped bytes, since the last GAP event, that may have held captured bytes,
        transactions or events."""
        self._hole_at = 0

    def __bool__(self) -> bool:
        return self._places > 0

    def add(self, error: DamageError, skipped: int = 0) -> None:
        """Count a damaged place, which `error` describes.

        `skipped` is the number of bytes that the reader skipped there. If they may have held
        captured bytes, transactions or events, call `add_hole` instead.
        """
        if not self._places:
            self._first = str(error).removeprefix(f"{self._name}: ")
        self._places += 1
        self._skipped += skipped

    def add_hole(self, error: DamageError, offset: int, skipped: int) -> None:
        """Count a damaged place, which `error` describes, and prepare a GAP event for it.

        The place is at file offset `offset`. The reader skipped `skipped` bytes there, which may
        have held captured bytes, transactions or events.
        """
        self.add(error, skipped)
        if not self._hole:
            self._hole_at = offset
        self._hole += skipped

    def take_gap(self, ts_ns: int) -> list[WireEvent]:
        """Return a list with one GAP event for the items lost since the last GAP event.

        The list is empty if nothing was lost. `ts_ns` is the time of the event, UTC ns. 0 means
        that no item was read so far; the list is then empty, too, as a gap lies between two items.
        """
        if not self._hole or not ts_ns:
            return []
        message = (
            f"{self._hole} bytes of the log, from byte {self._hole_at} on, are damaged and left out"
        )
        self._hole = 0
        return [WireEvent(ts_ns=ts_ns, link="", kind=EventKind.GAP, message=message)]

    def error(self) -> DamageError:
        """Return the error to raise when a damaged log was read to its end."""
        rest = ", all else was read" if self._skipped else ""
        return DamageError(f"{self._name}: {self._summary()}{rest}; {_MENDED}")

    def added_to(self, end: InputError) -> InputError:
        """Return an error like `end` whose text also tells of the damage.

        `end` is the error because of which the rest of the log could not be read.
        """
        return type(end)(f"{end}; before that, {self._summary()}")

    def _summary(self) -> str:
        summary = self._first
        if self._places > 1:
            summary += f", and at {counted(self._places - 1, 'more place')}"
        if self._skipped:
            summary += f"; {self._skipped} bytes of the log are left out"
        return summary
