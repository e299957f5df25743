"""Converts real time to a position in the recording that is being played, and back."""

# The conversion uses one anchor: a real time, and the position in the recording at that time.
#
#     position = anchor position + (now - anchor time) x rate
#
# The position is never a sum of steps, so rounding errors do not add up; the rate is a fraction, so
# an hour at 1/3 is exact. Start, pause, another rate and a jump set a new anchor.
#
# A position is in ns of recorded time from the beginning of the part that is played. In a loop, the
# position continues to grow after the end: at the beginning of the second lap it is the length of
# the recording plus `gap_ns`. `lap` counts the laps, from 0.
#
# Real times are arguments, in ns of any monotonic clock; the module reads no clock itself.

from __future__ import annotations

from fractions import Fraction

SLOWEST = Fraction(1, 64)
FASTEST = Fraction(64)
_STEP = 2
"""The rate of playing is multiplied by this number in `faster`, and divided by it in `slower`."""


class PlayClock:
    """Tells which position of a recording is played at a given real time.

    The position does not advance before `run` is called, and after `pause`.
    """

    def __init__(
        self,
        length_ns: int,
        *,
        rate: Fraction | None = Fraction(1),
        gap_ns: int = 0,
        is_loop: bool = False,
    ) -> None:
        """Play `length_ns` of recorded time.

        `rate` is recorded time divided by real time: 2 plays twice as fast, None as fast as
        possible. In a loop, `gap_ns` of recorded time pass between the end and the next beginning.
        Raises ValueError if the rate is not above 0, or if a loop has no length.
        """
        if rate is not None and rate <= 0:
            raise ValueError(f"rate must be more than 0, not {rate}")
        if is_loop and length_ns + gap_ns <= 0:
            raise ValueError("a recording of no length cannot be played in a loop")
        self.length_ns = length_ns
        self._lap_ns = length_ns + gap_ns if is_loop else None
        self._rate = rate
        self._anchor_ns: int | None = None
        """The real time (ns) at which the position was `_anchor_position_ns`; None while the clock
        is paused."""
        self._anchor_position_ns = 0

    @property
    def rate(self) -> Fraction | None:
        return self._rate

    @property
    def is_running(self) -> bool:
        return self._anchor_ns is not None

    def position(self, now_ns: int) -> int:
        """The position at the real time `now_ns`, in ns of recorded time since the beginning of the
        first lap.
        """
        if self._anchor_ns is None or self._rate is None:
            return self._anchor_position_ns
        return self._anchor_position_ns + (now_ns - self._anchor_ns) * self._rate // 1

    def in_recording(self, position_ns: int) -> int:
        """Convert a position to the time (ns) since its lap began; the result is between 0 and the
        recording's length.
        """
        if self._lap_ns is not None:
            position_ns %= self._lap_ns
        return min(max(position_ns, 0), self.length_ns)

    def lap(self, position_ns: int) -> int:
        """The number of the lap that a position is in, from 0; always 0 if the recording is not
        played in a loop.
        """
        return position_ns // self._lap_ns if self._lap_ns is not None else 0

    @property
    def is_loop(self) -> bool:
        return self._lap_ns is not None

    def lap_begin(self, lap: int) -> int:
        """The position (ns) at which the lap with this number begins; laps are numbered from 0."""
        return lap * self._lap_ns if self._lap_ns is not None else 0

    def is_over(self, now_ns: int) -> bool:
        """True if the clock has reached the end of the recording; always False in a loop."""
        return self._lap_ns is None and self.position(now_ns) >= self.length_ns

    def time_of(self, position_ns: int) -> int | None:
        """The real time, in ns, at which a position is reached; None while the clock is paused.

        This is the first time for which `position` returns at least `position_ns`. At the rate None
        (as fast as possible) every position is reached as soon as the clock runs.
        """
        if self._anchor_ns is None:
            return None
        if self._rate is None:
            return self._anchor_ns
        return self._anchor_ns - (self._anchor_position_ns - position_ns) / self._rate // 1

    def run(self, now_ns: int) -> None:
        """Start the clock at the real time `now_ns`, or continue after a pause."""
        if self._anchor_ns is None:
            self._anchor_ns = now_ns

    def pause(self, now_ns: int) -> None:
        """Stop the clock at the real time `now_ns`, until `run` is called."""
        self._anchor_position_ns = self.position(now_ns)
        self._anchor_ns = None

    def jump(self, position_ns: int, now_ns: int) -> None:
        """Continue at another position from the real time `now_ns` on; a paused clock stays paused
        there.
        """
        self._anchor_position_ns = position_ns
        if self._anchor_ns is not None:
            self._anchor_ns = now_ns

    def set_rate(self, rate: Fraction, now_ns: int) -> None:
        """Set the rate (recorded time divided by real time) from the real time `now_ns` on. It is
        limited to the range SLOWEST to FASTEST.
        """
        self.jump(self.position(now_ns), now_ns)
        self._rate = min(max(rate, SLOWEST), FASTEST)

    def faster(self, now_ns: int) -> None:
        if self._rate is not None:
            self.set_rate(self._rate * _STEP, now_ns)

    def slower(self, now_ns: int) -> None:
        if self._rate is not None:
            self.set_rate(self._rate / _STEP, now_ns)
