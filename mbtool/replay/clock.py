"""The clock of a recording that is played: where in it we are, and when a moment of it comes."""

# One pair of moments, a real one and a place in the recording, is the anchor; everything else is
# computed from it:
#
#     place = anchor place + (now - anchor moment) x rate
#
# It is never a sum of steps, so nothing adds up to a drift, however often it is asked; the rate is
# a fraction, so an hour at 1/3 is exact. Only what changes the course sets another anchor: start,
# pause, another rate, a jump.
#
# Places count from the beginning of the part that is played, in recorded nanoseconds, and go on
# growing when it is played in a loop: `lap` is how often the end was passed.
#
# It never asks for the time: moments come in, from any clock that runs evenly.

from __future__ import annotations

from fractions import Fraction

SLOWEST = Fraction(1, 64)
FASTEST = Fraction(64)
_STEP = 2
"""What `faster` and `slower` multiply and divide by."""


class PlayClock:
    """Maps moments to places in a recording, and back. It stands still until it is started."""

    def __init__(
        self,
        length_ns: int,
        *,
        rate: Fraction | None = Fraction(1),
        gap_ns: int = 0,
        is_loop: bool = False,
    ) -> None:
        """A recording, or the part of it that is played, of so many nanoseconds.

        `rate` is recorded time for each real time; None: as fast as can be. In a loop `gap_ns`
        of recorded time pass between the end and the next beginning. Raises ValueError for a rate
        that is not more than 0, or a loop of no length.
        """
        if rate is not None and rate <= 0:
            raise ValueError(f"rate must be more than 0, not {rate}")
        if is_loop and length_ns + gap_ns <= 0:
            raise ValueError("a recording of no length cannot be played in a loop")
        self.length_ns = length_ns
        self._lap_ns = length_ns + gap_ns if is_loop else None
        self._rate = rate
        self._moment_ns: int | None = None
        """The anchor's moment; None while the clock stands."""
        self._place_ns = 0

    @property
    def rate(self) -> Fraction | None:
        return self._rate

    @property
    def is_running(self) -> bool:
        return self._moment_ns is not None

    def place(self, now_ns: int) -> int:
        """How much of the recording has been played, all laps together."""
        if self._moment_ns is None or self._rate is None:
            return self._place_ns
        return self._place_ns + (now_ns - self._moment_ns) * self._rate // 1

    def in_recording(self, place_ns: int) -> int:
        """The same within the recording: 0 to its length."""
        if self._lap_ns is not None:
            place_ns %= self._lap_ns
        return min(max(place_ns, 0), self.length_ns)

    def lap(self, place_ns: int) -> int:
        """How often the end was passed."""
        return place_ns // self._lap_ns if self._lap_ns is not None else 0

    @property
    def is_loop(self) -> bool:
        return self._lap_ns is not None

    def lap_begin(self, lap: int) -> int:
        """The place at which a lap begins."""
        return lap * self._lap_ns if self._lap_ns is not None else 0

    def is_over(self, now_ns: int) -> bool:
        """Whether all was played; never in a loop."""
        return self._lap_ns is None and self.place(now_ns) >= self.length_ns

    def when(self, place_ns: int) -> int | None:
        """The moment at which a place comes, or came; None while the clock stands.

        It is the first nanosecond at which `place` has reached it.
        """
        if self._moment_ns is None:
            return None
        if self._rate is None:
            return self._moment_ns
        return self._moment_ns - (self._place_ns - place_ns) / self._rate // 1

    def run(self, now_ns: int) -> None:
        """Start, or go on after a pause."""
        if self._moment_ns is None:
            self._moment_ns = now_ns

    def pause(self, now_ns: int) -> None:
        """Stand still until `run`."""
        self._place_ns = self.place(now_ns)
        self._moment_ns = None

    def jump(self, place_ns: int, now_ns: int) -> None:
        """Go on from another place: a step, or back to the beginning."""
        self._place_ns = place_ns
        if self._moment_ns is not None:
            self._moment_ns = now_ns

    def turn(self, rate: Fraction | None, now_ns: int) -> None:
        """Go on at another rate, within SLOWEST to FASTEST."""
        self._place_ns = self.place(now_ns)
        if self._moment_ns is not None:
            self._moment_ns = now_ns
        self._rate = min(max(rate, SLOWEST), FASTEST) if rate is not None else None

    def faster(self, now_ns: int) -> None:
        if self._rate is not None:
            self.turn(self._rate * _STEP, now_ns)

    def slower(self, now_ns: int) -> None:
        if self._rate is not None:
            self.turn(self._rate / _STEP, now_ns)
