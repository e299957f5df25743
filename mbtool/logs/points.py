"""Finds the points (named values of devices) that have changed since they were last seen."""

# Memory: the last value of at most MAX_POINTS points. Beyond that, the point that has not changed
# for the longest time is forgotten; it counts as changed when it is seen again.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.logs.messages import PointMessage

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices import NamedTransaction

MAX_POINTS = 65536


class PointChanges:
    """Finds changed points (named values) in transactions.

    A point's first value counts as a change.
    """

    def __init__(self, limit: int = MAX_POINTS) -> None:
        self._limit = limit
        self._last: dict[tuple[str, int, str | None, str], tuple[float | None, str]] = {}

    def changes(self, transaction: NamedTransaction, ts_ns: int) -> Iterator[PointMessage]:
        """Yield the points of a transaction whose value differs from the one seen before.

        A transaction that the slave did not carry out, such as a refused write, yields none.
        `ts_ns`, UTC ns, becomes the time of the yielded points.
        """
        if not transaction.points or not transaction.took_effect:
            return
        link, unit, device = transaction.link, transaction.unit, transaction.device
        for point in transaction.points:
            key = (link, unit, device, point.name)
            seen = (point.value, point.text)
            if self._last.get(key) == seen:
                continue
            self._last.pop(key, None)
            if len(self._last) >= self._limit:
                del self._last[next(iter(self._last))]
            self._last[key] = seen
            yield PointMessage(
                ts_ns=ts_ns,
                link=link,
                unit_id=unit,
                device=device,
                name=point.name,
                reference=point.reference,
                value=point.value,
                text=point.text,
                unit=point.unit,
            )
