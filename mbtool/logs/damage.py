"""What of a log is damaged: counted while it is read, told when it has been."""

# One byte that changed costs the record that it stands in, and no more: what is left out is counted
# here, and a hole among the items is told where it is, so that nobody joins what stands before it
# to what stands behind.
#
# Holds the first damage and counts, however many there are.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import DamageError, EventKind, WireEvent
from mbtool.core.wording import counted

if TYPE_CHECKING:
    from mbtool.core import InputError


class Damage:
    """The damaged places of one log; false where there are none."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._first = ""
        self._places = 0
        self._left_out = 0
        self._hole = 0
        self._hole_at = 0

    def __bool__(self) -> bool:
        return self._places > 0

    def add(self, error: DamageError, left_out: int = 0) -> None:
        """Count a damaged place, for which so many bytes of the log are left out."""
        if not self._places:
            self._first = str(error).removeprefix(f"{self._name}: ")
        self._places += 1
        self._left_out += left_out

    def add_hole(self, error: DamageError, offset: int, left_out: int) -> None:
        """Count a damaged place that may have held items."""
        self.add(error, left_out)
        if not self._hole:
            self._hole_at = offset
        self._hole += left_out

    def hole(self, ts_ns: int) -> list[WireEvent]:
        """The hole before an item of this time, if there is one that is not told yet.

        A time of 0 is none: nothing stands around the hole.
        """
        if not self._hole or not ts_ns:
            return []
        message = (
            f"{self._hole} bytes of the log, from byte {self._hole_at} on, are damaged and left out"
        )
        self._hole = 0
        return [WireEvent(ts_ns=ts_ns, link="", kind=EventKind.GAP, message=message)]

    def error(self) -> DamageError:
        """What to raise where a log was read to its end."""
        rest = ", all else was read" if self._left_out else ""
        return DamageError(f"{self._name}: {self._told()}{rest}")

    def joined_to(self, end: InputError) -> InputError:
        """What to raise where reading ended with an error."""
        return type(end)(f"{end}; before that, {self._told()}")

    def _told(self) -> str:
        told = self._first
        if self._places > 1:
            told += f", and at {counted(self._places - 1, 'more place')}"
        if self._left_out:
            told += f"; {self._left_out} bytes of the log are left out"
        return told
