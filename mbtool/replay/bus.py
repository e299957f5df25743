"""Plays a serial line: every byte of master and slaves, at its recorded time."""

# A run is a sequence of bytes without gaps: the bytes of one read, or a frame made from a message
# that was recorded on a network. It is due at the time at which its first byte began. If the
# recording has a time for each byte, each byte is a run of its own, and the gaps between bytes are
# played. Gaps inside one read are not known.
#
# A run that begins a frame waits until the bytes before it are sent, and then for the silence
# between frames. Other runs are given to the port at once, so that bytes without a gap in the
# recording have none on the line even if one of them is late. Only if more than AHEAD_NS of bytes
# are still to be sent do they wait, so that the port's buffer does not overflow.
#
# A run that the line itself delays by more than BEHIND_NS is counted in `delayed` and not in
# `lateness`: the line is too slow for the recording.
#
# Memory grows with the recording: one run for each read or frame.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.replay.play_queue import PlayQueue
from mbtool.replay.traffic import Sample

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.replay.clock import PlayClock


AHEAD_NS = 50_000_000
BEHIND_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class ByteRun:
    """Bytes that follow each other without a gap."""

    position_ns: int
    """When the first byte began, counted from the beginning of the part that is played."""
    data: bytes
    after_silence: bool = False
    """True if a silence of t3.5 must come before these bytes, as between frames."""


class BusPlayer:
    """Decides which run is to be sent now."""

    def __init__(
        self, runs: Sequence[ByteRun], clock: PlayClock, *, character_ns: int, silence_ns: int
    ) -> None:
        """`runs` are in order of time.

        `character_ns` and `silence_ns` are a character's time and the silence between frames on the
        line that is played on.
        """
        self._queue = PlayQueue(runs, clock)
        self._character_ns = character_ns
        self._silence_ns = silence_ns
        self._passed_ns: int | None = None
        """The time at which the last byte given to the port has left the line; None before the
        first."""
        self.bytes = 0
        self.delayed = 0
        """How many runs left more than BEHIND_NS late because the line was still busy."""
        self.lateness = Sample()
        """How late each run left that neither the line delayed nor a step let through, in ns."""

    @property
    def has_ended(self) -> bool:
        """True if the last run was sent."""
        return self._queue.upcoming() is None

    @property
    def sent(self) -> int:
        """How many runs were sent, over all laps."""
        return self._queue.taken

    @property
    def passed_ns(self) -> int | None:
        """The time at which the last byte sent has left the line; None before the first."""
        return self._passed_ns

    def next_run(self, now_ns: int) -> ByteRun | None:
        """Return the run to send at once and count it as sent; None if no run is due."""
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
        """When the next run is due; None while the clock stands still and after the last run."""
        run = self._queue.upcoming()
        if run is None:
            return None
        due_ns = self._queue.due_ns(run, now_ns)
        return None if due_ns is None else max(due_ns, self._free_ns(run))

    def allow_step(self, _now_ns: int) -> None:
        """Let one more run be sent while the clock stands still."""
        self._queue.allow_step()

    def _free_ns(self, run: ByteRun) -> int:
        """The earliest time at which a run can be given to the port."""
        busy_ns = self._busy_ns(run)
        return busy_ns if run.after_silence else busy_ns - AHEAD_NS

    def _busy_ns(self, run: ByteRun) -> int:
        """The time at which the line has carried all earlier runs and the silence before `run`."""
        if self._passed_ns is None:
            return 0
        return self._passed_ns + (self._silence_ns if run.after_silence else 0)
