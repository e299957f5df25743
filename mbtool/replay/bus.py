"""Plays a line: every byte of both sides, at its time."""

# A piece is what one read of a port brought, or a frame made of a message that was recorded on a
# network. It is due when its first byte began, by the clock.
#
# A line carries one byte after the other. What begins a frame waits until the bytes before it have
# passed, and for the silence that parts frames. Other bytes do not: the port sends them one behind
# the other, so what followed without a gap does so again, however late one of them is; only when
# the line is AHEAD_NS behind do they wait, so that no port is flooded. What the line delays by more
# than BEHIND_NS is counted, and its wait is no lateness: a faster line would be the remedy.
#
# What stands in a piece leaves without a gap: where the recording has a time for each byte, each is
# a piece of its own, and the gaps between them are played; of what a port read in one go they are
# not known.
#
# Memory grows with the recording: a piece for each read or frame.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.replay.steering import Gate
from mbtool.replay.traffic import Sample

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.replay.clock import PlayClock


AHEAD_NS = 50_000_000
BEHIND_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class ByteRun:
    """Bytes that follow each other without a gap."""

    place_ns: int
    """When the first of them began, since the beginning of what is played."""
    data: bytes
    after_silence: bool = False
    """The line is to be silent before it, as between frames."""


class BusPlayer:
    """Says which piece is to be sent now. Pieces are in order of their places."""

    def __init__(
        self, pieces: Sequence[ByteRun], clock: PlayClock, *, character_ns: int, silence_ns: int
    ) -> None:
        """`character_ns` and `silence_ns`, between frames, are those of the line played on."""
        self._pieces = pieces
        self._clock = clock
        self._gate = Gate(clock)
        self._character_ns = character_ns
        self._silence_ns = silence_ns
        self._next = 0
        self._lap = 0
        self._passed_ns: int | None = None
        """When the last byte that was sent has passed; None before the first."""
        self.bytes = 0
        self.held = 0
        """How many pieces the line delayed."""
        self.lateness = Sample()
        """Of all other pieces, in nanoseconds."""

    @property
    def has_ended(self) -> bool:
        """Whether the last byte was sent."""
        return self._upcoming() is None

    @property
    def sent(self) -> int:
        """How many pieces have been sent, all laps together."""
        return self._lap * len(self._pieces) + self._next

    @property
    def passed_ns(self) -> int | None:
        """When the last byte that was sent has passed."""
        return self._passed_ns

    def next_piece(self, now_ns: int) -> ByteRun | None:
        """The piece to send at once; it counts as sent. None where there is none yet."""
        piece = self._upcoming()
        if piece is None:
            return None
        place_ns = self._place(piece)
        if self._free_ns(piece) > now_ns:
            return None
        due_ns = self._gate.opens_ns(place_ns, now_ns)
        if due_ns is None or due_ns > now_ns:
            return None
        if self._gate.passes(place_ns, now_ns):
            if self._busy_ns(piece) > due_ns + BEHIND_NS:
                self.held += 1
            else:
                self.lateness.add(now_ns - due_ns)
        self._next += 1
        self.bytes += len(piece.data)
        begin_ns = now_ns if self._passed_ns is None else max(now_ns, self._passed_ns)
        self._passed_ns = begin_ns + len(piece.data) * self._character_ns
        return piece

    def wake_ns(self, now_ns: int) -> int | None:
        """When the next piece is due; None while the clock stands, and behind the last."""
        piece = self._upcoming()
        if piece is None:
            return None
        due_ns = self._gate.opens_ns(self._place(piece), now_ns)
        return None if due_ns is None else max(due_ns, self._free_ns(piece))

    def let_go(self, _now_ns: int) -> None:
        """Have one more piece sent while the clock stands."""
        self._gate.let_go()

    def _free_ns(self, piece: ByteRun) -> int:
        """From when on the line takes a piece."""
        busy_ns = self._busy_ns(piece)
        return busy_ns if piece.after_silence else busy_ns - AHEAD_NS

    def _busy_ns(self, piece: ByteRun) -> int:
        """When the line has carried what comes before a piece, its silence included."""
        if self._passed_ns is None:
            return 0
        return self._passed_ns + (self._silence_ns if piece.after_silence else 0)

    def _upcoming(self) -> ByteRun | None:
        if self._next >= len(self._pieces):
            if not self._clock.is_loop or not self._pieces:
                return None
            self._next, self._lap = 0, self._lap + 1
        return self._pieces[self._next]

    def _place(self, piece: ByteRun) -> int:
        return piece.place_ns + self._clock.lap_begin(self._lap)
