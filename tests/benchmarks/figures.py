"""What a decoder made of a wire, counted against the truth."""

# A frame is found where its bytes come out as one frame at its own place in the stream. Any other
# frame that comes out is false where the decoder is sure of it, and in doubt where it says itself
# that another reading is nearly as likely. Directions are counted over the frames found: ambiguous
# where the decoder is not sure of it, whatever it says; right or wrong otherwise.
#
# A transaction counts where every frame of it is undamaged. It is right where its request, its
# response and its outcome come out together. After a damage, those that do not come out right
# before the first that does are the price of getting back in step.

from __future__ import annotations

from bisect import bisect_left
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

from mbtool.core import Direction
from mbtool.modbus import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tests.benchmarks.adapters import Wire
    from tests.benchmarks.bus_traffic import Traffic

SURE = 0.8
"""The least confidence that is not called ambiguous."""


@dataclass(slots=True)
class Heard:
    """What one decoder says of one wire."""

    frames: list[tuple[int, bytes, Direction | None]] = field(default_factory=list)
    """Place in the stream, bytes and direction, or None where that is ambiguous."""
    transactions: list[tuple[int | None, int | None, Outcome | None]] | None = None
    """Places of request and response, and the outcome; None for what the decoder does not tell."""
    seconds: float = 0.0
    """The time it took to find the frames."""
    transaction_seconds: float = 0.0
    """The time it took with the transactions."""


@dataclass(slots=True, kw_only=True)
class Figures:
    """The counts of one cell."""

    frames: int = 0
    """Undamaged ones."""
    found: int = 0
    heard: int = 0
    """All that came out."""
    false: int = 0
    """Those that are none, and are not said to be in doubt."""
    in_doubt: int = 0
    """Those that are none, and are said to be in doubt."""
    right: int = 0
    ambiguous: int = 0
    wrong: int = 0
    transactions: int | None = 0
    """Undamaged ones; None where the decoder knows none."""
    transactions_right: int = 0
    out_of_step: list[int] = field(default_factory=list)
    """For each damage, how many transactions behind it were not right before the first that was."""
    bytes: int = 0
    seconds: float = 0.0
    transaction_seconds: float = 0.0
    misses: list[str] = field(default_factory=list)
    """A line for each frame that is missing, false or wrong, and each transaction that is."""

    def add(self, other: Figures) -> None:
        for one in fields(self):
            mine, theirs = getattr(self, one.name), getattr(other, one.name)
            missing = mine is None or theirs is None
            setattr(self, one.name, None if missing else mine + theirs)

    @property
    def found_share(self) -> float:
        return self.found / max(self.frames, 1)

    @property
    def false_per_10000(self) -> float:
        return 10_000 * self.false / max(self.heard, 1)

    @property
    def in_doubt_per_10000(self) -> float:
        return 10_000 * self.in_doubt / max(self.heard, 1)

    @property
    def right_share(self) -> float | None:
        return _share(self.right, self.found)

    @property
    def ambiguous_share(self) -> float | None:
        return _share(self.ambiguous, self.found)

    @property
    def wrong_share(self) -> float | None:
        return _share(self.wrong, self.found)

    @property
    def transactions_share(self) -> float | None:
        return _share(self.transactions_right, self.transactions or 0)

    @property
    def out_of_step_most(self) -> int:
        return max(self.out_of_step, default=0)

    @property
    def out_of_step_p99(self) -> int:
        ordered = sorted(self.out_of_step)
        return ordered[(len(ordered) - 1) * 99 // 100] if ordered else 0

    @property
    def rate(self) -> float | None:
        """Bytes per second, frames only."""
        return self.bytes / self.seconds if self.seconds else None

    @property
    def transaction_rate(self) -> float | None:
        """Bytes per second, with transactions."""
        return self.bytes / self.transaction_seconds if self.transaction_seconds else None

    def as_json(self) -> dict[str, Any]:
        counts = asdict(self)
        counts["damages"] = len(counts.pop("out_of_step"))
        del counts["misses"]
        derived = (name for name in dir(Figures) if isinstance(getattr(Figures, name), property))
        return counts | {name: getattr(self, name) for name in derived}


def figures(traffic: Traffic, wire: Wire, heard: Heard) -> Figures:
    """Count one decoder's word against the truth."""
    counted = Figures(
        frames=len(wire.intact),
        heard=len(heard.frames),
        bytes=len(wire.data),
        seconds=heard.seconds,
        transaction_seconds=heard.transaction_seconds,
    )
    missing = dict(wire.intact)
    for offset, raw, direction in heard.frames:
        place = wire.intact.get(offset)
        if place is None or traffic.frames[place].raw != raw:
            counted.false += direction is not None
            counted.in_doubt += direction is None
            called = "in doubt" if direction is None else "false"
            counted.misses.append(f"{offset}: {called} {raw.hex(' ')}")
            continue
        missing.pop(offset, None)
        truth = traffic.frames[place].direction
        if direction is None:
            counted.ambiguous += 1
        elif direction is truth:
            counted.right += 1
        else:
            counted.wrong += 1
            counted.misses.append(f"{offset}: {truth} called {direction} {raw.hex(' ')}")
    counted.found = len(wire.intact) - len(missing)
    for offset, place in missing.items():
        frame = traffic.frames[place]
        counted.misses.append(f"{offset}: missing {frame.direction} {frame.raw.hex(' ')}")
    if heard.transactions is None:
        counted.transactions = None
        return counted
    right = _transactions_right(traffic, wire, heard.transactions)
    counted.transactions = len(right)
    counted.transactions_right = sum(right.values())
    counted.misses += [
        f"{_place(traffic, wire, number)}: transaction {traffic.exchanges[number].outcome} not told"
        for number, told in right.items()
        if not told
    ]
    counted.out_of_step = list(_out_of_step(right, wire.mended))
    return counted


def _transactions_right(
    traffic: Traffic,
    wire: Wire,
    heard: Iterable[tuple[int | None, int | None, Outcome | None]],
) -> dict[int, bool]:
    """For each undamaged transaction whether it came out."""
    offsets = {place: offset for offset, place in wire.intact.items()}
    told = {(request, response): outcome for request, response, outcome in heard}
    right = {}
    for number, exchange in enumerate(traffic.exchanges):
        if not all(place in offsets for place in exchange.frames):
            continue
        request, response = (
            None if place is None else offsets[place]
            for place in (exchange.request, exchange.response)
        )
        outcome = told.get((request, response), "not told")
        right[number] = outcome is None or outcome is exchange.outcome
    return right


def _place(traffic: Traffic, wire: Wire, number: int) -> int:
    """Where a transaction begins in the stream."""
    first = traffic.exchanges[number].frames[0]
    return next(offset for offset, place in wire.intact.items() if place == first)


def _out_of_step(right: dict[int, bool], mended: Iterable[int]) -> Iterable[int]:
    numbers = sorted(right)
    for first in mended:
        at = bisect_left(numbers, first)
        begin = at
        while at < len(numbers) and not right[numbers[at]]:
            at += 1
        yield at - begin


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
