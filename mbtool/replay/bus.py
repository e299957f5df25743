"""Plays a recording on a serial line: every byte of master and slaves, at its recorded time."""

# A run is a sequence of bytes without silences between them: the bytes of one read of the recorded
# port, or a frame made from a message that was recorded on a network. A run is sent at the recorded
# time of its first byte. If the recording has a time for each byte, each byte is a run, and the
# silences between bytes are played. Silences inside one read are not known.
#
# A run that begins a frame waits until the bytes before it are sent, and then for the silence
# between frames. Any other run is given to the port as soon as it is due, even while the port still
# sends earlier bytes, so that no silence arises between them. But if the port still needs more than
# AHEAD_NS to send earlier bytes, the run waits, so that the port's buffer does not overflow.
#
# If the line is slower than the recorded one, a run is delayed because the port still sends earlier
# bytes. A run delayed by more than BEHIND_NS in this way is counted in `delayed`, not in
# `lateness`.
#
# Memory grows with the recording: one run for each read or frame.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.replay.play_queue import PlayQueue
from mbtool.replay.traffic import Sample

if TYPE_CHECKING:
    from mbtool.replay.clock import PlayClock


AHEAD_NS = 50_000_000
BEHIND_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class ByteRun:
    """Bytes that are sent one right after the other, without a silence between them."""

    position_ns: int
    """The recorded time of the first byte, in ns from the beginning of the part that is played."""
    data: bytes
    after_silence: bool = False
    """True if a silence of t3.5 must come before these bytes, as between frames."""


class BusPlayer:
    """Decides when each run of bytes (bytes without a silence between them) is sent."""

    def __init__(
        self, runs: Sequence[ByteRun], clock: PlayClock, *, character_ns: int, silence_ns: int
    ) -> None:
        """Play `runs`, which are in the order of their `position_ns`.

        `character_ns` is the duration of one character, and `silence_ns` the silence between two
        frames, both in ns, on the line that the recording is played on.
        """
        self._queue = PlayQueue(runs, clock)
        self._character_ns = character_ns
        self._silence_ns = silence_ns
        self._passed_ns: int | None = None
        """The real time (ns) at which the port will have sent all bytes given to it; None before
        the first byte."""
        self.bytes = 0
        self.delayed = 0
        """The number of runs that were sent more than BEHIND_NS after their recorded time because
        the port was still sending earlier bytes."""
        self.lateness = Sample()
        """The delays (ns) between the recorded time of each run and the time at which it was sent.
        Runs counted in `delayed` and runs that the user sent with the step key are left out."""

    @property
    def has_ended(self) -> bool:
        """True if the recording's last run (bytes without silences between them) was sent."""
        return self._queue.upcoming() is None

    @property
    def sent(self) -> int:
        """The number of runs (bytes without silences between them) sent; in a loop, of all laps
        together.
        """
        return self._queue.taken

    @property
    def passed_ns(self) -> int | None:
        """The real time (ns) at which the port will have sent all bytes given to it; None before
        the first byte.
        """
        return self._passed_ns

    def next_run(self, now_ns: int) -> ByteRun | None:
        """Return the run to send at the real time `now_ns`, and count it as sent; None if no run is
        due.
        """
        run = self._queue.upcoming()
        if run is None or self._free_ns(run) > now_ns:
            return None
        due_ns = self._queue.due_ns(run, now_ns)
        if due_ns is None or due_ns > now_ns:
            return None
        if self._queue.take(run, now_ns):
            if self._busy_ns(run) > due_ns + BEHIND_NS:
                self.delayed += 1
            else:
                self.lateness.add(now_ns - due_ns)
        self.bytes += len(run.data)
        begin_ns = now_ns if self._passed_ns is None else max(now_ns, self._passed_ns)
        self._passed_ns = begin_ns + len(run.data) * self._character_ns
        return run

    def wake_ns(self, now_ns: int) -> int | None:
        """The real time (ns) at which the next run is due; None while the clock is paused, and
        after the last run.
        """
        run = self._queue.upcoming()
        if run is None:
            return None
        due_ns = self._queue.due_ns(run, now_ns)
        return None if due_ns is None else max(due_ns, self._free_ns(run))

    def allow_step(self, _now_ns: int) -> None:
        """Let one more run be sent although the clock is paused: the user has pressed the
        step key.
        """
        self._queue.allow_step()

    def _free_ns(self, run: ByteRun) -> int:
        """The earliest real time (ns) at which `run` may be given to the port.

        A run that begins a frame must wait until the line has been silent; any other run may come
        up to AHEAD_NS before the port has sent the earlier bytes.
        """
        busy_ns = self._busy_ns(run)
        return busy_ns if run.after_silence else busy_ns - AHEAD_NS

    def _busy_ns(self, run: ByteRun) -> int:
        """The real time (ns) when the port has sent all earlier bytes and the silence that `run`
        needs is over; 0 if no byte was sent yet.
        """
        if self._passed_ns is None:
            return 0
        return self._passed_ns + (self._silence_ns if run.after_silence else 0)
