"""Decides when each recorded request is sent, and when its answer is given up."""

# Whoever owns the link asks in a loop:
#
#     step = conductor.next_step(now)     a step to send at once, or None
#     conductor.has_left(step, now)       its last byte is on the link: latencies count from here
#     conductor.answered(...)             what came back
#     conductor.give_up(number, now)      what cannot come back any more
#     conductor.expire(now)               what did not, in time
#     conductor.wake_ns(now)              when to ask again at the latest
#
# A step is sent when the clock has come to its place, and no sooner than those that it waits for
# (script.py) are over. On a line that carries one request at a time, none is sent while another is
# open, or before `pause_ns` have passed since the last sign of life on it; behind a broadcast
# `turnaround_ns` must pass (Serial Line V1.02, 2.4.1: typically 100 to 200 ms).
#
# While the clock stands nothing is sent, but for a step that is let go on its own; the clock then
# stands at that step's place.
#
# How late a step leaves is kept only where it waits for nothing but the clock: that is what the
# player can help.
#
# Holds: the open requests, at most MAX_OPEN_REQUESTS; more are not sent until one is over.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.replay.script import Step
from mbtool.replay.steering import Gate
from mbtool.replay.traffic import Sample

if TYPE_CHECKING:
    from mbtool.core.limits import LinkLimits
    from mbtool.replay.clock import PlayClock
    from mbtool.replay.judging import Judge
    from mbtool.replay.script import Script


@dataclass(slots=True)
class _SentRequest:
    step: Step
    sent_ns: int


class Conductor:
    """Plays a script once, or in a loop until it is told to end."""

    def __init__(self, script: Script, clock: PlayClock, judge: Judge, limits: LinkLimits) -> None:
        self._steps = script.steps
        self._clock = clock
        self._gate = Gate(clock)
        self._judge = judge
        self._limits = limits
        self._next = 0
        self._lap = 0
        self._open: dict[int, _SentRequest] = {}
        """By the step's number."""
        self._free_ns: int | None = None
        """From when on the line may be used; None: at once."""
        self.lateness = Sample()
        """Of steps that waited for the clock only, in nanoseconds."""
        self.strays = 0
        """Answers that no open request is for."""

    @property
    def has_ended(self) -> bool:
        return self._upcoming() is None and not self._open

    @property
    def sent(self) -> int:
        """How many steps have been sent, all laps together."""
        return self._lap * len(self._steps) + self._next

    def next_step(self, now_ns: int) -> Step | None:
        """The step to send now; it counts as sent. None where there is none yet."""
        step = self._upcoming()
        if step is None or not self._is_free(step, now_ns):
            return None
        place_ns = self._place(step)
        due_ns = self._gate.opens_ns(place_ns, now_ns)
        if due_ns is None or due_ns > now_ns:
            return None
        waited_for_clock = self._free_ns is None or self._free_ns <= due_ns
        if self._gate.passes(place_ns, now_ns) and waited_for_clock:
            self.lateness.add(now_ns - due_ns)
        self._next += 1
        if step.is_broadcast:
            self._judge.judge(step, None, None)
            self._free_ns = now_ns + self._limits.turnaround_ns
        else:
            self._open[step.number] = _SentRequest(step, now_ns)
        return step

    def let_go(self, _now_ns: int) -> None:
        """Have one more step sent while the clock stands."""
        self._gate.let_go()

    def has_left(self, step: Step, now_ns: int) -> None:
        """Say that the last byte of a step was sent."""
        open_ = self._open.get(step.number)
        if open_ is not None:
            open_.sent_ns = now_ns
        elif step.is_broadcast:
            self._free_ns = now_ns + self._limits.turnaround_ns

    def wake_ns(self, now_ns: int) -> int | None:
        """When something is due: a step, the end of a pause, or a time-out. None: nothing is."""
        moments = [each.sent_ns + self._limits.timeout_ns for each in self._open.values()]
        step = self._upcoming()
        if step is not None and not self._is_held(step):
            due_ns = self._gate.opens_ns(self._place(step), now_ns)
            if due_ns is not None:
                free_ns = due_ns if self._free_ns is None else self._free_ns
                moments.append(max(due_ns, free_ns))
        return min(moments, default=None)

    def answered(self, number: int, pdu: bytes, start_ns: int, end_ns: int) -> bool | None:
        """An answer came, from its first byte to its last: whether it is right.

        None where no open request has this number.
        """
        open_ = self._open.pop(number, None)
        if open_ is None:
            self.strays += 1
            return None
        self._over(end_ns)
        return self._judge.judge(open_.step, pdu, max(start_ns - open_.sent_ns, 0))

    def expire(self, now_ns: int) -> list[tuple[Step, bool]]:
        """Give up requests that were open for too long: each, and whether silence is right."""
        late = [
            number
            for number, each in self._open.items()
            if now_ns - each.sent_ns >= self._limits.timeout_ns
        ]
        return [each for number in late for each in self.give_up(number, now_ns)]

    def give_up(self, number: int, now_ns: int) -> list[tuple[Step, bool]]:
        """Wait no longer for an answer: the step, if it is open, and whether silence is right."""
        open_ = self._open.pop(number, None)
        if open_ is None:
            return []
        self._over(now_ns)
        return [(open_.step, self._judge.judge(open_.step, None, None))]

    def _over(self, now_ns: int) -> None:
        """A request is over: the next may be sent."""
        self._free_ns = now_ns + self._limits.pause_ns

    def _upcoming(self) -> Step | None:
        if self._next >= len(self._steps):
            if not self._clock.is_loop or not self._steps or self._open:
                return None
            self._next, self._lap = 0, self._lap + 1
        return self._steps[self._next]

    def _place(self, step: Step) -> int:
        return step.place_ns + self._clock.lap_begin(self._lap)

    def _is_held(self, step: Step) -> bool:
        """Whether it waits for others to be over."""
        if len(self._open) >= MAX_OPEN_REQUESTS or (self._limits.one_at_a_time and self._open):
            return True
        return any(
            number not in step.open_before and each.step.expected is not None
            for number, each in self._open.items()
        )

    def _is_free(self, step: Step, now_ns: int) -> bool:
        return not self._is_held(step) and (self._free_ns is None or self._free_ns <= now_ns)
