"""A dictionary of bounded size, for the state of many connections, units or requests."""

from __future__ import annotations

from collections import OrderedDict
from itertools import islice
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Hashable, Iterable, Iterator

K = TypeVar("K", bound="Hashable")
V = TypeVar("V")

MAX_ENTRIES = 4096


class LruDict(Generic[K, V]):
    """A dictionary that makes an entry for a missing key with `make`.

    When it has `limit` entries, it removes the least recently used one for each new one.
    """

    def __init__(self, make: Callable[[], V], limit: int = MAX_ENTRIES) -> None:
        self._make = make
        self._limit = limit
        self._entries: OrderedDict[K, V] = OrderedDict()

    def __getitem__(self, key: K) -> V:
        value = self._entries.get(key)
        if value is None:
            if len(self._entries) >= self._limit:
                self.pop_oldest()
            value = self._entries[key] = self._make()
        else:
            self._entries.move_to_end(key)
        return value

    def get(self, key: K) -> V | None:
        """Return the value of a key; None if there is none.

        Unlike `[]`, it makes no entry, and does not make the entry a recently used one.
        """
        return self._entries.get(key)

    def has_room(self, keys: Iterable[K]) -> bool:
        """True if entries for all these keys fit without removing another entry."""
        new = {key for key in keys if key not in self._entries}
        return len(self._entries) + len(new) <= self._limit

    def keeps(self, keys: Collection[K]) -> bool:
        """True if no entry of these keys that is there can be removed while all of them are used,
        in any order and each several times.
        """
        room = self._limit - len(self._entries)
        known = {key for key in keys if key in self._entries}
        if len(keys) - len(known) <= room or not known:
            return len(keys) <= self._limit
        newest = {*islice(reversed(self._entries), max(self._limit - len(keys), 0))}
        return known <= newest

    def __contains__(self, key: K) -> bool:
        return key in self._entries

    def __len__(self) -> int:
        return len(self._entries)

    def pop(self, key: K) -> V | None:
        return self._entries.pop(key, None)

    def pop_oldest(self) -> V:
        """Remove the least recently used entry and return its value. There must be one."""
        return self._entries.popitem(last=False)[1]

    def items(self) -> Iterator[tuple[K, V]]:
        yield from self._entries.items()

    def values(self) -> Iterator[V]:
        yield from self._entries.values()

    def clear(self) -> None:
        self._entries.clear()
