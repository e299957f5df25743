"""Returns the items of a recording, such as requests, when their time comes, or one by one while
paused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from mbtool.replay.clock import PlayClock


class PlayItem(Protocol):
    """A part of a recording, such as a request. It is to be played at `position_ns` (ns of recorded
    time since the beginning of the played part).
    """

    @property
    def position_ns(self) -> int: ...


_Item = TypeVar("_Item", bound=PlayItem)


class PlayQueue(Generic[_Item]):
    """The items of a recording, such as requests, in order of time; in a loop they begin again."""

    def __init__(self, items: Sequence[_Item], clock: PlayClock) -> None:
        self._items = items
        self._clock = clock
        self._next = 0
        self._lap = 0
        self._steps = 0
        """The number of items that may still be played although the clock is paused: one for each
        press of the step key."""

    @property
    def taken(self) -> int:
        """The number of items played; in a loop, of all laps together."""
        return self._lap * len(self._items) + self._next

    def upcoming(self, *, may_restart: bool = True) -> _Item | None:
        """Return the next item; None after the last one.

        In a loop a new lap begins after the last item, but only if `may_restart` is true.
        """
        if self._next >= len(self._items):
            if not (self._clock.is_loop and self._items and may_restart):
                return None
            self._next, self._lap = 0, self._lap + 1
        return self._items[self._next]

    def allow_step(self) -> None:
        """Let one more item be played although the clock is paused: the user has pressed the step
        key.
        """
        self._steps += 1

    def due_ns(self, item: _Item, now_ns: int) -> int | None:
        """Return the real time (ns) at which `item`, the next one, may be played; `now_ns` if
        `allow_step` permits it.

        None if the clock is paused and `allow_step` was not called for it. As soon as the clock
        runs again, unused permissions are dropped.
        """
        due_ns = self._clock.time_of(self._position(item))
        if due_ns is not None:
            self._steps = 0
        elif self._steps:
            due_ns = now_ns
        return due_ns

    def take(self, item: _Item, now_ns: int, *, is_step: bool = True) -> bool:
        """Mark `item`, the next one, as played at the real time `now_ns`. With `is_step` False it
        uses up no press of the step key.

        Returns True if the item was due by the clock, False if the user played it with the step
        key. In the second case the clock moves to the item's position.
        """
        position_ns = self._position(item)
        self._next += 1
        if not self._steps or not is_step:
            return True
        self._steps -= 1
        self._clock.jump(max(position_ns, self._clock.position(now_ns)), now_ns)
        return False

    def _position(self, item: _Item) -> int:
        return item.position_ns + self._clock.lap_begin(self._lap)
