"""What someone at the keyboard does to a recording that is played: pause, step, faster, slower."""

# Keys come in as Controls and act on the player's clock. A step goes on by one and stands still
# again: by one request, one piece, or the next moment that was recorded, whichever the player
# plays; so what a step is, the player says.

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.replay.clock import PlayClock


class Control(StrEnum):
    """One key."""

    PAUSE = "pause"
    """Stand still; the next time, go on."""
    STEP = "step"
    """One more, then stand still."""
    FASTER = "faster"
    SLOWER = "slower"


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Where a player is."""

    place_ns: int
    """Since the beginning of what is played."""
    length_ns: int
    lap: int
    """How often the end was passed."""
    rate: Fraction | None
    is_paused: bool
    is_waiting: bool
    """Whether it has yet to be asked something."""
    done: str
    """What was done so far, for a reader."""


class PlayerControls(Protocol):
    """Where someone sits who steers a player, and sees where it is. It is asked very often."""

    def controls(self) -> Sequence[Control]:
        """What was wanted since it was asked last."""
        ...

    def show(self, progress: Progress) -> None: ...


class Gate:
    """Lets what comes next pass when its time comes or, while the clock stands, step by step."""

    def __init__(self, clock: PlayClock) -> None:
        self._clock = clock
        self._steps = 0

    def let_go(self) -> None:
        """Have one more pass while the clock stands."""
        self._steps += 1

    def opens_ns(self, place_ns: int, now_ns: int) -> int | None:
        """When what stands at a place may pass; None while the clock stands and nothing is let go.

        When the clock goes on, steps that nothing was there for are forgotten.
        """
        due_ns = self._clock.when(place_ns)
        if due_ns is not None:
            self._steps = 0
        elif self._steps:
            due_ns = now_ns
        return due_ns

    def passes(self, place_ns: int, now_ns: int) -> bool:
        """Learn that it passes: whether by the clock, which else stands at its place then."""
        if not self._steps:
            return True
        self._steps -= 1
        self._clock.jump(max(place_ns, self._clock.place(now_ns)), now_ns)
        return False


class Steering:
    """Applies controls to the clock of a player. What the clock is asked for stays its own."""

    def __init__(self, clock: PlayClock, on_step: Callable[[int], None]) -> None:
        """`on_step` gets the moment of a step; the clock stands then."""
        self._clock = clock
        self._on_step = on_step
        self.is_paused = False
        self.has_begun = False

    def begin(self, now_ns: int) -> None:
        """Start the clock with the first sign of life, unless it is to stand still."""
        if not self.has_begun:
            self.has_begun = True
            if not self.is_paused:
                self._clock.run(now_ns)

    def apply(self, control: Control, now_ns: int) -> None:
        match control:
            case Control.PAUSE if self.is_paused:
                self.is_paused = False
                if self.has_begun:
                    self._clock.run(now_ns)
            case Control.PAUSE:
                self._pause(now_ns)
            case Control.STEP:
                self._pause(now_ns)
                self._on_step(now_ns)
            case Control.FASTER:
                self._clock.faster(now_ns)
            case Control.SLOWER:
                self._clock.slower(now_ns)

    def attend(self, desk: PlayerControls, now_ns: int, done: str) -> None:
        """Do what is wanted at a desk, and show there where the player is."""
        for control in desk.controls():
            self.apply(control, now_ns)
        desk.show(self.progress(self._clock.place(now_ns), done))

    def _pause(self, now_ns: int) -> None:
        self.is_paused = True
        self._clock.pause(now_ns)

    def progress(self, place_ns: int, done: str) -> Progress:
        """Where the player is, all laps together."""
        clock = self._clock
        return Progress(
            place_ns=clock.in_recording(place_ns),
            length_ns=clock.length_ns,
            lap=clock.lap(place_ns),
            rate=clock.rate,
            is_paused=self.is_paused,
            is_waiting=not self.has_begun,
            done=done,
        )
