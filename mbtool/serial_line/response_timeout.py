"""The master's response timeout on a serial line: given by the user, or learned from retries."""

# A write of one value equals its response, so a second equal frame may be the response or a retry.
# A read that comes twice can only be a retry. A master waits as long before it retries a write as
# before it retries a read. So the retries of reads show the master's response timeout.
#
# Memory: at most SAMPLES waits (times from a request to its retry).

from __future__ import annotations

from collections import deque
from collections.abc import Sequence


def longest_silence_ns(times: Sequence[int], size: int, character_ns: int) -> int:
    """Return the longest silence (ns) between the first `size` bytes, which must be two or more.

    `times` are the ends of the bytes in ns; a byte takes `character_ns`.
    """
    steps = map(int.__sub__, times[1:size], times[: size - 1])
    return max(max(steps) - character_ns, 0)


def last_silence(times: Sequence[int], size: int, least_ns: int) -> int:
    """Return the offset of the byte directly behind the last silence inside the first `size` bytes.

    `times` are the ends of the bytes in ns. A silence is `least_ns` or more from the end of a byte
    to the end of the next. There must be a silence.
    """
    offsets = range(size - 1, 0, -1)
    return next(offset for offset in offsets if times[offset] - times[offset - 1] >= least_ns)


SAMPLES = 16
"""The number of last waits that count. A wait is the time from a request to its retry."""
MARGIN = 0.05
"""The timeout may exceed the longest wait heard by half the spread of the waits (longest less
shortest), plus 5 % of the shortest wait divided by the number of waits: few waits tell less."""
DOUBTFUL_MARGIN = 0.4
"""The timeout may be shorter than the shortest wait heard by half the spread of the waits (longest
less shortest), plus 40 % of the shortest wait divided by the number of waits."""
ENOUGH_WAITS = 3
"""From this many waits on, their spread is known well enough for STEADY_MARGIN."""
STEADY_MARGIN = 0.03
"""From ENOUGH_WAITS waits on, the timeout may be shorter than the shortest wait heard by at most
3 % of that wait, plus three times the spread divided by the number of waits less one."""
EXACT_MARGIN = 0.001
"""The timeout counts as certainly over after a wait that is at most 0.1 % shorter than the shortest
wait heard."""
GIVEN_MARGIN = 0.1
"""A wait may differ by 10 % from a timeout that the user names, since timers and adapters are
late."""
TRIMMED = 8
"""The shortest eighth and the longest eighth of the waits do not count."""


class ResponseTimeout:
    """The time, in ns, that the master waits for a response before it repeats a request."""

    __slots__ = ("_is_given", "_range", "_running_until_ns", "_waits")

    def __init__(self, given_ns: int | None = None) -> None:
        """`given_ns` is the timeout that the user names; None if it has to be learned."""
        self._waits: deque[int] = deque(maxlen=SAMPLES)
        self._is_given = given_ns is not None
        self._range: tuple[float, float] | None = None
        """The shortest and the longest wait, in ns, after which a frame is taken for a retry; None
        while the timeout is unknown."""
        self._running_until_ns = 0.0
        """The timeout is certainly not over while the wait since the request is shorter than this,
        in ns; 0 while the timeout is unknown."""
        if given_ns is not None:
            self._running_until_ns = given_ns * (1 - GIVEN_MARGIN)
            self._range = given_ns * (1 - GIVEN_MARGIN), given_ns * (1 + GIVEN_MARGIN)

    @property
    def is_known(self) -> bool:
        """True if the user named the timeout, or a retry was heard."""
        return self._range is not None

    def learn(self, wait_ns: int) -> None:
        """Note the wait, in ns, before a frame that by its form is a retry."""
        if self._is_given:
            return
        self._waits.append(wait_ns)
        waits = sorted(self._waits)
        trimmed = len(waits) // TRIMMED
        shortest, longest = waits[trimmed], waits[-1 - trimmed]
        spread, unit = longest - shortest, shortest / len(waits)
        margin = spread / 2 + MARGIN * unit
        self._range = shortest * (1 - EXACT_MARGIN), longest + margin
        doubtful = spread / 2 + DOUBTFUL_MARGIN * unit
        if len(waits) >= ENOUGH_WAITS:
            steady = 3 * spread / (len(waits) - 1) + STEADY_MARGIN * shortest
            doubtful = min(doubtful, steady)
        self._running_until_ns = shortest - max(doubtful, margin)

    def is_not_over(self, wait_ns: int) -> bool:
        """True if the timeout is known and the master is still waiting after `wait_ns`."""
        return wait_ns < self._running_until_ns

    def over_probability(self, wait_ns: int) -> float:
        """Return how sure it is, from 0 to 1, that the timeout is over after `wait_ns`.

        The result is 0 if the timeout is unknown. It is also 0 for waits longer than those after
        which the master repeats a request.
        """
        if self._range is None or not self._running_until_ns <= wait_ns <= self._range[1]:
            return 0.0
        if wait_ns >= self._range[0]:
            return 1.0
        doubtful_ns = self._range[0] - self._running_until_ns
        return (wait_ns - self._running_until_ns) / doubtful_ns

    def is_over_at(self, wait_ns: int) -> bool:
        """True if the timeout is known and a frame after `wait_ns` is taken for a retry."""
        return self._range is not None and self._range[0] <= wait_ns <= self._range[1]
