"""Applies the user's keys to the recording that is being played: pause, step, faster, slower."""

# Keys arrive as Controls and act on the player's clock. A step plays one more item, then pauses
# again. An item is a request, a run of bytes without silences, or the time up to the next recorded
# request, depending on the player.

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from mbtool.replay.clock import PlayClock


class Control(StrEnum):
    """A command that the user gives to a player by pressing a key."""

    PAUSE = "pause"
    """Pause the player, or continue if it is paused."""
    STEP = "step"
    """Play one more item, such as a request, then pause."""
    FASTER = "faster"
    SLOWER = "slower"


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """The state of a player, to be shown to the user."""

    position_ns: int
    """The position in ns of recorded time, from the beginning of the part that is played; each lap
    begins at 0."""
    length_ns: int
    lap: int
    """The number of times that the recording was played to its end before; 0 in the first round."""
    rate: Fraction | None
    """Recorded time divided by real time; None for as fast as possible."""
    is_paused: bool
    is_waiting: bool
    """True until the clock was started for the first time, as while a slave waits for the first
    request."""
    done: str
    """A text that says how much was played so far, such as "12 asked"."""


class PlayerControls(Protocol):
    """The keyboard and display of the user who plays a recording; called many times a second."""

    def controls(self) -> Sequence[Control]:
        """The commands of the keys that the user has pressed since the last call."""
        ...

    def show(self, progress: Progress) -> None: ...


class Steering:
    """Applies the commands of the user's keys to the clock of a player."""

    def __init__(self, clock: PlayClock, on_step: Callable[[int], None]) -> None:
        """Apply the user's keys to `clock`.

        `on_step` is called each time the user presses the step key. Its argument is the real time
        (ns); the clock is paused before the call.
        """
        self._clock = clock
        self._on_step = on_step
        self.is_paused = False
        self.has_begun = False

    def begin(self, now_ns: int) -> None:
        """Start the clock at the first call, at the real time `now_ns`. If the user has paused the
        player before, the clock stays paused.
        """
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

    def update(self, user: PlayerControls, now_ns: int, done: str) -> None:
        """Apply the keys that the user has pressed, then show the player's progress to the user.

        `done` is a text that says how much was played so far, such as "12 asked".
        """
        for control in user.controls():
            self.apply(control, now_ns)
        user.show(self.progress(self._clock.position(now_ns), done))

    def _pause(self, now_ns: int) -> None:
        self.is_paused = True
        self._clock.pause(now_ns)

    def progress(self, position_ns: int, done: str) -> Progress:
        """The player's state at `position_ns`, recorded time in ns since the beginning of the first
        lap.

        `done` is a text that says how much was played so far.
        """
        clock = self._clock
        return Progress(
            position_ns=clock.in_recording(position_ns),
            length_ns=clock.length_ns,
            lap=clock.lap(position_ns),
            rate=clock.rate,
            is_paused=self.is_paused,
            is_waiting=not self.has_begun,
            done=done,
        )
