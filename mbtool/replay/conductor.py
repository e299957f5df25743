"""Decides when each recorded request is sent, and when to stop waiting for its response."""

# The owner of the link calls in a loop:
#
#     step = conductor.next_step(now)     the step (request) to send at once, or None
#     conductor.note_sent(step, now)      the last byte of the step was sent: latency counts from
#                                         here
#     conductor.answered(...)             a response arrived
#     conductor.connection_ended(number)  the slave ended a connection
#     conductor.give_up(number, now)      a response cannot arrive any more
#     conductor.expire(now)               end the requests whose time-out has passed
#     conductor.wake_ns(now)              the latest time for the next call
#
# A step (a recorded request) is sent when the clock has reached its recorded position and the steps
# that it waits for (script.py) are answered or given up. If the link carries one request at a time,
# a step also waits for the pending request, and for `pause_ns` after the last byte on the link.
# After a broadcast it waits for `turnaround_ns` (Serial Line V1.02, 2.4.1: typically 100 to 200
# ms).
#
# A step that opens or ends a TCP connection (ConnectionStep in script.py) waits in the same way.
# While the conductor waits for the slave to end a connection, it sends nothing; after the time-out
# the connection counts as not ended. At the speed `max`, a step that opens a connection also waits
# `rest_ns`: the recorded time since its cause, such as the last refusal.
#
# While the clock is paused, only steps that `allow_step` permits are sent (the user presses the
# step key); each of them moves the clock to the position of the step.
#
# Lateness is recorded only for steps that waited for nothing but the clock: other delays come from
# the slave or the link, not from the player.
#
# Limit: MAX_OPEN_REQUESTS pending requests; a further request waits until one of them is answered
# or given up.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core.limits import MAX_OPEN_REQUESTS, LinkLimits
from mbtool.replay.play_queue import PlayQueue
from mbtool.replay.script import Action, ConnectionStep, Script, Step
from mbtool.replay.traffic import Sample

if TYPE_CHECKING:
    from mbtool.replay.clock import PlayClock
    from mbtool.replay.judging import ResponseJudge


@dataclass(slots=True)
class _SentRequest:
    step: Step
    sent_ns: int


class Conductor:
    """Decides which recorded request of a script is sent when; plays the script once, or in a loop
    without end.
    """

    def __init__(
        self,
        script: Script,
        clock: PlayClock,
        judge: ResponseJudge,
        limits: LinkLimits,
        *,
        with_connections: bool = False,
    ) -> None:
        """Prepare to play a script. `with_connections` is True if its connections are opened and
        ended as recorded.
        """
        items: Sequence[Step | ConnectionStep] = script.items if with_connections else script.steps
        self._queue = PlayQueue(items, clock)
        self._keeps_rest = clock.rate is None
        self._connection_ns: int | None = None
        """The real time (ns) of the last beginning or end of a connection; None before it."""
        self._awaited: tuple[ConnectionStep, int] | None = None
        """The end by the slave that is awaited, and the real time (ns) until which it is; or
        None."""
        self.sent = 0
        """The number of requests sent; in a loop, of all laps together."""
        self._judge = judge
        self._limits = limits
        self._open: dict[int, _SentRequest] = {}
        """The pending requests: the key is the number of the request's step in the script."""
        self._free_ns: int | None = None
        """The earliest real time (ns) at which the link allows the next request; None until the
        first request is answered or given up, or a broadcast is sent."""
        self.lateness = Sample()
        """The delays (ns) between the recorded time of each request and the time at which it was
        sent. Requests that had to wait for anything but the clock, such as a response, are left
        out."""
        self.unsolicited = 0
        """The number of responses that came when no request was pending for them."""

    @property
    def has_ended(self) -> bool:
        return self._upcoming() is None and not self._open and self._awaited is None

    @property
    def pending(self) -> int:
        """The number of requests that were sent and are neither answered nor given up."""
        return len(self._open)

    def next_step(self, now_ns: int) -> Step | ConnectionStep | None:
        """Return the step (recorded request) to send at the real time `now_ns`, and count it as
        sent, or the step of a connection to take; None if none is due.
        """
        step = self._upcoming()
        if step is None or not self._is_free(step, now_ns):
            return None
        due_ns = self._due_ns(step, now_ns)
        if due_ns is None or due_ns > now_ns:
            return None
        waited_for_clock = self._free_ns is None or self._free_ns <= due_ns
        is_by_clock = self._queue.take(step, now_ns, is_step=isinstance(step, Step))
        if isinstance(step, ConnectionStep):
            self._connection_ns = now_ns
            if step.action is Action.AWAIT_END:
                rest_ns = step.rest_ns if self._keeps_rest else 0
                self._awaited = step, now_ns + rest_ns + self._limits.timeout_ns
            return step
        self.sent += 1
        if is_by_clock and waited_for_clock:
            self.lateness.add(now_ns - due_ns)
        if step.is_broadcast:
            self._judge.judge(step, None, None)
            self._free_ns = now_ns + self._limits.turnaround_ns
        else:
            self._open[step.number] = _SentRequest(step, now_ns)
        return step

    def allow_step(self, _now_ns: int) -> None:
        """Let one more request be sent although the clock is paused: the user has pressed the step
        key.
        """
        self._queue.allow_step()

    def note_sent(self, step: Step, now_ns: int) -> None:
        """Called when the last byte of `step`'s request was sent, at the real time `now_ns`.

        The latency and the time-out of the response count from this time; after a broadcast, the
        turnaround delay does.
        """
        request = self._open.get(step.number)
        if request is not None:
            request.sent_ns = now_ns
        elif step.is_broadcast:
            self._free_ns = now_ns + self._limits.turnaround_ns

    def wake_ns(self, now_ns: int) -> int | None:
        """Return the real time (ns) at which the owner of the link must call again at the latest.

        At that time the next request may be sent, or the first pending request times out. None if
        neither can happen before a response comes or the user presses a key.
        """
        times = [each.sent_ns + self._limits.timeout_ns for each in self._open.values()]
        if self._awaited is not None:
            times.append(self._awaited[1])
        step = self._upcoming()
        if step is not None and not self._must_wait(step):
            due_ns = self._due_ns(step, now_ns)
            if due_ns is not None:
                times.append(max(due_ns, self._free_ns or due_ns, self._rested_ns(step)))
        return min(times, default=None)

    def answered(self, number: int, pdu: bytes, start_ns: int, end_ns: int) -> bool | None:
        """Called with the PDU of a response; `number` is the number of the step whose request it
        answers.

        `start_ns` and `end_ns` are the real times of the response's first and last byte. Returns
        True if the response means the same as the recorded one, False if it does not, and None if
        the request of that step is not pending.
        """
        request = self._open.pop(number, None)
        if request is None:
            self.unsolicited += 1
            return None
        self._note_over(end_ns)
        return self._judge.judge(request.step, pdu, max(start_ns - request.sent_ns, 0))

    def connection_ended(self, number: int, now_ns: int) -> None:
        """Called when the slave has ended the connection `number` of the script."""
        if self._awaited is not None and self._awaited[0].number == number:
            self._awaited = None
        self._connection_ns = now_ns

    @property
    def awaited(self) -> ConnectionStep | None:
        """The end of a connection by the slave that is awaited; None if none is."""
        return None if self._awaited is None else self._awaited[0]

    def overdue_end(self, now_ns: int) -> ConnectionStep | None:
        """Return the awaited end of a connection if its time-out has passed, and stop waiting."""
        if self._awaited is None or now_ns < self._awaited[1]:
            return None
        step, self._awaited = self._awaited[0], None
        return step

    def expire(self, now_ns: int) -> list[tuple[Step, bool]]:
        """Give up the requests that at the real time `now_ns` have waited as long as the time-out
        allows.

        Returns a pair for each: its step, and True if the recording has no response to that request
        either, so that the silence is as recorded.
        """
        late = [
            number
            for number, each in self._open.items()
            if now_ns - each.sent_ns >= self._limits.timeout_ns
        ]
        return [each for number in late for each in self.give_up(number, now_ns)]

    def give_up(self, number: int, now_ns: int) -> list[tuple[Step, bool]]:
        """Stop waiting for the response to the request of the step `number`.

        Returns a list with one pair: the step, and True if the recording has no response to that
        request either. The list is empty if that request is not pending.
        """
        request = self._open.pop(number, None)
        if request is None:
            return []
        self._note_over(now_ns)
        return [(request.step, self._judge.judge(request.step, None, None))]

    def _note_over(self, now_ns: int) -> None:
        """Allow the next request `pause_ns` from now: called when a request was answered or given
        up.
        """
        self._free_ns = now_ns + self._limits.pause_ns

    def _upcoming(self) -> Step | ConnectionStep | None:
        return self._queue.upcoming(may_restart=not self._open and self._awaited is None)

    def _must_wait(self, step: Step | ConnectionStep) -> bool:
        """True if `step` must wait until pending requests are answered or given up, or until the
        slave has ended a connection.
        """
        if self._awaited is not None:
            return True
        if isinstance(step, ConnectionStep) and step.action is Action.AWAIT_END:
            return False  # This end may be what ends the pending requests.
        if len(self._open) >= MAX_OPEN_REQUESTS or (self._limits.one_at_a_time and self._open):
            return True
        return any(
            number not in step.open_before and each.step.expected is not None
            for number, each in self._open.items()
        )

    def _is_free(self, step: Step | ConnectionStep, now_ns: int) -> bool:
        is_rested = self._rested_ns(step) <= now_ns
        is_free = self._free_ns is None or self._free_ns <= now_ns
        return not self._must_wait(step) and is_free and is_rested

    def _due_ns(self, step: Step | ConnectionStep, now_ns: int) -> int | None:
        """The real time (ns) at which the clock lets a step be taken; None while it is paused. The
        end of a connection belongs to the requests before it, and is not paused.
        """
        due_ns = self._queue.due_ns(step, now_ns)
        is_end = isinstance(step, ConnectionStep) and step.action is not Action.OPEN
        return now_ns if due_ns is None and is_end else due_ns

    def _rested_ns(self, step: Step | ConnectionStep) -> int:
        """The real time (ns) before which a connection may not be opened; 0 if at any time."""
        if (
            not self._keeps_rest
            or self._connection_ns is None
            or not isinstance(step, ConnectionStep)
        ):
            return 0
        return self._connection_ns + step.rest_ns if step.action is Action.OPEN else 0
