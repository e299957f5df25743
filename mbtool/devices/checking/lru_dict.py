"""State for each of many things, of which only so many are kept."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

K = TypeVar("K", bound="Hashable")
V = TypeVar("V")

MAX_KEPT = 4096


class LruDict(Generic[K, V]):
    """A dictionary that makes what it lacks. Holds MAX_KEPT; the one used longest ago gives way."""

    def __init__(self, make: Callable[[], V], limit: int = MAX_KEPT) -> None:
        self._make = make
        self._limit = limit
        self._held: OrderedDict[K, V] = OrderedDict()

    def __getitem__(self, key: K) -> V:
        value = self._held.get(key)
        if value is None:
            if len(self._held) >= self._limit:
                self._held.popitem(last=False)
            value = self._held[key] = self._make()
        else:
            self._held.move_to_end(key)
        return value

    def get(self, key: K) -> V | None:
        """What there is of a key; nothing is made."""
        return self._held.get(key)

    def __contains__(self, key: K) -> bool:
        return key in self._held

    def __len__(self) -> int:
        return len(self._held)

    def pop(self, key: K) -> V | None:
        return self._held.pop(key, None)

    def items(self) -> Iterator[tuple[K, V]]:
        yield from self._held.items()

    def values(self) -> Iterator[V]:
        yield from self._held.values()

    def clear(self) -> None:
        self._held.clear()
